"""What a number owes to the twists of a base whose poses follow them, from what it owes to poses and twists apart.

With the twist (v, ω) of the base in its own axes at both ends of a step, v̂ and ω̂ their means,

    p⁺ = p + h R* v̂,    R⁺ = R cay(h ω̂),    R* = R (1 + h/2 ω̂~)
"""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_geometry import Geometry, vector
from fenics_rom.mechanics.frame_motion import rotation_matrix, rotation_of
from fenics_rom.runtime.steppers.frame_slopes import StepTurn


def owed_to_twists(owed: Array, states: Sequence[BaseState], lengths: Sequence[float]) -> Array:
    """Derivatives with the twists (n + 1, 6).

    Args:
        owed: with each pose and twist on its own (n + 1, 12), as in `StateAdjoint.frame`.
        states: of the base (n + 1).
        lengths: of the steps between them (n,), s.
    """
    twists_, (p_, φ_) = owed[:, 6:].copy(), np.zeros((2, 3))
    for k in reversed(range(len(lengths))):
        h, before, after = lengths[k], states[k], states[k + 1]
        R, R_end = rotation_matrix(before.rotation), rotation_matrix(after.rotation)
        v, ω = (
            (R.T @ of_start + R_end.T @ of_end) / 2
            for of_start, of_end in zip(before[2:], after[2:], strict=True)
        )  # fmt: skip
        p_, φ_ = p_ + owed[k + 1, :3], φ_ + owed[k + 1, 3:6]
        start, end = (rotation_of(*state.rotation.tolist()) for state in (before, after))
        step = StepTurn(Geometry(start, end, vector(h * ω)), h, ω)
        seen = h * R.T @ p_
        means_ = np.concatenate([h * step.turn.middle.T @ p_, step.by_spin.T @ φ_ + h / 2 * np.cross(v, seen)])
        φ_ = step.along.T @ φ_ + np.cross(v + step.half @ v, seen)
        twists_[k : k + 2] += means_ / 2
    return twists_
