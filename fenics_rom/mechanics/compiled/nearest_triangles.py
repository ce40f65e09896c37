"""Which triangles are nearest to points: the search of `mechanics.box_tree`, point after point."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part

WIDTH = 8  # children of a box; see `mechanics.box_tree`
DEEPEST = 12 * WIDTH  # boxes below the top that may wait to be opened


@jit
def find_nearest(points: Array, corners: Array, order: Array, boxes: Array, starts: Array, found: Array) -> None:
    """Sets the numbers (P,) of the triangles that are nearest to points (P, 3), m.

    Args:
        points: as above.
        corners: of the triangles, (T, 3 corners, 3), m.
        order: (T,) the triangles in the boxes of the last level.
        boxes: (B, 6) low and high ends, m, level after level.
        starts: (L + 1,) where each level begins.
        found: set.
    """
    last, most = len(starts) - 2, starts[1] + DEEPEST
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
                    begin = starts[level] + WIDTH * at
                    end = begin + WIDTH


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
    """Squared distance of a point from a triangle, m²; as `mechanics.triangles` has it."""
    uu = uv = vv = uw = vw = 0.0
    for i in range(3):
        u, v, w = corners[1, i] - corners[0, i], corners[2, i] - corners[0, i], x[i] - corners[0, i]
        uu, uv, vv, uw, vw = uu + u * u, uv + u * v, vv + v * v, uw + u * w, vw + v * w
    twice_area = max(uu * vv - uv * uv, 2.3e-308)
    b, c = (vv * uw - uv * vw) / twice_area, (uu * vw - uv * uw) / twice_area
    square = 0.0
    if b >= 0.0 and c >= 0.0 and b + c <= 1.0:
        for i in range(3):
            a = corners[0, i]
            away = x[i] - a - b * (corners[1, i] - a) - c * (corners[2, i] - a)
            square += away * away
        return square
    square = np.inf
    for k in range(3):
        square = min(square, _to_edge(x, corners[k], corners[(k + 1) % 3]))
    return square


@jit_part
def _to_edge(x: Array, start: Array, end: Array) -> float:
    """Squared distance of a point from a line between two, m²."""
    along = across = square = 0.0
    for i in range(3):
        along += (end[i] - start[i]) * (end[i] - start[i])
        across += (x[i] - start[i]) * (end[i] - start[i])
    share = min(max(across / max(along, 2.3e-308), 0.0), 1.0)
    for i in range(3):
        away = x[i] - start[i] - share * (end[i] - start[i])
        square += away * away
    return square
