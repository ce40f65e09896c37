"""A surface against itself, compiled: what its points meet, as `own_surface.OwnSurface` has it."""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.copying import add_row, copy, put
from fenics_rom.mechanics.compiled.triangles import added, dot, nearest_on_triangle, offset_from
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.mechanics.surface_pairs import BORDER, MORE_ABOVE, ON_IT, OPPOSITE, SIDEWAYS, SLACK

NONE = -1
SURE = 1 - 1e-5  # of a distance that others are compared with before they are known


class Surface(NamedTuple):
    """Of n points, of which k may touch, and t triangles."""

    triangles: Array  # (t, 3) rows of points
    touching: Array  # rows of points (k,)
    may: Array  # which of these may touch which triangles (k, t)
    outer: tuple[Array, Array]  # points and triangles (j,) that those are on
    sides: Array  # of the triangles on the border (t, 3),
    corners: Array


class Candidates(NamedTuple):
    """Points and triangles that may touch, as they were looked for."""

    points: Array  # then, (n, 3), m
    low: Array  # ends of boxes then, (t, 3), m
    high: Array
    row: Array  # (k t,), of which so many count:
    triangle: Array
    known: Array  # (1,); -1: they are not known
    sizes: Array  # the margin about boxes, and by how much more they were looked for, (2,), m


@jit
def set_boxes(points: Array, triangles: Array, low: Array, high: Array, normals: Array) -> float:
    """Sets ends of boxes about triangles, and their normals, (t, 3) each; the longest side of a box, m."""
    size = 0.0
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        for k in range(3):
            low[t, k] = min(points[a, k], points[b, k], points[c, k])
            high[t, k] = max(points[a, k], points[b, k], points[c, k])
            size = max(size, high[t, k] - low[t, k])
        u, v = added(_row(points, b), -1.0, _row(points, a)), added(_row(points, c), -1.0, _row(points, a))
        x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        length = math.sqrt(x * x + y * y + z * z)
        put(normals[t], x / length, y / length, z / length)
    return size


@jit
def drift_of(points: Array, low: Array, high: Array, before: Array, low_before: Array, high_before: Array) -> float:
    """How much nearer, m, points and boxes can have come since they were others: half of it, at most."""
    most = 0.0
    for p in range(len(points)):
        for k in range(3):
            most = max(most, abs(points[p, k] - before[p, k]))
    for t in range(len(low)):
        for k in range(3):
            most = max(most, low_before[t, k] - low[t, k], high[t, k] - high_before[t, k])
    return most


@jit_part
def look_for(
    surface: Surface, known: Candidates, points: Array, low: Array, high: Array, size: float, margin: float
) -> int:
    """Sets candidates, unless those that are known still have all that are within a margin, m; how many there are.

    As `own_surface.OwnSurface` has them; boxes with ends (t, 3) have the longest side `size`, m.
    """
    if known.known[0] >= 0:
        drift = drift_of(points, low, high, known.points, known.low, known.high)
        if drift + max(margin - known.sizes[0], 0.0) <= known.sizes[1] / 2:
            return int(known.known[0])
    slack, count = max(SLACK * size, margin / 2), 0
    for k in range(len(surface.touching)):
        p = surface.touching[k]
        for t in range(len(low)):
            if surface.may[k, t] and _holds(points, p, low, high, t, margin + slack):
                known.row[count], known.triangle[count] = p, t
                count += 1
    copy(points, known.points)
    copy(low, known.low)
    copy(high, known.high)
    known.known[0], known.sizes[0], known.sizes[1] = count, margin, slack
    return count


@jit
def margin_among(
    points: Array, ways: Array, row: Array, triangle: Array, triangles: Array, low: Array, high: Array
) -> float:
    """How near, m, those of some points and triangles (k,) come to one another that may meet: see `OwnSurface.margin`.

    points: (n, 3), m; ways: (w, n, 3), m; low, high: ends of boxes (t, 3), m.
    """
    most = 0.0
    for k in range(len(row)):
        p, t, goes, square = row[k], triangle[k], 0.0, 0.0
        for way in ways:
            largest = 0.0
            for corner in triangles[t]:
                x, y, z = way[p, 0] - way[corner, 0], way[p, 1] - way[corner, 1], way[p, 2] - way[corner, 2]
                largest = max(largest, x * x + y * y + z * z)
            goes += math.sqrt(largest)
        for j in range(3):
            outside = max(low[t, j] - points[p, j], points[p, j] - high[t, j], 0.0)
            square += outside * outside
        if square <= goes * goes:
            most = max(most, goes)
    return most


