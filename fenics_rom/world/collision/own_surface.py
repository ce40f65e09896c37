"""The surface of a soft body against itself.

A point touches a triangle that faces it, as far as that is neither beside the point nor, at rest, behind it: what is
behind a point of a thin wall is the wall's other side. What was apart at rest is then told from what is one piece by
where it was, and contact keeps it apart.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.world.collision.contacts import Contacts, PlacedSurface, taken
from fenics_rom.world.collision.soft_surfaces import near_boxes, points_on, triangle_boxes, unit_normals
from fenics_rom.world.tolerances import DEEPEST

_WALL = 2 * DEEPEST  # of the longest side of a triangle's box: what is nearer at rest, and behind a point, is its wall
_SLACK = 0.25  # of the longest side of boxes in which points are looked for: candidates last while less has moved
_OPPOSITE = 0.9  # weight of a corner of a triangle in the place that is touched: more, and the corner is
_FLAT = 1e-6  # of the distance: a point that is not more above a triangle is not in front of it


class _Known(NamedTuple):
    """Candidates as they were looked for."""

    points: Array  # then, (n, 3), m
    low: Array  # of boxes about triangles, (t, 3), m
    high: Array
    slack: float  # m, by which more were looked for
    row: Array  # of candidates
    triangle: Array


class OwnSurface:
    """Which triangles of a surface its points can touch.

    Args:
        points: at rest (n, 3), m.
        triangles: (t, 3) rows of points, counterclockwise from outside.
    """

    def __init__(self, points: Array, triangles: Array):
        self._known: _Known | None = None
        self._count, (corner, owner) = len(triangles), (triangles.ravel(), np.repeat(np.arange(len(triangles)), 3))
        inside = np.setdiff1d(np.arange(len(points)), corner)  # of triangles
        carrier = _nearest_triangles(points[inside], points[triangles])
        self._point, self._triangle = np.concatenate([corner, inside]), np.concatenate([owner, carrier])
        beside = _beside(self._point, self._triangle, triangles)
        self._left_out = np.unique(np.concatenate([beside, self._behind(points, triangles)]))

    def _behind(self, points: Array, triangles: Array) -> Array:
        """Keys of points and triangles that are near at rest, where the point is not in front."""
        low, high = triangle_boxes(points[triangles.T])
        wall = _WALL * float((high - low).max(initial=0.0))
        row, triangle = near_boxes(points, low - wall, high + wall)
        corners = points[triangles[triangle]]
        offsets = points[row] - nearest_on_triangles(points[row], corners)[1]
        above, away = (offsets * unit_normals(corners)).sum(axis=1), np.linalg.norm(offsets, axis=1)
        return self._keys(row, triangle)[(away <= wall) & (above <= _FLAT * away)]

    def _keys(self, row: Array, triangle: Array) -> Array:
        return row * self._count + triangle

    def contacts(self, surface: PlacedSurface, margin: float) -> Contacts:
        """The points of the surface that are nearer to what they can touch of it than a margin, m.

        Of two points that touch one another the first alone has a pair, along the mean of both normals: W could hardly
        tell the forces of two apart.
        """
        found = points_on(surface, surface, margin, 0, self._near)
        point, (nodes, weights) = found.first.nodes[:, 0], found.second[1:3]
        best = weights.argmax(axis=1)[:, None]
        opposite = np.take_along_axis(nodes, best, axis=1)[:, 0]
        is_at = np.take_along_axis(weights, best, axis=1)[:, 0] > _OPPOSITE
        pair_of = np.full(len(surface.points), -1)
        pair_of[point] = np.where(is_at, np.arange(len(point)), -1)
        other = np.where(is_at, pair_of[opposite], -1)
        both = ((other >= 0) & (opposite[other] == point)).nonzero()[0]
        means = found.normals[both] - found.normals[other[both]]
        found.normals[both] = means / np.linalg.norm(means, axis=1)[:, None]
        return taken(found, np.setdiff1d(np.arange(len(point)), both[point[both] > opposite[both]]))

    def _near(self, surface: PlacedSurface, low: Array, high: Array) -> tuple[Array, Array]:
        """Rows of points and of triangles that face one another, of points in boxes low to high about triangles."""
        row, triangle = self._candidates(surface, low, high)
        points, normals = surface.points, unit_normals(surface.points[surface.triangles])
        outwards = np.zeros(points.shape)  # of points, of any length
        for k in range(3):
            outwards[:, k] = np.bincount(self._point, normals[self._triangle, k], len(points))
        chosen = np.einsum("ij,ij->i", outwards[row], normals[triangle]) < 0
        row, triangle = row[chosen], triangle[chosen]
        chosen = ((points[row] >= low[triangle]) & (points[row] <= high[triangle])).all(axis=1)
        return row[chosen], triangle[chosen]

    def _candidates(self, surface: PlacedSurface, low: Array, high: Array) -> tuple[Array, Array]:
        """Rows of points and of triangles that may touch, among which are all that are near: kept while they are.

        A point and a box that come nearer by no more than they are looked for farther away are among them.
        """
        known = self._known
        if known is not None:
            came = max(np.abs(surface.points - known.points).max(), (known.low - low).max(), (high - known.high).max())
            if came <= known.slack / 2:
                return known.row, known.triangle
        slack = _SLACK * float((high - low).max(initial=0.0))
        row, triangle = near_boxes(surface.points[surface.touching], low - slack, high + slack)
        row = surface.touching[row]
        keys = self._keys(row, triangle)
        at = np.minimum(np.searchsorted(self._left_out, keys), len(self._left_out) - 1)
        may = self._left_out[at] != keys
        self._known = _Known(surface.points, low, high, slack, row[may], triangle[may])
        return self._known.row, self._known.triangle


def _nearest_triangles(points: Array, corners: Array) -> Array:
    """Of triangles (t, 3 corners, 3) the nearest ones of points (P, 3), (P,)."""
    nearest = np.empty(len(points), dtype=int)
    for k, point in enumerate(points):
        feet = nearest_on_triangles(np.broadcast_to(point, (len(corners), 3)), corners)[1]
        nearest[k] = ((feet - point) ** 2).sum(axis=1).argmin()
    return nearest


def _beside(point: Array, triangle: Array, triangles: Array) -> Array:
    """Keys of points (k,) and of all triangles that share a corner with one that a point is on, (k,)."""
    order = np.argsort(triangles.ravel(), kind="stable")
    corner, owner = triangles.ravel()[order], order // 3
    begin, end = (np.searchsorted(corner, triangles[triangle].ravel(), side) for side in ("left", "right"))
    counts, points = end - begin, np.repeat(point, 3)
    first = np.repeat(begin - np.cumsum(counts) + counts, counts)
    keys: Array = np.repeat(points, counts) * len(triangles) + owner[first + np.arange(counts.sum())]
    return keys
