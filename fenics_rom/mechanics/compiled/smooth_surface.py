"""Normals and gaps of triangles that stand for a smooth surface: `mechanics.smooth_surface`, compiled."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.triangles import added, dot
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.mechanics.smooth_surface import CREASE, FLAT, SMOOTH


@jit_part
def normals_at_corners(points: Array, triangles: Array, bends: Array) -> Array:
    """As `smooth_surface.corner_normals`, of points (n, 3), m, and triangles (t, 3) of them."""
    count = 0
    for t in range(len(bends)):
        for k in range(3):
            count = max(count, bends[t, k] + 1)
    normals = np.zeros((count, 3))
    for t in range(len(bends)):
        for k in range(3):
            here, after = _row(points, triangles[t, k]), _row(points, triangles[t, (k + 1) % 3])
            before = _row(points, triangles[t, (k + 2) % 3])
            u, v, own = added(after, -1.0, here), added(before, -1.0, here), normals[bends[t, k]]
            weight = 1 / (dot(u, u) * dot(v, v))
            own[0] += weight * (u[1] * v[2] - u[2] * v[1])
            own[1] += weight * (u[2] * v[0] - u[0] * v[2])
            own[2] += weight * (u[0] * v[1] - u[1] * v[0])
    for f in range(count):
        n = _row(normals, f)
        size = math.sqrt(dot(n, n))
        for k in range(3):
            normals[f, k] /= size
    return normals


@jit_part
def smoothed(
    bends: Array,
    normals: Array,
    share: Vector,
    a: Vector,
    b: Vector,
    c: Vector,
    offset: Vector,
    flat: Vector,
    clear: bool,
    n: Vector,
    gap: float,
) -> tuple[Vector, float]:
    """As `smooth_surface.smoothed`, of one place.

    Args:
        bends, normals: of its triangle, (9,), and at all corners, (f, 3).
        share: weights of the corners a, b, c, m.
        offset, flat, clear: as there.
        n, gap: normal and gap as of flat triangles.
    """
    at = _row(normals, bends[0]), _row(normals, bends[1]), _row(normals, bends[2])
    curved = False
    for k in range(3):
        for x in range(3):
            curved = curved or abs(at[k][x] - flat[x]) > FLAT
    if not curved:
        return n, gap
    rise, sharp = 0.0, False
    corners = (a, b, c)
    for k in range(3):
        i, j, side = (k + 1) % 3, (k + 2) % 3, bends[3 + k]
        if side != CREASE:
            rise += share[i] * share[j] * dot(added(at[j], -1.0, at[i]), added(corners[j], -1.0, corners[i])) / 2
        sharp = sharp or (share[k] == 0.0 and side != SMOOTH) or (share[k] == 1.0 and bends[6 + k] != SMOOTH)
    if not (clear and sharp):
        n = added((0.0, 0.0, 0.0), share[0], at[0])
        n = added(added(n, share[1], at[1]), share[2], at[2])
        size = math.sqrt(dot(n, n))
        n = n[0] / size, n[1] / size, n[2] / size
        gap = dot(n, offset)
    return n, gap - rise


@jit_part
def _row(array: Array, k: int) -> Vector:
    return array[k, 0], array[k, 1], array[k, 2]
