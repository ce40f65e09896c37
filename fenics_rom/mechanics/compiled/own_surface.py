"""A surface against itself, compiled: what its points meet, and how pairs of a point and a triangle move by forces."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.copying import add_row, put
from fenics_rom.mechanics.compiled.triangles import dot, nearest_on_triangle, offset_from
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.mechanics.surface_pairs import BORDER, MORE_ABOVE, ON_IT, SIDEWAYS

NONE = -1


@jit
def find_facing(
    points: Array,
    triangles: Array,
    normals: Array,
    outwards: Array,
    row: Array,
    triangle: Array,
    low: Array,
    high: Array,
    sides: Array,
    corners: Array,
    size: float,
    margin: float,
    reach: float,
    on: Array,
    weights: Array,
    along: Array,
    gaps: Array,
) -> None:
    """What points meet of their own surface, as `own_surface.OwnSurface` and `surface_pairs.nearest_of` have it.

    Args:
        points, triangles: (n, 3), m, and (t, 3) rows of them.
        normals, outwards: of the triangles (t, 3), units, and of the points (n, 3), of any length.
        row, triangle: points and triangles (k,) that may touch.
        low, high: ends of boxes (t, 3), m, outside of which no point is near.
        sides, corners: of the triangles on the border, (t, 3).
        size, margin, reach: as of `nearest_of`.
        on: (n,) set to triangles; NONE of points that meet nothing.
        weights, along, gaps: (n, 3), (n, 3), (n,) set: of the corners, normals of the pairs, and m.
    """
    on[:] = NONE
    best, high_above = np.full(len(points), np.inf), np.empty(len(points))
    for k in range(len(row)):
        p, t = row[k], triangle[k]
        if not _holds(points[p], low[t], high[t]) or _dot(outwards[p], normals[t]) >= 0:
            continue
        a, b, c = _row(points, triangles[t, 0]), _row(points, triangles[t, 1]), _row(points, triangles[t, 2])
        point = _row(points, p)
        share = nearest_on_triangle(point, a, b, c)
        off = offset_from(point, share, a, b, c)
        away, above = math.sqrt(dot(off, off)), dot(off, _row(normals, t))
        if away - MORE_ABOVE * abs(above) < best[p]:
            best[p], high_above[p], gaps[p], on[p] = away - MORE_ABOVE * abs(above), above, away, t
            put(weights[p], share[0], share[1], share[2])
            put(along[p], off[0], off[1], off[2])
    for p in range(len(points)):
        t, above, away = on[p], high_above[p], gaps[p]
        if t == NONE:
            continue
        is_on = is_flat = away <= ON_IT * size
        for k in range(3):
            share = weights[p, k]
            is_border = (share == 0.0 and sides[t, k]) or (share == 1.0 and corners[t, k])
            is_flat = is_flat or (is_border and away * away - above * above <= (BORDER * size) ** 2)
        inside = above < -SIDEWAYS * away and away <= reach
        is_kept = is_on or (away <= margin if above >= 0 else inside) or (is_flat and -reach <= above <= margin)
        if not is_kept:
            on[p] = NONE
        elif is_flat:
            gaps[p] = above
            put(along[p], normals[t, 0], normals[t, 1], normals[t, 2])
        else:
            gaps[p] = math.copysign(away, above)
            put(along[p], along[p, 0] / gaps[p], along[p, 1] / gaps[p], along[p, 2] / gaps[p])


@jit
def rows_between(W: Array, at: Array, maps: Array, between: Array) -> None:
    """Sets rows of pairs, (3 C, n).

    Args:
        W: rows of some points, (3 s, n).
        at: which of them pairs move with, (C, m).
        maps: the velocity of pairs per theirs, (C, m, 3, 3).
        between: set.
    """
    between[:] = 0.0
    for c in range(len(at)):
        for i in range(3):
            for point in range(at.shape[1]):
                for j in range(3):
                    if maps[c, point, i, j] != 0.0:
                        add_row(W[3 * at[c, point] + j], maps[c, point, i, j], between[3 * c + i])


@jit_part
def _row(array: Array, k: int) -> Vector:
    return array[k, 0], array[k, 1], array[k, 2]


@jit_part
def _dot(a: Array, b: Array) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@jit_part
def _holds(x: Array, low: Array, high: Array) -> bool:
    """Whether a box holds a point."""
    holds = True
    for k in range(3):
        holds = holds and low[k] <= x[k] <= high[k]
    return holds
