"""What the contact law looks at in a step: gaps, normals, and how fast obstacles move where points are.

An obstacle that moves by translation has the normals and the velocity that it had at the start. One that turns is seen
as it is at the end. There g₀ and g₁ are the gaps that points would have at the start and at the end if they stayed
where they are, and n the normals at the end. Its velocity w is that of its material along the surface, and (g₀ - g₁)/h
along n. So g₀ + h n·(v̂ - w) = g₁ + h n·v̂: what keeps this positive is not inside a convex obstacle at the end, however
far it turns; what sticks moves with the material; and a round one that spins about its axis pushes nothing aside.

An obstacle may pass a point in a step: the nearest place at the end is then on another side of it. There n is the
normal at the start, turned with the obstacle, and w the velocity of the material. So g₀ + h n·(v̂ - w) is how far the
point is before that plane.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.obstacle_poses import carried

SAME_SIDE = 0.5  # cosine between normals: what differs by more is on another side
_ONES = np.ones(3)

# Gaps (O P,), m, and normals (O P, 3) of points that have moved by (P, 3), m, from obstacles in rows (O, any).
Distances = Callable[[Array, Array], tuple[Array, Array]]


class Look(NamedTuple):
    """Of all pairs of O obstacles and P points, obstacle after obstacle."""

    gaps: Array  # at the start, (O P,), m
    gap: float  # the smallest, m
    normals: Array  # (O P, 3)
    w: Array  # velocities of the obstacles (O, 3), m/s; of each pair (O P, 3), if one of them turns
    turning: "TurningLook | None" = None  # None where none turns

    def surface(self, pairs: Array) -> Array | None:
        """Velocities (C, 3) of what turns at pairs (C,), m/s; None where nothing turns."""
        return None if self.turning is None else self.w.take(pairs, axis=0)


class TurningLook(NamedTuple):
    """What is to be known beside that of obstacles that turn."""

    now: Array  # velocities of their material at the start (O P, 3), m/s
    first: Array  # normals at the start (O P, 3)

    def approach(self, velocities: Array, normals: Array) -> Array:
        """Velocities (O P, 3), m/s, of points beside obstacles at the start, as fast along n as they near them then."""
        relative: Array = velocities - self.now
        relative += ((self.first - normals) * relative).dot(_ONES)[:, None] * normals
        return relative


def look_at(distances: Distances, rest: Array, displacement: Array, obstacles: ObstacleMotion, dt: float) -> Look:
    """Of points at rest (P, 3) that have moved by (P, 3), m, whose gaps and normals `distances` tells."""
    at_start = distances(displacement, obstacles.start)
    if not obstacles.turns:
        gaps, normals = at_start
        return Look(gaps, gaps.item(gaps.argmin()), normals, obstacles.velocities(dt))
    at_end = at_start if obstacles.end is obstacles.start else distances(displacement, obstacles.end)
    return _look_at_turning(at_start, at_end, rest + displacement, obstacles, dt)


def relative_velocities(
    free: Array, start: Array, look: Look, obstacles: ObstacleMotion, before: ContactSearch
) -> tuple[Array, Array]:
    """Of velocities of pairs (O P, 3) in the middle of a step and at its start, those relative to obstacles, m/s."""
    w = look.w
    if look.turning is not None:
        now = look.turning.approach(start, look.normals)
        return free - w, np.where(before.pushed[:, None], now, start - w)
    each = len(free) // len(w)
    if obstacles.end is not obstacles.start:
        motion = w.repeat(each, axis=0)
        free, start = free - motion, start - motion
    if w.tobytes() != obstacles.velocities_before.tobytes():
        # What keeps touching an obstacle that accelerates has its velocity between the steps, and not yet the mean
        # one of this step. Taken for an approach, the difference would let it sink in further in every step.
        gained = (w - obstacles.velocities_before).repeat(each, axis=0) / 2
        start = start + before.pushed[:, None] * gained
    return free, start


def _look_at_turning(
    at_start: tuple[Array, Array], at_end: tuple[Array, Array], places: Array, obstacles: ObstacleMotion, dt: float
) -> Look:
    """Of gaps (O P,) and normals (O P, 3) of points at places (P, 3), m, with poses at the start and at the end."""
    (gaps, first), (later, normals) = at_start, at_end
    w, now = (each.reshape(-1, 3) for each in obstacles.velocities_at(places, dt))
    turned = carried(first.reshape(len(obstacles.start), -1, 3), obstacles.start, obstacles.end).reshape(-1, 3)
    passes = (turned * normals).dot(_ONES) < SAME_SIDE
    normals = np.where(passes[:, None], turned, normals)
    is_near = np.isfinite(gaps) & ~passes  # planes of meshes may not be there
    speeds = (w * normals).dot(_ONES)
    closing = np.subtract(gaps, later, out=dt * speeds, where=is_near) / dt
    w = w + (closing - speeds)[:, None] * normals
    return Look(gaps, gaps.item(gaps.argmin()), normals, w, TurningLook(now, first))