@jit
def find_facing(
    points: Array,
    triangles: Array,
    normals: Array,
    outer: tuple[Array, Array],
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
    twin: Array,
    weights: Array,
    plain: Array,
    along: Array,
    gaps: Array,
) -> None:
    """What points meet of their own surface, as `own_surface.OwnSurface` and `surface_pairs.nearest_of` have it.

    Args:
        points, triangles: (n, 3), m, and (t, 3) rows of them.
        normals: of the triangles (t, 3), units.
        outer: points and triangles (j,) that those are on: what outward vectors of the points are sums of.
        row, triangle: points and triangles (k,) that may touch.
        low, high: ends of boxes (t, 3), m; no point is near that is farther outside than margin and reach.
        sides, corners: of the triangles on the border, (t, 3).
        size, margin, reach: as of `nearest_of`.
        on: (n,) set to triangles; NONE of points that meet nothing.
        twin: (n,) set to points that are opposite, each to the other; NONE of others.
        weights: (n, 3) set, of the corners.
        plain, along: (n, 3) set, normals of the triangles or the ways there, and those of the pairs.
        gaps: (n,) set, m.
    """
    n = len(points)
    on[:], twin[:] = NONE, NONE
    farthest = max(margin, reach)
    best, high_above, outwards = np.full(n, np.inf), np.empty(n), np.zeros((n, 3))
    for k in range(len(outer[0])):
        add_row(normals[outer[1][k]], 1.0, outwards[outer[0][k]])
    for k in range(len(row)):
        p, t = row[k], triangle[k]
        if not _holds(points, p, low, high, t, margin + reach) or _dot(outwards, p, normals, t) >= 0:
            continue
        a, b, c = _row(points, triangles[t, 0]), _row(points, triangles[t, 1]), _row(points, triangles[t, 2])
        point = _row(points, p)
        if SURE * abs(dot(added(point, -1.0, a), _row(normals, t))) > min(best[p], farthest):
            continue  # as far as its plane is
        share = nearest_on_triangle(point, a, b, c)
        off = offset_from(point, share, a, b, c)
        away, above = math.sqrt(dot(off, off)), dot(off, _row(normals, t))
        if away - MORE_ABOVE * abs(above) < best[p]:
            best[p], high_above[p], gaps[p], on[p] = away - MORE_ABOVE * abs(above), above, away, t
            put(weights[p], share[0], share[1], share[2])
            put(plain[p], off[0], off[1], off[2])
    for p in range(n):
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
            put(plain[p], normals[t, 0], normals[t, 1], normals[t, 2])
        else:
            gaps[p] = math.copysign(away, above)
            put(plain[p], plain[p, 0] / gaps[p], plain[p, 1] / gaps[p], plain[p, 2] / gaps[p])
    for p in range(n):
        if on[p] == NONE:
            continue
        put(along[p], plain[p, 0], plain[p, 1], plain[p, 2])
        q = _opposite(triangles, on, weights, p)
        if q != NONE and on[q] != NONE and _opposite(triangles, on, weights, q) == p:
            twin[p] = q
            x, y, z = added(_row(plain, p), -1.0, _row(plain, q))
            length = math.sqrt(x * x + y * y + z * z)
            put(along[p], x / length, y / length, z / length)


@jit_part
def _opposite(triangles: Array, on: Array, weights: Array, p: int) -> int:
    """The corner that a point touches; NONE where it touches none."""
    k = 0
    for j in range(1, 3):
        k = j if weights[p, j] > weights[p, k] else k
    return int(triangles[on[p], k]) if weights[p, k] > OPPOSITE else NONE


@jit_part
def _row(array: Array, k: int) -> Vector:
    return array[k, 0], array[k, 1], array[k, 2]


@jit_part
def _dot(these: Array, i: int, those: Array, j: int) -> float:
    """Of row i and row j."""
    product: float = these[i, 0] * those[j, 0] + these[i, 1] * those[j, 1] + these[i, 2] * those[j, 2]
    return product


@jit_part
def _holds(points: Array, p: int, low: Array, high: Array, t: int, wider: float) -> bool:
    """Whether box t, which is wider to all sides, holds point p; rows would each be counted."""
    holds = True
    for k in range(3):
        holds = holds and low[t, k] - wider <= points[p, k] <= high[t, k] + wider
    return holds
