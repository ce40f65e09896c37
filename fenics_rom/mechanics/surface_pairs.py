"""Points near a surface of triangles that moves, and where on it they touch.

Of all triangles that are near a point, the nearest one tells its gap and normal. A point behind a triangle is inside as
far as it lies nearly straight behind it: else it is beside an open surface.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.triangles import nearest_on_triangles

DEEPEST = 0.5  # of the longest side of a triangle's box: points that are deeper inside have passed it
SIDEWAYS = 0.5  # cosine: points behind a triangle that are farther to its side are beside an open surface, not inside
ON_IT = (
    1e-3  # of that side: points so near are on the triangle, as far above as its normal says, also beside its border
)
BORDER = 0.1  # of that side: as far a surface that touches itself goes on beyond its border, where opposite edges slide
MORE_ABOVE = 1e-6  # of how far a point is above or below a triangle: by so much that one counts as nearer
SLACK = 0.25  # of that side: so much farther pairs are looked for, which last while less has moved
OPPOSITE = 0.9  # weight of a corner of a triangle in the place that is touched: more, and the corner is

_FEW = 1 << 14  # pairs of a point and a box: so many are all looked at
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


class OnSurface(NamedTuple):
    """Where k points are on a surface."""

    row: Array  # (k,) of the points
    nodes: Array  # (k, 3) corners of the triangle that each is nearest to
    weights: Array  # (k, 3) of these in the nearest place
    places: Array  # (k, 3) these, m
    normals: Array  # (k, 3) units out of the surface
    gaps: Array  # (k,), m; < 0 inside


class Boxes(NamedTuple):
    """Boxes about triangles."""

    low: Array  # (t, 3), m
    high: Array  # (t, 3), m
    size: float  # longest side, m

    @classmethod
    def about(cls, corners: Array) -> "Boxes":
        """Those about triangles (3 corners, t, 3)."""
        a, b, c = corners
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        return cls(low, high, float((high - low).max(initial=0.0)))

    def wider(self, margin: float) -> "Boxes":
        """The same, wider by a margin, m, to all sides."""
        return self._replace(low=self.low - margin, high=self.high + margin)


class Border(NamedTuple):
    """What of triangles (k,) is on the border of a surface."""

    sides: Array  # (k, 3) those opposite to corners
    corners: Array  # (k, 3)


def nearest_of(
    points: Array,
    row: Array,
    nodes: Array,
    corners: Array,
    normals: Array,
    size: float,
    margin: float,
    reach: float,
    border: Border | None = None,
) -> OnSurface:
    """Of points and triangles (k,) that may be near one another, those that are: of each point the nearest triangle.

    Args:
        points: (n, 3), m.
        row: of the points, (k,).
        nodes, corners, normals: of the triangles, (k, 3), where these are, (k, 3, 3), m, and units (k, 3).
        size: of the longest side of a triangle's box, m.
        margin: m, at most, of points outside.
        reach: m, at most, of points inside.
        border: of a surface that goes on a little beyond; None: it does not.
    """
    points = points[row]
    weights, feet = nearest_on_triangles(points, corners)
    offsets = points - feet
    away, above = np.sqrt(_dot(offsets, offsets)), _dot(offsets, normals)
    # of triangles that share the nearest point, the one that the point is most above or below knows which it is
    order = np.lexsort((away - MORE_ABOVE * np.abs(above), row))
    ordered = row[order]
    best = order[np.concatenate([ordered[:1] >= 0, ordered[1:] != ordered[:-1]])]
    away, above = away[best], above[best]
    is_on = is_flat = away <= ON_IT * size
    kept = is_on | np.where(above >= 0, away <= margin, (above < -SIDEWAYS * away) & (away <= reach))
    if border is not None:
        share = weights[best]
        is_beside = ((share == 0) & border.sides[best] | (share == 1) & border.corners[best]).any(axis=1)
        is_flat = is_on | (is_beside & (away * away - above * above <= (BORDER * size) ** 2))
        kept |= is_flat & (above <= margin) & (above >= -reach)
    best, away, above, clear = best[kept], away[kept], above[kept], ~is_flat[kept]
    normals, gaps = normals[best], np.where(clear, np.copysign(away, above), above)
    normals[clear] = (1 / gaps[clear])[:, None] * offsets[best][clear]
    return OnSurface(row[best], nodes[best], weights[best], feet[best], normals, gaps)


def unit_normals(corners: Array) -> Array:
    """Units (k, 3) of triangles (k, 3, 3)."""
    (a, b, c), (x, y, z) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    normals = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
    normals /= np.sqrt(_dot(normals, normals))[:, None]
    return normals


def near_boxes(points: Array, boxes: Boxes) -> tuple[Array, Array]:
    """Pairs of points (P, 3) and boxes that hold them, as rows of either; by points."""
    low, high = boxes.low, boxes.high
    near = _meet(points, points, low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf))
    points = points[near]
    met = _meet(low, high, points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf))
    low, high = low[met], high[met]
    if len(points) * len(met) <= _FEW:
        point, box = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2).nonzero()
    else:
        point, box = _near_by_grid(points, low, high)
    return near[point], met[box]


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("ij,ij->i", a, b)


def _meet(low: Array, high: Array, begin: Array, end: Array) -> Array:
    """Rows of boxes (T, 3) that another one from begin to end, (3,), touches."""
    return ((low <= end) & (high >= begin)).all(axis=1).nonzero()[0]


def _near_by_grid(points: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The same of points and boxes that are all near one another; by a uniform grid."""
    begin, end = np.minimum(low.min(axis=0), points.min(axis=0)), np.maximum(high.max(axis=0), points.max(axis=0))
    cell = (high - low).max()  # so that a box meets at most two cells along each axis
    shape = ((end - begin) // cell).astype(np.int64) + 2
    keys = np.ravel_multi_index(((points - begin) // cell).astype(np.int64).T, shape)
    order = np.argsort(keys)
    touched = ((low - begin) // cell).astype(np.int64)[:, None] + _CORNERS
    owner = np.repeat(np.arange(len(low)), len(_CORNERS))
    wanted = np.ravel_multi_index(touched.reshape(-1, 3).T, shape, mode="clip")
    start, stop = (np.searchsorted(keys[order], wanted, side) for side in ("left", "right"))
    counts = stop - start
    first_of = np.repeat(start - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
    point, box = order[first_of + np.arange(counts.sum())], np.repeat(owner, counts)
    held = ((points[point] >= low[box]) & (points[point] <= high[box])).all(axis=1)
    point, box = np.divmod(np.unique(point[held] * len(low) + box[held]), len(low))
    return point, box
