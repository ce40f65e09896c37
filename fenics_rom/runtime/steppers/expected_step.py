"""How a step in a moving frame was expected to go, where its law asks for that."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.frame_loads import FrameForces


class Expected(NamedTuple):
    """How v̂ of a step was expected, from that of the step before, and under the forces that were found in it."""

    u: Array  # (p,) with these forces
    forces: FrameForces
    pressed: Array | None  # contact forces (P, 3) among them
    lack: Array  # of the balance of the coordinates (m,)
    T: Array  # (m, m)
    whole: Array  # v̂ that came of it
    x: Array = NONE  # of a free body the ω̂ and v̂ (3 + m,) that it was found at
    translation: Array | None = None  # v̂ (3,) of the origin, where ties feel it
    passed: tuple[float, Array] | None = None  # h and x of the step before, if that guided it
