"""Where obstacles are: rows of displacements (O, 3), m, or, where one of them turns, of poses (O, 7).

A pose is a displacement and a unit quaternion w x y z: what the scene puts at X is at p + R X. A step turns an obstacle
by a rotation ΔR = cay(h ω̂) about p (see `frame_motion`), so that its point that is at x at the start goes by

    h w = Δp + (ΔR - 1)(x - p) = h v̂ + h ω̂ × (1 + ΔR)/2 (x - p)
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_fit import told_misfit
from fenics_rom.mechanics.base_path import CONJUGATE, BaseState, given_base, quaternion_product, rotation_vectors
from fenics_rom.mechanics.frame_motion import (
    LEAST_COSINE,
    MOST_TURNED,
    quaternion_of_vector,
    rotation_matrices,
    rotation_matrix,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from fenics_rom.mechanics.obstacles import Obstacle

NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])


class PoseSignal:
    """Poses of an obstacle over time, as rows.

    Args:
        name: of the obstacle, for messages.
        origin: (3,), m, in the scene, of the point whose position is given.
        given: a BaseState, a BasePath or a function of time, s.

    Raises:
        StepError: it is none of these, or a path with a mistake.
    """

    def __init__(self, name: str, origin: "ArrayLike", given: object):
        self.is_constant, self._origin = not callable(given), np.array(origin, dtype=float)
        self._motion = given_base(given, name)
        self._last: tuple[float, BaseState] | None = None  # asked for

    def at(self, time: float) -> Array:
        """The pose (7,) at a time, s."""
        return pose_row(self._state(time), self._origin)

    def misfit(self, start: float, end: float, size: float) -> tuple[float, float]:
        """How far poses and twists of an obstacle of a size, m, are apart between two times, s; see `base_fit`."""
        return told_misfit(self._state(start), self._state(end), end - start, size)

    def _state(self, time: float) -> BaseState:
        if self._last is None or self._last[0] != time:
            self._last = time, self._motion(time)
        return self._last[1]


def pose_row(state: BaseState, origin: Array) -> Array:
    """The pose (7,) of an obstacle whose point at `origin` (3,), m, is where the state says."""
    R = rotation_matrix(state.rotation)
    return np.concatenate([state.position - R.dot(origin), state.rotation])


def state_of(row: Array, origin: Array) -> BaseState:
    """The same back, at rest."""
    return BaseState(row[:3] + rotation_matrix(row[3:]).dot(origin), row[3:].copy(), np.zeros(3), np.zeros(3))


def rotated(vectors: Array, row: Array) -> Array:
    """Vectors (P, 3) in the axes of an obstacle that is so displaced, or posed, in those of the world."""
    return vectors if len(row) == 3 else vectors.dot(rotation_matrix(row[3:]).T)


def rotated_back(vectors: Array, row: Array) -> Array:
    """The same the other way round."""
    return vectors if len(row) == 3 else vectors.dot(rotation_matrix(row[3:]))


def with_turns(rows: Sequence[Array]) -> list[Array]:
    """Displacements and poses, (..., 3) and (..., 7): all as poses, if one of them is."""
    if all(each.shape[-1] == 3 for each in rows):
        return list(rows)
    still = (np.broadcast_to(NO_TURN, (*each.shape[:-1], 4)) for each in rows)
    return [
        np.concatenate([each, turn], axis=-1) if each.shape[-1] == 3 else each
        for each, turn in zip(rows, still, strict=True)
    ]


def seen(points: Array, row: Array) -> Array:
    """Points (P, 3), m, as the obstacle has them in its own axes."""
    return rotated_back(points - row[:3], row)


def placed(points: Array, row: Array) -> Array:
    """Where points (P, 3) of its own axes are, m."""
    moved: Array = rotated(points, row) + row[:3]
    return moved


def distance_from(shape: "Obstacle", points: Array, row: Array) -> tuple[Array, Array]:
    """As `Obstacle.distance`, of one that is so displaced, or posed."""
    gaps, normals = shape.distance(seen(points, row))
    return gaps, rotated(normals, row)


def curvature_from(shape: "Obstacle", points: Array, row: Array) -> Array:
    """As `Obstacle.curvature`, of one that is so displaced, or posed."""
    curvature = shape.curvature(seen(points, row))
    if len(row) == 3:
        return curvature
    R = rotation_matrix(row[3:])
    turned: Array = R @ curvature @ R.T
    return turned


def distances_from(shapes: "Sequence[Obstacle]", points: Array, rows: Array) -> tuple[Array, Array]:
    """The same of several, one after another: gaps (O P,), m, and normals (O P, 3)."""
    distances = [distance_from(shape, points, row) for shape, row in zip(shapes, rows, strict=True)]
    return np.concatenate([gap for gap, _ in distances]), np.concatenate([normal for _, normal in distances])


def rotations_between(start: Array, end: Array) -> Array:
    """Unit quaternions (O, 4) that lead from poses (O, 7) to others."""
    return quaternion_product(end[:, 3:], start[:, 3:] * CONJUGATE)


def carried(vectors: Array, start: Array, end: Array) -> Array:
    """Vectors (O, P, 3) that turn with obstacles, whose poses (O, 7) go from some to others."""
    turned: Array = vectors @ np.swapaxes(rotation_matrices(rotations_between(start, end)), 1, 2)
    return turned


def mean_twists(start: Array, end: Array, dt: float) -> Array:
    """v̂, m/s, and ω̂, rad/s, (O, 6) of a step of dt, s, from poses (O, 7) to others.

    Raises:
        StepError: one turns by more than MOST_TURNED.
    """
    turns = rotations_between(start, end)
    if not (np.abs(turns[:, 0]) >= LEAST_COSINE).all():
        angle = np.linalg.norm(rotation_vectors(turns), axis=1).max()
        raise StepError(
            f"an obstacle is told to turn by {angle:.3g} rad in a step of {dt:g} s: at most {MOST_TURNED:g} rad; "
            "a smaller dt is the cure"
        )
    return np.hstack([end[:, :3] - start[:, :3], 2 * turns[:, 1:] / turns[:, :1]]) / dt


def mean_velocities(starts: Array, ends: Array, dt: float) -> Array:
    """Of steps of dt, s, in a row, as of `ObstacleMotion.velocities`: (n, O, 3) or (n, O, 6) of rows (n, O, any).

    Raises:
        StepError: as of `mean_twists`.
    """
    if starts.shape[2] == 3:
        return (ends - starts) / dt
    return mean_twists(starts.reshape(-1, 7), ends.reshape(-1, 7), dt).reshape(*starts.shape[:2], 6)


def velocities_at(places: Array, start: Array, end: Array, twists_before: Array, dt: float) -> tuple[Array, Array]:
    """Velocities (O, P, 3), m/s, of what of each obstacle is at places (P, 3), m, when a step of dt, s, begins.

    Args:
        places, dt: as above.
        start, end: poses (O, 7).
        twists_before: of the step before, (O, 6).

    Returns:
        The means of the step; and those between both steps, when it begins.
    """
    arms = places - start[:, None, :3]
    ways = (end - start)[:, None, :3] + carried(arms, start, end) - arms
    twists = (mean_twists(start, end, dt) + twists_before) / 2
    return ways / dt, twists[:, None, :3] + np.cross(twists[:, None, 3:], arms)


def between(start: Array, end: Array, share: float) -> Array:
    """Rows a share of the way from some to others, (O, 3) or (O, 7)."""
    rows: Array = start + share * (end - start)
    if start.shape[1] > 3:
        for row, here, turn in zip(rows, start, rotation_vectors(rotations_between(start, end)), strict=True):
            row[3:] = quaternion_product(quaternion_of_vector(share * turn), here[3:])
    return rows


def farthest_moved(shape: "Obstacle", start: Array, end: Array) -> float:
    """No point of an obstacle went farther from one row to another one, m; infinite of a half-space that turns."""
    way = math.dist(start[:3], end[:3])
    if len(start) == 3 or np.array_equal(start[3:], end[3:]):
        return way
    (turn,) = rotation_vectors(rotations_between(start[None], end[None]))
    return way + math.hypot(*turn) * shape.extent
