"""The contact problems of many bodies at once; arrays hold bodies along their last axis."""

from typing import NamedTuple

from numpy import ndarray as Array
from numpy.typing import DTypeLike

from fenics_rom.mechanics.body_axis import taken


class Problems(NamedTuple):
    """What is known of B bodies with P pairs each."""

    q: Array  # (3, P, B) velocities without contact, less the targets, m/s
    normals: Array | None  # (3, P, B) unit vectors from the obstacle to the body; None: the last axis for all
    due: Array  # (P, B) which pairs may push, as 1.0 or 0.0
    friction: Array  # μ (B,)

    def of(self, bodies: Array | slice) -> "Problems":
        """Those of some of the bodies."""
        normals = None if self.normals is None else taken(self.normals, bodies)
        return Problems(taken(self.q, bodies), normals, taken(self.due, bodies), taken(self.friction, bodies))

    def astype(self, dtype: DTypeLike) -> "Problems":
        """The same in another precision."""
        normals = None if self.normals is None else self.normals.astype(dtype, copy=False)
        q, due, friction = (part.astype(dtype, copy=False) for part in (self.q, self.due, self.friction))
        return Problems(q, normals, due, friction)
