"""Which triangles are nearest to points: the search of `mechanics.box_tree`, point after point."""

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
