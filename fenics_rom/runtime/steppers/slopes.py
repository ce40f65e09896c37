"""What a vector changes by with what a step begins with, and with what it solves for."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.runtime.steppers.adjoint import NONE


class Slopes(NamedTuple):
    """Of a vector (n,), (n, k) each."""

    place: Array
    velocity: Array  # at the start
    x: Array
    end: Array = NONE  # where a base is at the end of a step, by a move and a rotation about its axes (n, 6)

    def with_(self, other: "Slopes", share: float = 1.0) -> "Slopes":
        """Both together, of others a share."""
        return Slopes(*(mine + share * theirs for mine, theirs in zip(self, other, strict=True)))
