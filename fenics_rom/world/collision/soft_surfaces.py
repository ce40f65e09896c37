"""Surfaces of soft bodies against rigid shapes, and against one another."""

from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, in_plain
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.world.collision.contacts import Contacts, PlacedShape, PlacedSurface, Spots, joined
from fenics_rom.world.tolerances import DEEPEST, MORE_ABOVE, ON_IT, SIDEWAYS

_ONES = np.ones(3)
_FEW = 1 << 14  # pairs of a point and a box: so many are all looked at
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
Near = Callable[[PlacedSurface, Array, Array], tuple[Array, Array]]


def soft_on_rigid(first: PlacedSurface, second: PlacedShape, margin: float) -> Contacts:
    """The points of a surface that are nearer to a shape than a margin, m."""
    points = first.points[first.touching]
    beside = points - second.position
    reach = second.shape.radius_around + margin
    beside *= beside
    row = (beside.dot(_ONES) <= reach * reach).nonzero()[0]
    near, gaps, normals, feature = second.planes_near(points[row], margin)
    kept = first.touching[row[near]]
    soft, none = _vertices(first, kept, len(first.points) * feature), np.zeros((len(kept), 0), dtype=int)
    return Contacts(soft, Spots(soft.arms, none, none, soft.feature), normals, gaps)


def soft_on_soft(first: PlacedSurface, second: PlacedSurface, margin: float) -> Contacts:
    """The points of each of two surfaces that are nearer to the other than a margin, m."""
    there, back = points_on(first, second, margin, 0), points_on(second, first, margin, len(first.points))
    return joined([there, back.mirrored])


def points_on(
    first: PlacedSurface, second: PlacedSurface, margin: float, numbers: int, near: Near | None = None
) -> Contacts:
    """Points of the first, each with what is nearest of the second.

    Args:
        first, second: two surfaces.
        margin: m, at most between them.
        numbers: what is added to the features of points.
        near: gives rows of points and triangles that may be so near, of boxes about triangles; None: of any.
    """
    if near is None and compiled():
        return _found_on(first, second, margin, numbers)
    corners = second.points[second.triangles.T]
    low, high = triangle_boxes(corners)
    size = float((high - low).max(initial=0.0))
    reach = margin + DEEPEST * size
    if near is not None:
        row, triangle = near(first, low - reach, high + reach)
        reach = DEEPEST * size
    else:
        row, triangle = near_boxes(first.points[first.touching], low - reach, high + reach)
        row = first.touching[row]
    points, corners = first.points[row], corners[:, triangle].transpose(1, 0, 2)
    weights, feet = nearest_on_triangles(points, corners)
    normals = unit_normals(corners)
    offsets = points - feet
    away, above = np.sqrt(_dot(offsets, offsets)), _dot(offsets, normals)
    # of triangles that share the nearest point, the one that the point is most above or below knows which it is
    order = np.lexsort((away - MORE_ABOVE * np.abs(above), row))
    ordered = row[order]
    best = order[np.concatenate([ordered[:1] >= 0, ordered[1:] != ordered[:-1]])]
    away, above = away[best], above[best]
    is_on = away <= ON_IT * size
    kept = is_on | np.where(above >= 0, away <= margin, (above < -SIDEWAYS * away) & (away <= reach))
    best, away, above, clear = best[kept], away[kept], above[kept], ~is_on[kept]
    normals, gaps = normals[best], np.where(clear, np.copysign(away, above), above)
    normals[clear] = (1 / gaps[clear])[:, None] * offsets[best][clear]
    foot = Spots(feet[best], second.triangles[triangle[best]], weights[best], row[best] + numbers)
    return Contacts(_vertices(first, row[best], numbers), foot, normals, gaps)


def _found_on(first: PlacedSurface, second: PlacedSurface, margin: float, numbers: int) -> Contacts:
    """The same by compiled loops."""
    from fenics_rom.world.compiled.soft_collision import NONE, find_nearest  # here, as numba takes time to import

    points, P = first.points[first.touching], len(first.touching)
    on, weights, normals, gaps = np.empty(P, dtype=np.int64), np.empty((P, 3)), np.empty((P, 3)), np.empty(P)
    triangles = np.ascontiguousarray(second.triangles, dtype=np.int64)
    find_nearest(points, in_plain(second.points), in_plain(triangles), margin, on, weights, normals, gaps)
    found = (on != NONE).nonzero()[0]
    row, nodes, weights = first.touching[found], second.triangles[on[found]], weights[found]
    feet = (weights[:, :, None] * second.points[nodes]).sum(axis=1)
    foot = Spots(feet, nodes, weights, row + numbers)
    return Contacts(_vertices(first, row, numbers), foot, normals[found], gaps[found])


def triangle_boxes(corners: Array) -> tuple[Array, Array]:
    """Where boxes about triangles (3 corners, t, 3) begin and end, (t, 3) each."""
    a, b, c = corners
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def unit_normals(corners: Array) -> Array:
    """Units (k, 3) of triangles (k, 3, 3)."""
    (a, b, c), (x, y, z) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    normals = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
    normals /= np.sqrt(_dot(normals, normals))[:, None]
    return normals


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("ij,ij->i", a, b)


def _vertices(surface: PlacedSurface, row: Array, numbers: int | Array = 0) -> Spots:
    """Spots at points of a surface; numbers: what is added to their features."""
    weights = np.zeros((len(row), 3))
    weights[:, 0] = 1.0
    return Spots(surface.points[row], np.repeat(row[:, None], 3, axis=1), weights, row + numbers)


def near_boxes(points: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Pairs of points (P, 3) and boxes low to high, (T, 3), that hold them, as rows of either; by points."""
    near = _meet(points, points, low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf))
    points = points[near]
    boxes = _meet(low, high, points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf))
    low, high = low[boxes], high[boxes]
    if len(points) * len(boxes) <= _FEW:
        point, box = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2).nonzero()
    else:
        point, box = _near_by_grid(points, low, high)
    return near[point], boxes[box]


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
    pairs = np.unique(np.stack([point[held], box[held]]), axis=1)
    return pairs[0], pairs[1]
