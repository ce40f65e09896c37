"""The surface of a soft body against itself.

A point touches a triangle that faces it, as far as that is neither beside the point nor, at rest, behind it: what is
behind a point of a thin wall is the wall's other side. What was apart at rest is then told from what is one piece by
where it was, and contact keeps it apart.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, in_plain
from fenics_rom.mechanics.frame_geometry import crossed
from fenics_rom.mechanics.own_crossings import Crossings, find_crossings
from fenics_rom.mechanics.surface_pairs import (
    DEEPEST,
    OPPOSITE,
    SIDEWAYS,
    SLACK,
    Border,
    Boxes,
    OnSurface,
    near_boxes,
    nearest_of,
    unit_normals,
)
from fenics_rom.mechanics.triangles import nearest_on_triangles

if TYPE_CHECKING:
    from fenics_rom.mechanics.compiled.own_surface import Candidates, Surface

_WALL = 2 * DEEPEST  # of the longest side of a triangle's box: what is nearer at rest, and behind a point, is its wall
_SAME = 1e-9  # of the longest side of triangles' boxes: what is nearer is in the same place
_FLAT = 1e-6  # of the distance: a point that is not more above a triangle, or below one that it faces, is in its plane


class _Known(NamedTuple):
    """Candidates as they were looked for."""

    points: Array  # then, (n, 3), m
    boxes: Boxes  # about triangles
    margin: float  # m, about these, of what is near
    slack: float  # m, by which more were looked for
    row: Array  # of candidates
    triangle: Array


class Facing(NamedTuple):
    """All that points of a surface face, before what two of them have twice is left out."""

    found: OnSurface
    plain: Array  # normals (k, 3) of triangles, or along the nearest way
    twin: Array  # (k,) which of them is opposite, each to the other; -1: none
    kept: Array  # which of them have pairs


class OwnSurface:
    """Which triangles of a surface its points can touch.

    Args:
        points: at rest (n, 3), m.
        triangles: (t, 3) rows of points, counterclockwise from outside.
        touching: rows of the points that may touch.
        names: of the surfaces that points are on, (n,).

    Attributes:
        triangles, names: as given.
        deepest: how deep points may be inside, m, before they have passed it, or the wall that is behind it at rest.
        last: all that was near.
    """

    last: Facing

    def __init__(self, points: Array, triangles: Array, touching: Array, names: Sequence[str]):
        self.triangles, self._touching, self.names = triangles, touching, names
        self._known: _Known | None = None
        self._count, (corner, owner) = len(triangles), (triangles.ravel(), np.repeat(np.arange(len(triangles)), 3))
        inside = np.setdiff1d(touching, corner)  # of triangles
        carrier = _nearest_triangles(points[inside], points[triangles])
        self._point, self._triangle = np.concatenate([corner, inside]), np.concatenate([owner, carrier])
        beside = _beside(self._point, self._triangle, triangles)
        self._border = _border(triangles, len(points))
        self._left_out = np.unique(np.concatenate([beside, self._behind(points)]))

    def _behind(self, points: Array) -> Array:
        """Keys of points and triangles that are near at rest, where the point is not in front.

        What lies on one another at rest is no wall: points in the plane of a triangle that they face.
        """
        boxes = Boxes.about(points[self.triangles.T])
        wall = _WALL * boxes.size
        row, triangle = near_boxes(points[self._touching], boxes.wider(wall))
        row, corners, normals = self._touching[row], points[self.triangles], unit_normals(points[self.triangles])
        faces = np.einsum("ij,ij->i", self._outwards(normals)[row], normals[triangle]) < 0
        offsets = points[row] - nearest_on_triangles(points[row], corners[triangle])[1]
        above, away = (offsets * normals[triangle]).sum(axis=1), np.linalg.norm(offsets, axis=1)
        front = np.where(faces, -1, 1) * np.maximum(_FLAT * away, _SAME * boxes.size)
        is_wall = faces & (above < -SIDEWAYS * away)
        self.deepest = min(DEEPEST * boxes.size, float(away[is_wall].min(initial=np.inf)))
        return self._keys(row, triangle)[(away <= wall) & (above <= front)]

    def _outwards(self, normals: Array) -> Array:
        """Outward vectors (n, 3) of points, of any length, by normals (t, 3) of the triangles."""
        outwards = np.zeros((len(self.names), 3))
        for k in range(3):
            outwards[:, k] = np.bincount(self._point, normals[self._triangle, k], len(outwards))
        return outwards

    def _keys(self, row: Array, triangle: Array) -> Array:
        return row * self._count + triangle

    def near(self, points: Array, margin: float) -> OnSurface:
        """Those points, of all at (n, 3), m, that are nearer than a margin, m, to what they can touch.

        Of two points that touch one another the first alone has a pair, along the mean of both normals: W could hardly
        tell the forces of two apart.
        """
        found, plain, twin = (self._find_compiled if compiled() else self._find)(points, margin)
        kept = ((twin < 0) | (np.arange(len(twin)) < twin)).nonzero()[0]
        self.last = Facing(found, plain, twin, kept)
        return OnSurface(*(part[kept] for part in found))

    def margin(self, points: Array, ways: Sequence[Array], most: float) -> float:
        """How near, m, those come to one another that may meet; 0 where none do.

        A point and a triangle may meet that are nearer than they go relative to one another by all `ways` (n, 3)
        together, m, each of which counts for itself. `most`: m, no two points go farther so.
        """
        corners = points[self.triangles.T]
        boxes = Boxes.about(corners)
        row, triangle = self._candidates(points, boxes, most)
        if compiled():
            from fenics_rom.mechanics.compiled.own_surface import margin_among  # here, as below

            given = np.stack(ways), *map(in_plain, (row, triangle, self.triangles, boxes.low, boxes.high))
            return margin_among(in_plain(points), *given)
        nodes, goes = self.triangles[triangle], np.zeros(len(row))
        for way in ways:
            relative = way[row, None] - way[nodes]
            goes += np.sqrt(np.einsum("kci,kci->kc", relative, relative).max(axis=1, initial=0.0))
        x = points[row]
        outside = np.maximum(np.maximum(boxes.low[triangle] - x, x - boxes.high[triangle]), 0.0)
        return float(goes[np.einsum("ki,ki->k", outside, outside) <= goes * goes].max(initial=0.0))

    def in_loops(self, points: int) -> "tuple[Surface, Candidates]":
        """As loops have it, of so many points; candidates are not known."""
        from fenics_rom.mechanics.compiled.own_surface import Candidates, Surface  # here, as below

        t, k = len(self.triangles), len(self._touching)
        keys = self._keys(self._touching[:, None], np.arange(t))
        may = ~np.isin(keys, self._left_out)
        outer = in_plain(self._point), in_plain(self._triangle)
        surface = Surface(in_plain(self.triangles), in_plain(self._touching), may, outer, *map(in_plain, self._border))
        pairs = np.empty((2, k * t), dtype=np.int64)
        known = np.empty((points, 3)), *np.empty((2, t, 3)), *pairs, np.full(1, -1), np.empty(2)
        return surface, Candidates(*known)

    def crossings(self, points: Array, ways: Array) -> Crossings:
        """Where points, of all at (n, 3) that go (n, 3), m, first go through triangles that they can touch."""
        return find_crossings(points, ways, self._touching, self.triangles, self._left_out)

    def _find(self, points: Array, margin: float) -> tuple[OnSurface, Array, Array]:
        """As of `Facing`."""
        corners = points[self.triangles.T]
        boxes, normals = Boxes.about(corners), unit_normals(corners.transpose(1, 0, 2))
        reach = DEEPEST * boxes.size
        wider = boxes.wider(margin + reach)
        row, triangle = self._candidates(points, boxes, margin + reach)
        held = ((points[row] >= wider.low[triangle]) & (points[row] <= wider.high[triangle])).all(axis=1)
        row, triangle = row[held], triangle[held]
        faces = np.einsum("ij,ij->i", self._outwards(normals)[row], normals[triangle]) < 0
        row, triangle = row[faces], triangle[faces]
        of_these = self.triangles[triangle], points[self.triangles[triangle]], normals[triangle]
        border = Border(*(part[triangle] for part in self._border))
        found = nearest_of(points, row, *of_these, boxes.size, margin, reach, border)
        best = found.weights.argmax(axis=1)[:, None]
        opposite = np.take_along_axis(found.nodes, best, axis=1)[:, 0]
        is_at = np.take_along_axis(found.weights, best, axis=1)[:, 0] > OPPOSITE
        pair_of = np.full(len(points), -1)
        pair_of[found.row] = np.where(is_at, np.arange(len(found.row)), -1)
        twin = np.where(is_at, pair_of[opposite], -1)
        twin[opposite[twin] != found.row] = -1
        both, plain = (twin >= 0).nonzero()[0], found.normals.copy()
        means = plain[both] - plain[twin[both]]
        found.normals[both] = means / np.linalg.norm(means, axis=1)[:, None]
        return found, plain, twin

    def _find_compiled(self, points: Array, margin: float) -> tuple[OnSurface, Array, Array]:
        """The same by compiled loops."""
        from fenics_rom.mechanics.compiled.own_surface import NONE, find_facing, set_boxes  # as numba is slow to import

        n, t, places = len(points), len(self.triangles), in_plain(points)
        triangles, low, high, normals = in_plain(self.triangles), *np.empty((3, t, 3))
        boxes = Boxes(low, high, set_boxes(places, triangles, low, high, normals))
        reach = DEEPEST * boxes.size
        row, triangle = map(in_plain, self._candidates(points, boxes, margin + reach))
        on, twin, weights, plain, along, gaps = *np.empty((2, n), dtype=np.int64), *np.empty((3, n, 3)), np.empty(n)
        sides, corners = map(in_plain, self._border)
        facing, near = (triangles, normals, (self._point, self._triangle)), (row, triangle, low, high, sides, corners)
        find_facing(places, *facing, *near, boxes.size, margin, reach, on, twin, weights, plain, along, gaps)
        row = (on != NONE).nonzero()[0]
        nodes, weights = self.triangles[on[row]], weights[row]
        feet = (weights[:, :, None] * points[nodes]).sum(axis=1)
        twin, at = twin[row], on  # of points, then of rows
        at[row] = np.arange(len(row))
        found = OnSurface(row, nodes, weights, feet, along[row], gaps[row])
        return found, plain[row], np.where(twin == NONE, -1, at[twin])

    def _candidates(self, points: Array, boxes: Boxes, margin: float) -> tuple[Array, Array]:
        """Rows of points and of triangles that may touch, among which are all that are near: kept while they are.

        A point and a box that come nearer by no more than they are looked for farther away are among them.
        `margin`: m, about the boxes.
        """
        known = self._known
        if known is not None:
            drift = self._drift(points, boxes, known) + max(margin - known.margin, 0.0)
            if drift <= known.slack / 2:
                return known.row, known.triangle
        slack = max(SLACK * boxes.size, margin / 2)  # fast points need many, which last as long as few of slow ones
        row, triangle = near_boxes(points[self._touching], boxes.wider(margin + slack))
        row = self._touching[row]
        keys = self._keys(row, triangle)
        at = np.minimum(np.searchsorted(self._left_out, keys), len(self._left_out) - 1)
        may = self._left_out[at] != keys
        self._known = _Known(points, boxes, margin, slack, row[may], triangle[may])
        return self._known.row, self._known.triangle

    def _drift(self, points: Array, boxes: Boxes, known: _Known) -> float:
        """How far, m, points, or ends of boxes outwards, went at most since those were known."""
        if compiled():
            from fenics_rom.mechanics.compiled.own_surface import drift_of  # here, as above

            now = in_plain(points), boxes.low, boxes.high
            return drift_of(*now, in_plain(known.points), known.boxes.low, known.boxes.high)
        low, high = known.boxes.low - boxes.low, boxes.high - known.boxes.high
        return float(max(np.abs(points - known.points).max(), low.max(), high.max()))


def _nearest_triangles(points: Array, corners: Array) -> Array:
    """Of triangles (t, 3 corners, 3) the nearest ones of points (P, 3), (P,)."""
    nearest = np.empty(len(points), dtype=int)
    for k, point in enumerate(points):
        feet = nearest_on_triangles(np.broadcast_to(point, (len(corners), 3)), corners)[1]
        nearest[k] = ((feet - point) ** 2).sum(axis=1).argmin()
    return nearest


def _border(triangles: Array, points: int) -> Border:
    """What of triangles (t, 3) between so many points is on the border of their surface."""
    sides = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]], axis=2)
    _, side, count = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    alone = (count[side.ravel()] == 1).reshape(-1, 3)
    at_border = np.zeros(points, dtype=bool)
    at_border[sides[alone]] = True
    return Border(alone, at_border[triangles])


def _beside(point: Array, triangle: Array, triangles: Array) -> Array:
    """Keys of points (k,) and of all triangles that share a corner with one that a point is on, (k,)."""
    order = np.argsort(triangles.ravel(), kind="stable")
    corner, owner = triangles.ravel()[order], order // 3
    begin, end = (np.searchsorted(corner, triangles[triangle].ravel(), side) for side in ("left", "right"))
    counts, points = end - begin, np.repeat(point, 3)
    first = np.repeat(begin - np.cumsum(counts) + counts, counts)
    keys: Array = np.repeat(points, counts) * len(triangles) + owner[first + np.arange(counts.sum())]
    return keys


def corner_maps(points: Array, corners: Array, weights: Array) -> Array:
    """Of points (k, 3) and triangles (k, 3 corners, 3), m: what each corner's velocity adds where the point is.

    weights: of the corners in the nearest place, (k, 3).
    """
    arms, away = corners - corners.mean(axis=1, keepdims=True), points - (weights[:, :, None] * corners).sum(axis=1)
    J = np.square(arms).sum(axis=(1, 2))[:, None, None] * np.eye(3) - np.matmul(arms.transpose(0, 2, 1), arms)
    by_turn = np.matmul(crossed(away), np.linalg.inv(J))
    turns = -crossed(arms.reshape(-1, 3)).reshape(-1, 3, 3, 3)
    maps: Array = np.matmul(by_turn[:, None], turns) + weights[:, :, None, None] * np.eye(3)
    return maps
