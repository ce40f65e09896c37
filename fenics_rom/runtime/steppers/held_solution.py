"""Where a step of a held body begins, what is found on the way, and where it leads; see held.py."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.runtime.steppers.held_adjoint import Part
from fenics_rom.runtime.steppers.kernel import StepWork


class Start(NamedTuple):
    """Where a step, or a part of one, begins."""

    q: Array  # (m,)
    r: Array
    h: float  # s
    obstacles: ObstacleMotion | None
    reactions: Array  # (n,) that the search for forces begins with


class Touched(NamedTuple):
    """What was found near a velocity."""

    contact: ContactSolution | None
    reactions: Array  # (n,)
    held: Array | None  # forces of strokes (m,)
    rubbed: Array | None  # those at guides
    pushed: Array | None  # all of them, and those of contact


class Solution(NamedTuple):
    """Where a step leads to, and what it came of."""

    e: Array  # (m,)
    r: Array
    contact: ContactSolution | None
    reactions: Array
    work: StepWork
    taken: tuple[Part, ...]
