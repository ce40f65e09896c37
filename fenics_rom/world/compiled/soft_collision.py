"""Points of a soft body near the surface of another one: `collision.soft_surfaces`, compiled."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.rounded_surface import meet_rounded
from fenics_rom.mechanics.compiled.triangles import nearest_on_triangle, offset_from
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.mechanics.surface_pairs import DEEPEST, MORE_ABOVE, ON_IT, SIDEWAYS
from fenics_rom.runtime.compiled.frames import added, cross, dot, length, put, vector

NONE = -1


@jit
def find_nearest(
    points: Array,
    corners: Array,
    triangles: Array,
    radii: Array,
    nodes: Array,
    around: Array,
    margin: float,
    on: Array,
    carriers: Array,
    weights: Array,
    normals: Array,
    gaps: Array,
) -> None:
    """Finds the places of a surface that are nearest to points, if nearer than a margin, m.

    Args:
        points: (P, 3), m.
        corners, triangles: of the surface, (Q, 3), m, and (T, 3) rows of these, counterclockwise from outside.
        radii, nodes, around: of its `Rounding`; none, (0,), where edges are sharp.
        margin: m.
        on: (P,) set to triangles; NONE where none is near.
        carriers, weights: (P, c) set to the points of the surface that carry the places, and their weights.
        normals: (P, 3) set to units out of the surface.
        gaps: (P,) set, m.
    """
    on[:] = NONE
    low, high = np.empty((len(triangles), 3)), np.empty((len(triangles), 3))
    size = _set_boxes(corners, triangles, low, high)
    reach = margin + DEEPEST * size
    near = _among(points, points, low, high, reach)
    boxes = _among(low, high, points[near], points[near], reach)
    for p in near:
        point, least, n, away, above = vector(points[p], 0), np.inf, (0.0, 0.0, 0.0), 0.0, 0.0
        offset, nearest = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for t in boxes:
            apart = _distance(points[p], low[t], high[t])
            if not (apart <= reach and (1 - MORE_ABOVE) * apart <= least):
                continue
            a, b, c = _corners_of(corners, triangles[t])
            share = nearest_on_triangle(point, a, b, c)
            off, out = offset_from(point, share, a, b, c), _normal(a, b, c)
            far, height = length(off), dot(off, out)
            # of triangles that share the nearest point, the one that it is most above or below knows which it is
            if far - MORE_ABOVE * abs(height) < least:
                least, away, above, n, offset = far - MORE_ABOVE * abs(height), far, height, out, off
                on[p], nearest = t, share
        if on[p] == NONE:
            continue
        if away <= ON_IT * size:
            gaps[p] = above
        elif away <= margin if above >= 0 else above < -SIDEWAYS * away and away <= reach:
            gaps[p] = away if above >= 0 else -away
            n = (offset[0] / gaps[p], offset[1] / gaps[p], offset[2] / gaps[p])
        else:
            on[p] = NONE
            continue
        if len(radii):
            found = radii, nodes, around, margin, nearest, n, gaps[p], carriers[p], weights[p]
            n, gaps[p] = meet_rounded(point, corners, triangles, on[p], *found)
        else:
            for k in range(3):
                carriers[p, k], weights[p, k] = triangles[on[p], k], nearest[k]
        put(normals[p], 0, n)


@jit_part
def _set_boxes(corners: Array, triangles: Array, low: Array, high: Array) -> float:
    """Sets those around triangles, (T, 3); their longest side, m."""
    size = 0.0
    for t in range(len(triangles)):
        a, b, c = _corners_of(corners, triangles[t])
        for k in range(3):
            low[t, k], high[t, k] = min(a[k], b[k], c[k]), max(a[k], b[k], c[k])
            size = max(size, high[t, k] - low[t, k])
    return size


@jit_part
def _corners_of(corners: Array, triangle: Array) -> tuple[Vector, Vector, Vector]:
    return vector(corners[triangle[0]], 0), vector(corners[triangle[1]], 0), vector(corners[triangle[2]], 0)


@jit_part
def _among(low: Array, high: Array, lows: Array, highs: Array, reach: float) -> Array:
    """Which boxes (n, 3) are nearer than a reach, m, to the box around others."""
    begin, end = np.full(3, np.inf), np.full(3, -np.inf)
    for t in range(len(lows)):
        for k in range(3):
            begin[k], end[k] = min(begin[k], lows[t, k]), max(end[k], highs[t, k])
    some, count = np.empty(len(low), dtype=np.int64), 0
    for t in range(len(low)):
        if _is_beside(low[t], high[t], begin, end, reach):
            some[count] = t
            count += 1
    return some[:count]


@jit_part
def _is_beside(low: Array, high: Array, begin: Array, end: Array, reach: float) -> bool:
    """Whether two boxes are nearer than a reach, m, along all axes."""
    beside = True
    for k in range(3):
        beside = beside and low[k] <= end[k] + reach and high[k] >= begin[k] - reach
    return beside


@jit_part
def _distance(point: Array, low: Array, high: Array) -> float:
    """From a point to a box, along the axis where it is farthest."""
    apart = 0.0
    for k in range(3):
        apart = max(apart, low[k] - point[k], point[k] - high[k])
    return apart


@jit_part
def _normal(a: Vector, b: Vector, c: Vector) -> Vector:
    """A unit, of a triangle."""
    n = cross(added(b, -1.0, a), added(c, -1.0, a))
    size = length(n)
    return n[0] / size, n[1] / size, n[2] / size
