"""The contact problems of many bodies at once; arrays hold bodies along their last axis."""

from typing import NamedTuple

from numpy import ndarray as Array
from numpy.typing import DTypeLike

from fenics_rom.mechanics.body_axis import taken


class Problems(NamedTuple):
    """What is known of B bodies with P pairs each."""

    q: Array  # (3, P, B) velocities without contact, less the targets, m/s
    normals: Array  # (3, P, B) unit vectors from the obstacle to the body
    due: Array  # (P, B) which pairs may push, as 1.0 or 0.0
    friction: Array  # μ (B,)

    def of(self, bodies: Array | slice) -> "Problems":
        """Those of some of the bodies."""
        return Problems(*(taken(part, bodies) for part in self))

    def astype(self, dtype: DTypeLike) -> "Problems":
        """The same in another precision."""
        return Problems(*(part.astype(dtype, copy=False) for part in self))
