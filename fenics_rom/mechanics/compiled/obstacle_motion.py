"""How obstacles move in a step, and how points are beside them: `mechanics.contact_look`, compiled.

Where one of O obstacles turns, rows of all are poses (O, 7), and velocities of all have angular ones, (O, 6): see
`mechanics.obstacle_poses`.
"""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.mechanics import frame_motion
from fenics_rom.mechanics.compiled.shapes import distance_from, measure, pose_of
from fenics_rom.mechanics.compiled.work_space import take_rows
from fenics_rom.mechanics.contact_look import SAME_SIDE
from fenics_rom.mechanics.frame_motion import LEAST_COSINE, Quaternion, Vector

added, cross, dot = map(jit_shared, (frame_motion.added, frame_motion.cross, frame_motion.dot))
composed, rotated = map(jit_shared, (frame_motion.composed, frame_motion.rotated))
rotation_of = jit_shared(frame_motion.rotation_of)


class Moving(NamedTuple):
    """How O obstacles move in a step."""

    start: Array  # displacements, (O, 3), m; or poses, (O, 7)
    end: Array
    before: Array  # velocities in the step before, (O, 3), m/s; or with angular velocities, (O, 6)


class Beside(NamedTuple):
    """What N pairs of a point and an obstacle have of how that moves in a step."""

    w: Array  # velocities of the obstacles, (O, 3), m/s; of each pair, (N, 3), where one turns
    before: Array  # (O, 3) in the step before; (N, 3) between that and this one, where one turns
    first: Array  # normals (N, 3) at the start, where one turns; else (0, 3)


@jit_part
def turn(moving: Moving) -> bool:
    """Whether poses are given."""
    return moving.start.shape[1] > 3


@jit_part
def moving_in(path: Moving, step: int) -> Moving:
    """How obstacles move in one of steps in a row, of arrays with these first; with one row alone where they rest."""
    row = min(step, len(path.start) - 1)
    return Moving(path.start[row], path.end[row], path.before[row])


@jit_part
def room_beside(moving: Moving, pairs: int) -> int:
    """Numbers of a work space that `begin_beside` takes."""
    return 9 * pairs if turn(moving) else 3 * len(moving.start)


@jit_part
def begin_beside(moving: Moving, h: float, pairs: int, space: Array) -> Beside:
    """Velocities of obstacles in a step of h s; where one turns, room for what `look` sets."""
    if turn(moving):
        return Beside(take_rows(space, pairs, 3), take_rows(space, pairs, 3), take_rows(space, pairs, 3))
    w = take_rows(space, len(moving.start), 3)
    for o in range(len(w)):
        for k in range(3):
            w[o, k] = (moving.end[o, k] - moving.start[o, k]) / h
    return Beside(w, moving.before, take_rows(space, 0, 3))


@jit_part
def _between(start: Array, end: Array) -> Quaternion:
    """The rotation from one pose (7,) to another one."""
    there, back = (end[3], end[4], end[5], end[6]), (start[3], -start[4], -start[5], -start[6])
    return composed(there, back)


@jit_part
def turn_too_far(moving: Moving) -> bool:
    """Whether nobody knows which way an obstacle turns."""
    for o in range(len(moving.start) if turn(moving) else 0):
        if not abs(_between(moving.start[o], moving.end[o])[0]) >= LEAST_COSINE:
            return True
    return False


@jit_part
def row_of(w: Array, pair: int, pairs: int, points: int) -> int:
    """Which row of velocities of obstacles, or of all pairs, is that of a pair."""
    return pair if len(w) == pairs else pair // points


@jit_part
def look(shapes: Array, moving: Moving, h: float, places: Array, gaps: Array, normals: Array, beside: Beside) -> None:
    """Sets gaps (N,), m, at the start of a step of h s, and normals (N, 3); where an obstacle turns, at its end.

    Args:
        shapes: (O, 17), see `shapes.shape_rows`.
        moving: the obstacles.
        h: s.
        places: of the points (P, 3), m.
        gaps, normals: set, obstacle after obstacle.
        beside: of `begin_beside`; set, where an obstacle turns.
    """
    if not turn(moving):
        measure(shapes, moving.start, places, gaps, normals)
        return
    for o in range(len(shapes)):
        _look_at_turning(
            shapes[o], moving.start[o], moving.end[o], moving.before[o], h, places, o, gaps, normals, beside
        )


@jit_part
def _vector(numbers: Array, first: int) -> Vector:
    return numbers[first], numbers[first + 1], numbers[first + 2]


@jit_apart
def _look_at_turning(
    shape: Array,
    start: Array,
    end: Array,
    before: Array,
    h: float,
    places: Array,
    number: int,
    gaps: Array,
    normals: Array,
    beside: Beside,
) -> None:
    """The same of an obstacle, by its number, whose poses (7,) and velocities before (6,) these are."""
    by, (p, R), (p_end, R_end) = _between(start, end), pose_of(start), pose_of(end)
    turn_by, gone = rotation_of(by[0], by[1], by[2], by[3]), added(p_end, -1.0, p)
    spin = by[1] / by[0] / h, by[2] / by[0] / h, by[3] / by[0] / h  # half of ω̂
    velocity = added((gone[0] / (2 * h), gone[1] / (2 * h), gone[2] / (2 * h)), 0.5, _vector(before, 0))
    ω = added(spin, 0.5, _vector(before, 3))
    for i in range(len(places)):
        c, arm = number * len(places) + i, added(_vector(places[i], 0), -1.0, p)
        first, n, w, now = beside.first[c], normals[c], beside.w[c], beside.before[c]
        gaps[c] = distance_from(shape, p, R, places[i], first)
        later = distance_from(shape, p_end, R_end, places[i], n)
        now[0], now[1], now[2] = added(velocity, 1.0, cross(ω, arm))
        way, turned = added(gone, 1.0, added(rotated(turn_by, arm), -1.0, arm)), rotated(turn_by, _vector(first, 0))
        closing = (gaps[c] - later) / h
        if dot(turned, _vector(n, 0)) < SAME_SIDE:  # it passes the point
            n[0], n[1], n[2] = turned
            closing = dot(way, turned) / h
        more = closing - dot(way, _vector(n, 0)) / h
        for k in range(3):
            w[k] = way[k] / h + more * n[k]
