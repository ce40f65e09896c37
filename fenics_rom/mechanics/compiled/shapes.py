"""How far points are from obstacles: the shapes of `mechanics.obstacles`, as numbers, point after point."""

import math
from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere

HALF_SPACE, SPHERE, CAPSULE, BOX = range(4)
MOST_NUMBERS = 16  # that tell of a shape
SHORTEST_DIRECTION = 1e-150  # m; see `mechanics.obstacles`


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


@jit
def measure(shapes: Array, offsets: Array, places: Array, gaps: Array, normals: Array) -> None:
    """Sets gaps (O P,), m, and unit normals (O P, 3), obstacle after obstacle.

    Args:
        shapes: (O, 17), see `shape_rows`.
        offsets: displacements of the obstacles (O, 3), m.
        places: of the points, (P, 3), m.
        gaps, normals: set.
    """
    P = len(places)
    for o in range(len(shapes)):
        for p in range(P):
            x, y, z = places[p, 0] - offsets[o, 0], places[p, 1] - offsets[o, 1], places[p, 2] - offsets[o, 2]
            gaps[o * P + p] = distance(shapes[o], x, y, z, normals[o * P + p])


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
    local, beyond, deepest, face = np.empty(3), np.empty(3), -np.inf, 0
    for k in range(3):
        local[k] = x * s[6 + k] + y * s[9 + k] + z * s[12 + k]
        excess = abs(local[k]) - s[3 + k]
        beyond[k] = math.copysign(max(excess, 0.0), local[k])
        if excess > deepest:
            deepest, face = excess, k
    gap = deepest
    if deepest < SHORTEST_DIRECTION:
        for k in range(3):
            beyond[k] = math.copysign(1.0, local[k]) if k == face else 0.0
    else:
        gap = _direction(beyond[0], beyond[1], beyond[2], 0.0, 0.0, 1.0, beyond)
    for j in range(3):
        n[j] = s[6 + 3 * j] * beyond[0] + s[7 + 3 * j] * beyond[1] + s[8 + 3 * j] * beyond[2]
    return gap
