"""A hierarchy of boxes around triangles, in which those near many places are found at once.

Triangles lie in blocks of eight, eight blocks in one of the next level, and so on up to a few boxes. A query goes down
level by level for all places together, so that it is a number of array operations that grows with log8 of the
triangles. Blocks are made by halving: along the longest axis, at the median of the middles.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, or_numpy
from fenics_rom.mechanics.triangles import nearest_on_triangles

WIDTH = 8  # children of a box
MOST_AT_TOP = 32  # boxes of the level that a query begins with
NOWHERE = 1e100  # m: where boxes are that fill up a level; a square of it is a number
_ONES = np.ones(3)


class BoxTree:
    """Around triangles.

    Args:
        corners: (T, 3 corners, 3), m.
    """

    def __init__(self, corners: Array):
        low, high = corners.min(axis=1), corners.max(axis=1)
        self._corners, self._order = np.ascontiguousarray(corners), _in_blocks((low + high) / 2)
        self._levels = [_filled(low[self._order], high[self._order])]
        while len(self._levels[0][0]) > MOST_AT_TOP:
            low, high = (side.reshape(-1, WIDTH, 3) for side in self._levels[0])
            is_there = low[:, :, :1] < NOWHERE
            high = np.where(is_there, high, -NOWHERE).max(axis=1)
            self._levels.insert(0, _filled(low.min(axis=1), np.where(high > -NOWHERE, high, NOWHERE)))

    def nearest(self, points: Array) -> Array:
        """Numbers (P,) of the triangles that are nearest to points (P, 3), m."""
        found = self._nearest_by_loops(points) if compiled() else None
        return self._nearest_by_arrays(points) if found is None else found

    @or_numpy
    def _nearest_by_loops(self, points: Array) -> Array | None:
        from fenics_rom.mechanics.compiled.nearest_triangles import find_nearest  # here, as numba takes time to import

        found = np.zeros(len(points), dtype=np.int64)
        find_nearest(np.ascontiguousarray(points), self._corners, WIDTH, self._order, *self._in_one_piece, found)
        return found

    @or_numpy
    def first_crossed(
        self, starts: Array, ends: Array, limits: tuple[float, float, float], normals: Array, inward: Array
    ) -> Array | None:
        """As `TriangleSurface.first_crossed`, by loops; None where they do not run. Arguments as of these."""
        if not compiled():
            return None
        from fenics_rom.mechanics.compiled.nearest_triangles import find_first_crossed  # here, as above

        found, (boxes, levels) = np.empty(len(starts), dtype=np.int64), self._in_one_piece
        ways = np.ascontiguousarray(starts), np.ascontiguousarray(ends)
        of_triangles = self._corners, normals, inward
        find_first_crossed(*ways, limits, *of_triangles, WIDTH, self._order, boxes, levels, found)
        return found

    @cached_property
    def _in_one_piece(self) -> tuple[Array, Array]:
        """Low and high ends (B, 6) of all boxes, level after level, and where each level begins."""
        starts = np.cumsum([0, *(len(low) for low, _ in self._levels)])
        return np.concatenate([np.concatenate(level, axis=1) for level in self._levels]), starts

    def _nearest_by_arrays(self, points: Array) -> Array:
        def squares(point: Array, triangle: Array) -> Array:
            away = points[point] - nearest_on_triangles(points[point], self._corners[triangle])[1]
            found: Array = (away * away).dot(_ONES)
            return found

        rows = np.arange(len(points))
        best = self._some_near(points)
        bound = squares(rows, best) * (1 + 1e-12)
        point, triangle = self._look(rows, lambda point, low, high: _squares(points[point], low, high) <= bound[point])
        found = squares(point, triangle)
        order = np.lexsort((triangle, found, point))
        first = np.searchsorted(point, rows)
        return triangle[order[first]]

    def meeting(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Pairs of one of some boxes (P, 3), and of a triangle whose box it meets, as their numbers."""

        def meet(row: Array, begin: Array, end: Array) -> Array:
            return ((begin <= high[row]) & (end >= low[row])).all(axis=-1)

        return self._look(np.arange(len(low)), meet)

    def _some_near(self, points: Array) -> Array:
        """Numbers (P,) of triangles near points, of those in the boxes that are nearest at every level."""
        low, high = self._levels[0]
        box = _squares(points[:, None], low, high).argmin(axis=1)
        for low, high in self._levels[1:]:
            child = WIDTH * box[:, None] + np.arange(WIDTH)
            box = child[np.arange(len(box)), _squares(points[:, None], low[child], high[child]).argmin(axis=1)]
        return self._order[box]

    def _look(self, rows: Array, meets: Callable[[Array, Array, Array], Array]) -> tuple[Array, Array]:
        """Pairs of a row (ascending) and a triangle, whose boxes `meets` on every level."""
        (low, high), *levels = self._levels
        row, box = meets(rows[:, None], low, high).nonzero()
        for low, high in levels:
            child = WIDTH * box[:, None] + np.arange(WIDTH)
            pair, which = meets(row[:, None], low[child], high[child]).nonzero()
            row, box = row[pair], child[pair, which]
        return row, self._order[box]


def _squares(points: Array, low: Array, high: Array) -> Array:
    """Squared distances of points from boxes."""
    away = np.maximum(low - points, points - high)
    np.maximum(away, 0.0, out=away)
    away *= away
    squares: Array = away.dot(_ONES)
    return squares


def _filled(low: Array, high: Array) -> tuple[Array, Array]:
    """The boxes of a level, with others nowhere, so that they are whole blocks."""
    missing = -len(low) % WIDTH
    nowhere = np.full((missing, 3), NOWHERE)
    return np.concatenate([low, nowhere]), np.concatenate([high, nowhere])


def _in_blocks(middles: Array) -> Array:
    """An order in which blocks of WIDTH, of WIDTH², and so on, are near one another."""
    order, waiting = np.arange(len(middles)), [(0, len(middles))]
    while waiting:
        begin, end = waiting.pop()
        if end - begin <= WIDTH:
            continue
        half = WIDTH
        while 2 * half < end - begin:
            half *= 2
        part = order[begin:end]
        places = middles[part]
        axis = np.ptp(places, axis=0).argmax()
        order[begin:end] = part[np.argsort(places[:, axis], kind="stable")]
        waiting += [(begin, begin + half), (begin + half, end)]
    return order
