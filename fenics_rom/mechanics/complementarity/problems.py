"""The contact problems of many bodies at once; arrays hold bodies along their last axis."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import taken

if TYPE_CHECKING:
    from numpy.typing import DTypeLike


class Problems(NamedTuple):
    """What is known of B bodies with P pairs each."""

    q: Array  # (3, P, B) velocities without contact, less the targets, m/s
    normals: Array | None  # (3, P, B) unit vectors from the obstacle to the body; None: the last axis for all
    due: Array  # (P, B) which pairs may push, as 1.0 or 0.0
    friction: Array  # μ (B,)
    scale: Array  # (B,) velocities of which tolerances are shares, m/s

    @staticmethod
    def whole(q: Array, normals: Array | None, due: Array, friction: Array) -> "Problems":
        """Of all that their bodies have: tolerances are shares of the largest velocity without contact."""
        return Problems(q, normals, due, friction, np.maximum(q.max(axis=(0, 1)), -q.min(axis=(0, 1))))

    def of(self, bodies: Array | slice) -> "Problems":
        """Those of some of the bodies."""
        normals = None if self.normals is None else taken(self.normals, bodies)
        return Problems(taken(self.q, bodies), normals, *(taken(part, bodies) for part in self[2:]))

    def astype(self, dtype: "DTypeLike") -> "Problems":
        """The same in another precision."""
        normals = None if self.normals is None else self.normals.astype(dtype, copy=False)
        parts = (part.astype(dtype, copy=False) for part in self[2:])
        return Problems(self.q.astype(dtype, copy=False), normals, *parts)
