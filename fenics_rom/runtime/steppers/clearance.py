"""A bound of the distance from obstacles that lasts: steps that cannot reach them do not look at them."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion, is_zero
from fenics_rom.mechanics.reach import reach_at


def stretch_of(points: Array) -> Array:
    """The largest displacement of a point by each coordinate, (m,), of Sᵀ (m, 3P)."""
    stretch: Array = np.linalg.norm(points.reshape(len(points), -1, 3), axis=2).max(axis=1, initial=0.0)
    return stretch


class Clearance:
    """How far the contact points are from obstacles that rest, at least, from step to step.

    Args:
        points: Sᵀ (m, 3P).
        h: time step, s.
    """

    def __init__(self, points: Array, h: float):
        self._stretch = stretch_of(points)
        self._h, self._room, self._known = h, 0.0, (b"", b"")
        self._obstacles: ObstacleMotion | None = None

    def lasts(self, obstacles: ObstacleMotion | None, state: Array, rigid: Array) -> bool:
        """Whether it is known where the body is, in a state (2m,) and displaced along its rigid motions by (ρ,)."""
        return self._room > 0 and obstacles is self._obstacles and self._known == (state.tobytes(), rigid.tobytes())

    def is_enough(self, v: Array, r: Array, beyond: float) -> bool:
        """Whether no point can need forces in a step.

        It has rates r (m,) at its start, v̂ (m,) in its middle, and adds this speed at most beyond the basis, m/s.
        """
        free, start = (beyond + float(self._stretch.dot(np.abs(each))) for each in (v, r))
        return self._room > reach_at(self._h, free, start, 0.0)

    def set(self, gap: float, obstacles: ObstacleMotion) -> None:
        """Has it be a gap, m, at the start of a step; where the obstacles move it does not last."""
        rests = obstacles.end is obstacles.start and is_zero(obstacles.velocities_before)
        self._room, self._obstacles = gap if rests else 0.0, obstacles

    def go_on(self, v: Array, beyond: float, state: Array, rigid: Array) -> None:
        """Has it be that after such a step, which led there; arguments as in `lasts`."""
        self._room -= self._h * (beyond + float(self._stretch.dot(np.abs(v))))
        self._known = state.tobytes(), rigid.tobytes()
