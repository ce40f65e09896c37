"""Which triangles are nearest to points, and which ways go through: searches of `mechanics.box_tree`, one by one."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.triangles import dot, nearest_on_triangle, offset_from

MOST_LEVELS = 12  # below the top


@jit
def find_nearest(
    points: Array, corners: Array, width: int, order: Array, boxes: Array, starts: Array, found: Array
) -> None:
    """Sets the numbers (P,) of the triangles that are nearest to points (P, 3), m.

    Args:
        points: as above.
        corners: of the triangles, (T, 3 corners, 3), m.
        width: children of a box.
        order: (T,) the triangles in the boxes of the last level.
        boxes: (B, 6) low and high ends, m, level after level.
        starts: (L + 1,) where each level begins.
        found: set.
    """
    last, most = len(starts) - 2, starts[1] + MOST_LEVELS * width
    waiting, levels, bounds = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64), np.empty(most)
    for p in range(len(points)):
        best, count, level, begin, end = np.inf, 0, 0, 0, starts[1]
        while end > begin:
            bottom = count
            for box in range(begin, end):  # the nearest of them is to be opened first, the last one that waits
                bound, k = _to_box(points[p], boxes[box]), count
                if bound > best:
                    continue
                while k > bottom and bounds[k - 1] < bound:
                    waiting[k], levels[k], bounds[k] = waiting[k - 1], levels[k - 1], bounds[k - 1]
                    k -= 1
                waiting[k], levels[k], bounds[k] = box, level, bound
                count += 1
            begin = end = 0
            while count > 0 and begin == end:
                count -= 1
                if bounds[count] > best:
                    continue
                at = waiting[count] - starts[levels[count]]
                if levels[count] == last:
                    square = _to_triangle(points[p], corners[order[at]])
                    if square < best:
                        best, found[p] = square, order[at]
                else:
                    level = levels[count] + 1
                    begin = starts[level] + width * at
                    end = begin + width


@jit
def find_first_crossed(
    starts: Array,
    ends: Array,
    limits: tuple[float, float, float],
    corners: Array,
    normals: Array,
    inward: Array,
    width: int,
    order: Array,
    boxes: Array,
    levels: Array,
    found: Array,
) -> None:
    """Sets which triangles ways go through first: `TriangleSurface.first_crossed`.

    Args:
        starts, ends: of the ways, (P, 3), m.
        limits: how far behind a triangle they end at least, and begin at most, m; share by which it takes more.
        corners, normals, inward: of the triangles, (T, 3 corners, 3), m, (T, 3), and across each side, (T, 3, 3).
        width, order, boxes: as in `find_nearest`.
        levels: where each level begins, (L + 1,).
        found: set, (P,); -1: none.
    """
    deep, beside, overlap = limits
    low, high, at, last = np.empty(3), np.empty(3), np.empty(3), len(levels) - 2
    most = levels[1] + MOST_LEVELS * width
    waiting, level_of = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    for p in range(len(starts)):
        found[p], first, least, count = -1, np.inf, np.inf, levels[1]
        for k in range(3):
            low[k] = min(starts[p, k], ends[p, k]) - beside
            high[k] = max(starts[p, k], ends[p, k]) + beside
        for box in range(count):
            waiting[box], level_of[box] = box, 0
        while count > 0:
            count -= 1
            box, level = waiting[count], level_of[count]
            if not _meet(low, high, boxes[box]):
                continue
            if level < last:
                begin = levels[level + 1] + width * (box - levels[level])
                for child in range(begin, begin + width):
                    waiting[count], level_of[count] = child, level + 1
                    count += 1
                continue
            t = order[box - levels[last]]
            before = after = 0.0
            for k in range(3):
                before += (starts[p, k] - corners[t, 0, k]) * normals[t, k]
                after += (ends[p, k] - corners[t, 0, k]) * normals[t, k]
            if not (after < -deep and before >= -beside):
                continue
            share = min(max(before / (1.0 if before == after else before - after), 0.0), 1.0)
            for k in range(3):
                at[k] = starts[p, k] + share * (ends[p, k] - starts[p, k])
            if not _holds(corners[t], inward[t], at, overlap):
                continue
            if share < first or (share == first and (after < least or (after == least and t < found[p]))):
                found[p], first, least = t, share, after


@jit_part
def _meet(low: Array, high: Array, box: Array) -> bool:
    """Whether a box meets another one."""
    meets = True
    for k in range(3):
        meets = meets and box[k] <= high[k] and box[3 + k] >= low[k]
    return meets


@jit_part
def _holds(corners: Array, inward: Array, at: Array, overlap: float) -> bool:
    """Whether a triangle holds a place in its plane, m."""
    least, whole = np.inf, 0.0
    for i in range(3):
        area = 0.0
        for k in range(3):
            area += (at[k] - corners[i, k]) * inward[i, k]
        least, whole = min(least, area), whole + area
    return least >= -overlap * whole


@jit_part
def _to_box(x: Array, box: Array) -> float:
    """Squared distance of a point from a box, m²."""
    square = 0.0
    for i in range(3):
        away = max(box[i] - x[i], x[i] - box[3 + i], 0.0)
        square += away * away
    return square


@jit_part
def _to_triangle(x: Array, corners: Array) -> float:
    """Squared distance of a point from a triangle, m²."""
    point, a, b, c = (
        (x[0], x[1], x[2]), (corners[0, 0], corners[0, 1], corners[0, 2]),
        (corners[1, 0], corners[1, 1], corners[1, 2]), (corners[2, 0], corners[2, 1], corners[2, 2]),
    )  # fmt: skip
    off = offset_from(point, nearest_on_triangle(point, a, b, c), a, b, c)
    return dot(off, off)
