"""Surfaces of soft bodies against rigid shapes, and against one another."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.world.collision.contacts import Contacts, PlacedShape, PlacedSurface, Spots, joined
from fenics_rom.world.collision.round_shapes import distance_of

_REACH = 0.5  # of the longest side of a triangle's box: points that are deeper inside have passed it
_SIDEWAYS = 0.5  # cosine: points behind a triangle that are farther to its side are beside an open surface, not inside
_ONES = np.ones(3)
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def soft_on_rigid(first: PlacedSurface, second: PlacedShape, margin: float) -> Contacts:
    """The points of a surface that are nearer to a shape than a margin, m."""
    points = first.points[first.touching]
    beside = points - second.position
    reach = second.shape.radius_around + margin
    beside *= beside
    row = (beside.dot(_ONES) <= reach * reach).nonzero()[0]
    gaps, normals = distance_of(second, points[row])
    near = (gaps <= margin).nonzero()[0]
    kept = _kept_rows(first.touching[row[near]].tobytes())
    places = points[row[near]]
    soft, rigid = Spots(places, kept.nodes, kept.weights, kept.row), Spots(places, kept.none, kept.none, kept.row)
    return Contacts(soft, rigid, normals[near], gaps[near])


def soft_on_soft(first: PlacedSurface, second: PlacedSurface, margin: float) -> Contacts:
    """The points of each of two surfaces that are nearer to the other than a margin, m."""
    there, back = _points_on(first, second, margin, 0), _points_on(second, first, margin, len(first.points))
    return joined([there, back.mirrored])


def _points_on(first: PlacedSurface, second: PlacedSurface, margin: float, numbers: int) -> Contacts:
    """Points of the first, each with what is nearest of the second; numbers: what is added to their features."""
    corners = second.points[second.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    size = float((high - low).max(initial=0.0))
    reach = margin + _REACH * size
    row, triangle = _near(first.points[first.touching], low - reach, high + reach)
    row = first.touching[row]
    points, corners = first.points[row], corners[triangle]
    weights, feet = nearest_on_triangles(points, corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = points - feet
    away = np.linalg.norm(offsets, axis=1)
    above = (offsets * normals).sum(axis=1)
    # of triangles that share the nearest point, the one that the point is most above or below knows which it is
    order = np.lexsort((away - 1e-6 * np.abs(above), row))
    best = order[np.unique(row[order], return_index=True)[1]]
    outside = above[best] >= 0
    best = best[
        np.where(outside, away[best] <= margin, (above[best] < -_SIDEWAYS * away[best]) & (away[best] <= reach))
    ]
    sign = np.where(above[best] < 0, -1.0, 1.0)
    clear = away[best] > 1e-9 * size
    normals = normals[best]
    normals[clear] = (sign / np.where(clear, away[best], 1.0))[clear, None] * offsets[best][clear]
    foot = Spots(feet[best], second.triangles[triangle[best]], weights[best], row[best] + numbers)
    return Contacts(_vertices(first, row[best], numbers), foot, normals, sign * away[best])


class _KeptRows(NamedTuple):
    """What is the same as long as the same points of a surface are near."""

    row: Array  # (k,)
    nodes: Array  # as in Spots, of the points, and none of a rigid body
    weights: Array
    none: Array


@lru_cache(maxsize=256)
def _kept_rows(row_bytes: bytes) -> _KeptRows:
    row = np.frombuffer(row_bytes, dtype=int)
    weights = np.zeros((len(row), 3))
    weights[:, 0] = 1.0
    return _KeptRows(row, np.repeat(row[:, None], 3, axis=1), weights, np.zeros((len(row), 0), dtype=int))


def _vertices(surface: PlacedSurface, row: Array, numbers: int = 0) -> Spots:
    """Spots at points of a surface; numbers: what is added to their features."""
    weights = np.zeros((len(row), 3))
    weights[:, 0] = 1.0
    return Spots(surface.points[row], np.repeat(row[:, None], 3, axis=1), weights, row + numbers)


def _near(points: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Pairs of points (P, 3) and boxes low to high, (T, 3), that hold them, as rows of either; by a uniform grid."""
    inside = ((points >= low.min(axis=0, initial=np.inf)) & (points <= high.max(axis=0, initial=-np.inf))).all(axis=1)
    candidates = np.flatnonzero(inside)
    if not len(candidates):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    points, begin = points[candidates], low.min(axis=0)
    cell = (high - low).max()  # so that a box meets at most two cells along each axis
    shape = ((high.max(axis=0) - begin) // cell).astype(np.int64) + 2
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
    pairs = np.unique(np.stack([candidates[point[held]], box[held]]), axis=1)
    return pairs[0], pairs[1]
