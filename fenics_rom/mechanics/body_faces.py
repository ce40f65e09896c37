"""Where corners and edges of an obstacle meet the faces of a body, between its contact points.

Points against faces of obstacles are the business of contact points. What is left of two surfaces of triangles are

    a corner against a face     at its foot on the triangle, along the triangle's normal;
    a corner against an edge    at its foot on the edge, where it is before neither of the triangles beside;
    an edge against an edge     where they cross, along the normal of both.

A radius r about corners and edges, as of balls and capsules, takes r off each gap. Places are told by the weights of
the contact points that carry them, and gaps are < 0 inside.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.obstacle_outline import Outline
from fenics_rom.mechanics.surface_pairs import Boxes, near_boxes, unit_normals
from fenics_rom.mechanics.triangle_surface import edges_of
from fenics_rom.mechanics.triangles import covering_radius, weights_in_planes
from fenics_rom.mechanics.walls import thinnest_wall

DEEPEST = 0.05  # of the longest side of a triangle's box: what is deeper inside is behind another part of the body
STRETCH = 1.5  # by so much triangles may be longer than at rest
SAME = 1e-7  # of that side, or of a weight: what is nearer is in the same place
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # of x, y, z
_SHARP = 0.94  # cosine between triangles beside an edge, 20 degrees: at less it is one that edges of others meet
_STEEPEST = 0.3  # cosine between normals of crossing edges and of the body: what is less passes beside it
_PARALLEL = 1e-6  # sine: edges that cross at less have no normal


class Places(NamedTuple):
    """Where k corners and edges of an obstacle are near faces of a body."""

    keys: Array  # (k,) of what meets what, the obstacle's part times `BodyFaces.parts` plus the body's
    nodes: Array  # (k, 3) contact points that carry each place
    weights: Array  # (k, 3) of these
    at: Array  # (k, 3) where it is, m
    gaps: Array  # (k,) m
    normals: Array  # (k, 3) units, out of the obstacle

    def of(self, rows: "Array | slice") -> "Places":
        """Some of them."""
        return Places(*(part[rows] for part in self))


class _Met(NamedTuple):
    """Places, as of `Places`, and whether they are on both of what meets there, (k,)."""

    nodes: Array
    weights: Array
    at: Array
    gaps: Array
    normals: Array
    held: Array


class BodyFaces:
    """The triangles between contact points of a body.

    Args:
        points: at rest (P, 3), m.
        triangles: (F, 3) rows of points, counterclockwise from outside.

    Attributes:
        parts: how many triangles and edges there are.
        size: longest side of a triangle's box at rest, m.
        wall: how thick the body is behind them at rest, as far as they are on its other side, too, m; `size` at most.
        reach: how far a place may be from the nearest corner of its triangle, m.
        edges: (E, 2) rows of points.
        sharp: which of these bend at rest, or are on a border, (E,).

    Raises:
        SceneError: there is no triangle.
    """

    def __init__(self, points: Array, triangles: Array):
        if not len(triangles):
            raise SceneError(
                "effects.contact.points = 'faces': there is no triangle between contact points: use contact "
                "modes whose surfaces have areas"
            )
        self.triangles, (self.edges, self._beside, self._edge_of) = triangles, edges_of(triangles)
        third = triangles[self._beside].sum(axis=2) - self.edges.sum(axis=1)[:, None]
        self._third = np.where(self._beside < 0, third[:, :1], third)  # corners opposite to edges; one on a border
        self._second = np.where(self._beside < 0, self._beside[:, :1], self._beside)[:, 1]
        self.parts, self.size = len(triangles) + len(self.edges), Boxes.about(points[triangles.T]).size
        beside = unit_normals(points[triangles])[self._beside]
        self.sharp = (_dot(beside[:, 0], beside[:, 1]) < _SHARP) | (self._beside[:, 1] < 0)
        self.wall = thinnest_wall(points[triangles], points[triangles], self.size)
        self.reach = STRETCH * float(covering_radius(points[triangles]).max())

    def near(self, points: Array, distances: Array, outline: Outline, margin: float, depth: float) -> Places:
        """Places whose gaps are at most a margin and at least -depth, m; each once, lowest gaps first.

        Args:
            points: (P, 3), m, as seen from the obstacle.
            distances: of these from the obstacle, (P,), m.
            outline: of the obstacle.
            margin, depth: see above.
        """
        near = (distances[self.triangles].min(axis=1) <= margin + self.reach).nonzero()[0]
        if not (len(near) and len(outline.corners)):
            return self._meet(points, outline, np.empty(0, dtype=int))[0]
        corners = points[self.triangles[near]]
        wide = max(margin, depth) + outline.reach
        corner, edge = outline.among(corners.min(axis=(0, 1)) - wide, corners.max(axis=(0, 1)) + wide)
        at, row = near_boxes(outline.corners[corner], Boxes.about(corners.transpose(1, 0, 2)).wider(wide))
        own = len(self.triangles) + np.unique(self._edge_of[near])
        keys = [
            corner[at] * self.parts + near[row],
            (np.concatenate([corner, len(outline.corners) + edge])[:, None] * self.parts + own).ravel(),
        ]
        places, held = self._meet(points, outline, np.concatenate(keys))
        held &= (places.gaps <= margin) & (places.gaps >= -depth) & (places.weights.max(axis=1) < 1 - SAME)
        return _each_once(places.of(held), SAME * self.size)

    def crossings(self, points: Array, outline: Outline, margin: float, depth: float) -> Places:
        """Of places as of `near` those where edges of an outline are at sharp edges of the body."""
        own, ends = self.sharp.nonzero()[0], points[self.edges[self.sharp]]
        low, high = ends.min(axis=1) - margin, ends.max(axis=1) + margin
        _, edge = outline.among(low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf))
        there = outline.corners[outline.edges[edge]]
        meet = (low[:, None] <= there.max(axis=1)) & (high[:, None] >= there.min(axis=1))
        row, of = meet.all(axis=2).nonzero()
        keys = (len(outline.corners) + edge[of]) * self.parts + len(self.triangles) + own[row]
        places, held = self._meet(points, outline, keys)
        return places.of(held & (places.gaps <= margin) & (places.gaps >= -depth))

    def at(self, points: Array, outline: Outline, keys: Array) -> Places:
        """What is meant by some keys (k,), also where a foot is beside its triangle or edge; else as in `near`."""
        return self._meet(points, outline, keys)[0]

    def _meet(self, points: Array, outline: Outline, keys: Array) -> tuple[Places, Array]:
        """The places of keys (k,), and which are on what they are said to be on."""
        part, own = np.divmod(keys, self.parts)
        is_corner, is_face = part < len(outline.corners), own < len(self.triangles)
        faces, edges, crossings = (rows.nonzero()[0] for rows in (is_face, is_corner & ~is_face, ~is_corner))
        found, order = list[_Met](), np.concatenate([faces, edges, crossings]).argsort()
        if len(faces) or not len(keys):
            found.append(self._on_faces(points, outline.corners[part[faces]], own[faces], outline.radius))
        own = own - len(self.triangles)
        if len(edges):
            found.append(self._on_edges(points, outline.corners[part[edges]], own[edges], outline.radius))
        if len(crossings):
            parts = part[crossings] - len(outline.corners)
            found.append(self._at_crossings(points, outline, parts, own[crossings]))
        values = [np.concatenate(part)[order] for part in zip(*found, strict=True)]
        return Places(keys, *values[:-1]), values[-1]

    def _on_faces(self, points: Array, corners: Array, triangles: Array, radius: float) -> _Met:
        """Corners of an obstacle (k, 3), m, at triangles (k,)."""
        nodes = self.triangles[triangles]
        places = points[nodes]
        weights, n = weights_in_planes(corners, places), unit_normals(places)
        at, gaps = (weights[:, :, None] * places).sum(axis=1), _dot(corners - places[:, 0], n) - radius
        return _Met(nodes, weights, at, gaps, -n, weights.min(axis=1) >= -SAME)

    def _on_edges(self, points: Array, corners: Array, edges: Array, radius: float) -> _Met:
        """Corners of an obstacle (k, 3), m, at edges (k,)."""
        begin, along = self._along(points, edges)
        arms, squares = corners - begin, _dot(along, along)
        share = _dot(arms, along) / squares
        held = (share > SAME) & (share < 1 - SAME)
        for third in self._third[edges].T:
            inward = points[third] - begin
            inward = inward - (_dot(inward, along) / squares)[:, None] * along
            held &= _dot(arms, inward) < -SAME * _dot(inward, inward)
        at, middle = begin + share[:, None] * along, self._middles(points, edges)
        away = at - corners
        length, side = np.sqrt(_dot(away, away)), np.where(_dot(away, middle) > 0, -1.0, 1.0)
        is_clear = length > SAME * self.size
        n = np.where(is_clear[:, None], away * (side / np.where(is_clear, length, 1.0))[:, None], -middle)
        return _Met(*self._carried(edges, share), at, side * length - radius, n, held)

    def _at_crossings(self, points: Array, outline: Outline, parts: Array, edges: Array) -> _Met:
        """Edges of an obstacle (k,) at edges (k,)."""
        begin, along = self._along(points, edges)
        start, stop = outline.corners[outline.edges[parts]].transpose(1, 0, 2)
        way, apart = stop - start, begin - start
        n = _cross(way, along)
        squares, most = _dot(n, n), _dot(way, way) * _dot(along, along)
        held = squares > _PARALLEL**2 * most
        per = 1 / np.where(held, squares, most)
        share, of_way = _dot(_cross(apart, way), n) * per, _dot(_cross(apart, along), n) * per
        n *= np.sqrt(per)[:, None]
        cosine = _dot(n, self._middles(points, edges))
        n *= np.where(cosine > 0, -1.0, 1.0)[:, None]
        held &= (share > SAME) & (share < 1 - SAME) & (of_way > 0) & (of_way < 1) & (np.abs(cosine) >= _STEEPEST)
        at, gaps = begin + share[:, None] * along, _dot(apart, n) - outline.radii(parts)
        return _Met(*self._carried(edges, share), at, gaps, n, held)

    def _along(self, points: Array, edges: Array) -> tuple[Array, Array]:
        """Where edges (k,) begin, and the way to their ends, (k, 3), m."""
        begin, end = points[self.edges[edges]].transpose(1, 0, 2)
        return begin, end - begin

    def _middles(self, points: Array, edges: Array) -> Array:
        """Units (k, 3) out of the body at edges (k,)."""
        beside = np.stack([self._beside[edges, 0], self._second[edges]])
        middles: Array = unit_normals(points[self.triangles[beside.ravel()]]).reshape(2, -1, 3).sum(axis=0)
        return middles / np.maximum(np.sqrt(_dot(middles, middles)), SAME)[:, None]

    def _carried(self, edges: Array, share: Array) -> tuple[Array, Array]:
        """Nodes and weights (k, 3) of places on edges (k,), after a share (k,) of their length."""
        nodes = np.concatenate([self.edges[edges], self._third[edges, :1]], axis=1)
        return nodes, np.stack([1 - share, share, np.zeros(len(share))], axis=1)


def _each_once(places: Places, near: float) -> Places:
    """Those of places that are no nearer than so much, m, to others of the same normal with lower gaps, by these."""
    places = places.of(np.argsort(places.gaps, kind="stable"))
    if len(places.gaps) < 2:
        return places
    apart = (np.abs(places.at[:, None] - places.at) > near) | (np.abs(places.normals[:, None] - places.normals) > SAME)
    return places.of((apart.any(axis=2) | ~np.tri(len(apart), k=-1, dtype=bool)).all(axis=1))


def _cross(a: Array, b: Array) -> Array:
    return a.take(_NEXT, axis=1) * b.take(_LAST, axis=1) - a.take(_LAST, axis=1) * b.take(_NEXT, axis=1)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)
