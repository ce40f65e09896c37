"""Faces of a body that an obstacle meets, as `contact_solver` knows an obstacle, and which pair each place is."""

from typing import ClassVar

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.body_faces import Places
from fenics_rom.mechanics.obstacle_outline import FLAT

NO_DERIVATIVE = (
    "effects.contact.points = 'faces': steps that touch have no derivative: use those where nothing touches, "
    "or contact points alone"
)


class MetFaces:
    """The faces of a body as what one obstacle meets.

    Attributes:
        gaps, normals: of P pairs, (P,), m, infinite of those that are none, and (P, 3).
    """

    is_convex: ClassVar = True
    outline: ClassVar = FLAT
    extent: ClassVar = np.inf

    def __init__(self, points: int):
        self.gaps, self.normals = np.full(points, np.inf), np.tile([1.0, 0.0, 0.0], (points, 1))

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Gaps and normals, wherever points are."""
        return self.gaps, self.normals

    def curvature(self, points: Array) -> Array:
        """As of an Obstacle."""
        raise StepError(NO_DERIVATIVE)

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Obstacle: no ball that would go through points."""
        return np.inf, np.empty((0, 3))


def slots_of(places: Places, keys: Array, at: Array, parts: int) -> Array:
    """Slots (k,), among P, of places: those of the step before, also of a place that went on to another face.

    Args:
        places: k of them.
        keys, at: what slots had, (P,) and (P, 3).
        parts: of the body, as of BodyFaces.
    """
    slots, free = np.full(len(places.keys), -1), np.ones(len(keys), dtype=bool)
    _, own, known = np.intersect1d(places.keys, keys, return_indices=True)
    slots[own], free[known] = known, False
    for row in (slots < 0).nonzero()[0]:
        among = (free & (keys // parts == places.keys[row] // parts) & (keys >= 0)).nonzero()[0]
        if len(among):
            slot = among[np.square(at[among] - places.at[row]).sum(axis=1).argmin()]
        else:
            slot = np.where(free, keys, keys.max() + 1).argmin()  # one that had none, if there is one
        slots[row], free[slot] = slot, False
    return slots
