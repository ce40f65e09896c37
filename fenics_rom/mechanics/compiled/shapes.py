"""How far points are from obstacles: the shapes of `mechanics.obstacles`, as numbers, point after point."""

import math
from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.mechanics import frame_motion
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere

HALF_SPACE, SPHERE, CAPSULE, BOX = range(4)
MOST_NUMBERS = 16  # that tell of a shape
SHORTEST_DIRECTION = 1e-150  # m; see `mechanics.obstacles`
rotated, rotated_back, rotation_of = map(
    jit_shared, (frame_motion.rotated, frame_motion.rotated_back, frame_motion.rotation_of)
)


def shape_rows(obstacles: Sequence[Obstacle]) -> Array | None:
    """Rows (O, 17) of kind and numbers; None where a shape is of no kind that is here."""
    rows = np.zeros((len(obstacles), 1 + MOST_NUMBERS))
    for row, obstacle in zip(rows, obstacles, strict=True):
        match obstacle:
            case HalfSpace():
                numbers = [HALF_SPACE, *obstacle._n, obstacle._level]
            case Sphere():
                numbers = [SPHERE, *obstacle._center, obstacle.radius]
            case Capsule():
                start, axis = obstacle._start, obstacle._axis
                numbers = [CAPSULE, *start, *axis, *obstacle._per_length, *obstacle._perpendicular, obstacle.radius]
            case Box():
                numbers = [BOX, *obstacle._center, *obstacle._half, *obstacle._axes.ravel()]
            case _:
                return None
        row[: len(numbers)] = numbers
    return rows


@jit_apart
def measure(shapes: Array, offsets: Array, places: Array, gaps: Array, normals: Array) -> None:
    """Sets gaps (O P,), m, and unit normals (O P, 3), obstacle after obstacle.

    Args:
        shapes: (O, 17), see `shape_rows`.
        offsets: displacements of the obstacles (O, 3), m; or poses (O, 7), see `mechanics.obstacle_poses`.
        places: of the points, (P, 3), m.
        gaps, normals: set.
    """
    P = len(places)
    for o in range(len(shapes)):
        if offsets.shape[1] == 3:
            for p in range(P):
                x, y, z = places[p, 0] - offsets[o, 0], places[p, 1] - offsets[o, 1], places[p, 2] - offsets[o, 2]
                gaps[o * P + p] = distance(shapes[o], x, y, z, normals[o * P + p])
        else:
            at, R = pose_of(offsets[o])
            for p in range(P):
                gaps[o * P + p] = distance_from(shapes[o], at, R, places[p], normals[o * P + p])


@jit_part
def pose_of(row: Array) -> tuple[Vector, Rotation]:
    """Place and rotation of a pose (7,)."""
    return (row[0], row[1], row[2]), rotation_of(row[3], row[4], row[5], row[6])


@jit_part
def distance_from(shape: Array, at: Vector, R: Rotation, place: Array, n: Array) -> float:
    """As `distance`, of a place (3,) from a shape that is so posed."""
    x, y, z = rotated_back(R, (place[0] - at[0], place[1] - at[1], place[2] - at[2]))
    gap = distance(shape, x, y, z, n)
    n[0], n[1], n[2] = rotated(R, (n[0], n[1], n[2]))
    return gap


@jit_part
def distance(shape: Array, x: float, y: float, z: float, n: Array) -> float:
    """Of a place from a shape, a row of `shape_rows`, m; sets its unit normal n (3,)."""
    kind, s = int(shape[0]), shape[1:]
    if kind == HALF_SPACE:
        n[0], n[1], n[2] = s[0], s[1], s[2]
        return x * s[0] + y * s[1] + z * s[2] - s[3]
    if kind == SPHERE:
        return _direction(x - s[0], y - s[1], z - s[2], 0.0, 0.0, 1.0, n) - s[3]
    if kind == CAPSULE:
        x, y, z = x - s[0], y - s[1], z - s[2]
        along = max(0.0, min(1.0, x * s[6] + y * s[7] + z * s[8]))
        x, y, z = x - along * s[3], y - along * s[4], z - along * s[5]
        return _direction(x, y, z, s[9], s[10], s[11], n) - s[12]
    return _from_box(x - s[0], y - s[1], z - s[2], s, n)


@jit_part
def _direction(x: float, y: float, z: float, a: float, b: float, c: float, n: Array) -> float:
    """Length of a vector; sets n to its direction, to (a, b, c) where it has none."""
    length = math.sqrt(x * x + y * y + z * z)
    if length > SHORTEST_DIRECTION:
        n[0], n[1], n[2] = x / length, y / length, z / length
    else:
        n[0], n[1], n[2] = a, b, c
    return length


@jit_part
def _from_box(x: float, y: float, z: float, s: Array, n: Array) -> float:
    """Signed distance of a place, as seen from its centre, from a box; sets n."""
    a = x * s[6] + y * s[9] + z * s[12]  # along the edges
    b = x * s[7] + y * s[10] + z * s[13]
    c = x * s[8] + y * s[11] + z * s[14]
    beyond_a, beyond_b, beyond_c = abs(a) - s[3], abs(b) - s[4], abs(c) - s[5]
    gap = max(beyond_a, beyond_b, beyond_c)
    if gap < SHORTEST_DIRECTION:
        beyond_a = 1.0 if beyond_a == gap else 0.0
        beyond_b = 1.0 if beyond_a == 0.0 and beyond_b == gap else 0.0
        beyond_c = 1.0 - beyond_a - beyond_b
    else:
        beyond_a, beyond_b, beyond_c = max(beyond_a, 0.0), max(beyond_b, 0.0), max(beyond_c, 0.0)
        gap = math.sqrt(beyond_a * beyond_a + beyond_b * beyond_b + beyond_c * beyond_c)
        beyond_a, beyond_b, beyond_c = beyond_a / gap, beyond_b / gap, beyond_c / gap
    a, b, c = math.copysign(beyond_a, a), math.copysign(beyond_b, b), math.copysign(beyond_c, c)
    for j in range(3):
        n[j] = s[6 + 3 * j] * a + s[7 + 3 * j] * b + s[8 + 3 * j] * c
    return gap
