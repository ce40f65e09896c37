"""Rows of the table of a body in a moving frame, see `frame_kernel`."""

HALF_INERTIA1, MOMENTS = slice(0, 6), slice(6, 9)  # ½ I1 and c
# At the start of a step S, b, f0 = ω e - 2/h r - f, and T.
BENT, COUPLED, GIVEN, TURNED = slice(9, 15), slice(15, 18), 18, slice(19, 22)
# At a mid-step rate S in the middle of the step, G r̂, and (2/h + h/2 γ + D) r̂.
BENT_BY_RATE, TURNED_BY_RATE, ROWS = slice(22, 28), slice(28, 31), 32
