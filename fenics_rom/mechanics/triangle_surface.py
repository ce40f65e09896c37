"""Distances from surfaces of triangles, with a sign, and where ways go through them.

The nearest point q of the surface is in a triangle, on an edge or at a corner. Outside and inside are told by the
angle-weighted pseudo-normals of these (Baerentzen & Aanaes, IEEE Trans. Vis. Comput. Graph. 11, 2005). The normal at a
place x is along x - q, within the cone of the normals of the triangles that meet in q: so that it is the triangles' own
where these are in one plane, however near x is, and no round-off turns it at the edges between them.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.box_tree import BoxTree
from fenics_rom.mechanics.triangles import nearest_on_triangles

ROUND_OFF = 1e-13  # of the size: ways that go no deeper go nowhere
BESIDE = 1e-9  # of the size: so far behind a triangle a way may begin and still come from before it
AT_CORNER = 1e-9  # of the size: nearer to a corner, or a border, the direction to it is round-off
SAME = 1e-9  # of the size, and of units: planes that differ by less are one
MORE_PLANES = 5  # beside that of the nearest place, that a point may meet of a surface in a step
OVERLAP = 1e-6  # of a triangle, by which it takes more, so that no way passes between two of them
STEEPEST = 1e8  # tangent of the half of an edge's cone: of a knife's edge
_ONES = np.ones(3)


class Foot(NamedTuple):
    """What of a surface is nearest to points (P, 3)."""

    gaps: Array  # (P,), m; < 0 inside
    normals: Array  # (P, 3), units
    places: Array  # (P, 3), m
    edge: Array  # (P, 3): unit vector along the edge that it is on; 0 of triangles and corners
    is_flat: Array  # (P,) whether it is a triangle


class NearPlanes(NamedTuple):
    """Planes that points may meet."""

    row: Array  # (k,) of the points
    gaps: Array  # (k,), m
    normals: Array  # (k, 3), units
    feature: Array  # (k,) what of the surface: 0 is the nearest place


class TriangleSurface:
    """A surface of triangles, counterclockwise from outside.

    Args:
        vertices: (V, 3), m.
        triangles: (T, 3) rows of them.

    Attributes:
        vertices, triangles: as given.
        normals: (T, 3), units.
        size: longest edge of the box that holds it, m.
        edges: (E, 2) rows of vertices.
        beside: (E, 2) triangles on both sides of each edge; on its border the second is -1.
        is_concave: whether the surface goes in anywhere, at one of its edges.
    """

    def __init__(self, vertices: Array, triangles: Array):
        self.vertices, self.triangles = vertices, triangles
        self._corners = vertices[triangles]
        self.size = float(np.ptp(vertices, axis=0).max())
        crossed = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0])
        self.normals = crossed / np.linalg.norm(crossed, axis=1)[:, None]
        sides = np.roll(self._corners, -1, axis=1) - self._corners
        self._inward = np.cross(self.normals[:, None], sides)  # across each side, as long as it
        self._tree = BoxTree(self._corners)
        self.edges, self.beside, self._edge_of = edges_of(triangles)
        self._set_edges()
        self._corner_normals = self._normals_at_corners()

    def _set_edges(self) -> None:
        """Of each edge the middle of its cone of normals, how far it goes to both sides, and which way it bends."""
        along = self.vertices[self.edges[:, 1]] - self.vertices[self.edges[:, 0]]
        self._along = along / np.linalg.norm(along, axis=1)[:, None]
        first, second = self.beside.T
        self._is_border = second < 0
        second = np.where(self._is_border, first, second)
        n = self.normals[first]
        middle = n + self.normals[second]
        length = np.linalg.norm(middle, axis=1)
        own, other = (
            self.vertices[self.triangles[each].sum(axis=1) - self.edges.sum(axis=1)] - self.vertices[self.edges[:, 0]]
            for each in (first, second)
        )
        is_knife = length < 2 / STEEPEST  # of triangles that lie on one another: out is away from both
        away = np.cross(self._along, n)
        away *= -np.sign((away * own).dot(_ONES))[:, None]
        middle[is_knife], length[is_knife] = away[is_knife], 1.0
        self._middle = middle / length[:, None]
        self._across = np.cross(self._along, self._middle)
        cosine, sine = ((n * each).dot(_ONES) for each in (self._middle, self._across))
        self._steepest = np.abs(sine) / np.maximum(cosine, 1 / STEEPEST)
        height = (other * n).dot(_ONES)  # of the other triangle before the plane of the first
        flat = ROUND_OFF * max(self.size, float(np.abs(self.vertices).max()))
        self._bend = (height > flat).astype(int) - (height < -flat)  # 1: in, -1: out
        self.is_concave = bool((self._bend > 0).any())
        self._valence = np.bincount(self.triangles.ravel(), minlength=len(self.vertices))
        # Which vertices are at edges that bend out, at those that bend in, and on a border.
        self._touched = np.zeros((3, len(self.vertices)), dtype=bool)
        for bends, of in zip(self._touched, (self._bend < 0, self._bend > 0, self._is_border), strict=True):
            bends[self.edges[of]] = True

    def _normals_at_corners(self) -> Array:
        """Angle-weighted pseudo-normals (V, 3) of the vertices, units."""
        sides = np.roll(self._corners, -1, axis=1) - self._corners
        sides /= np.linalg.norm(sides, axis=2)[:, :, None]
        cosines = -(sides * np.roll(sides, 1, axis=1)).dot(_ONES)
        weighted = np.arccos(np.clip(cosines, -1.0, 1.0))[:, :, None] * self.normals[:, None]
        sums = np.zeros_like(self.vertices)
        np.add.at(sums, self.triangles.ravel(), weighted.reshape(-1, 3))
        length = np.linalg.norm(sums, axis=1)[:, None]
        return sums / np.where(length > 0, length, 1.0)

    @property
    def sharp_edges(self) -> Array:
        """Edges (k, 2) that bend out, as rows of vertices."""
        sharp: Array = self.edges[self._bend < 0]
        return sharp

    @property
    def sharp_corners(self) -> Array:
        """Vertices (k, 3), m, at edges that bend out, and at none that bends in."""
        goes_out, goes_in, _ = self._touched
        return self.vertices[goes_out & ~goes_in]

    @property
    def volume(self) -> float:
        """That it encloses, if it is closed, m³; < 0 if it is turned inside out."""
        a, b, c = (self._corners - self.vertices.mean(axis=0)).transpose(1, 0, 2)
        return float((a * np.cross(b, c)).sum()) / 6

    @property
    def is_closed(self) -> bool:
        """Whether it has no border."""
        return not self._is_border.any()

    @property
    def is_before_no_plane(self) -> bool:
        """Whether no vertex is before the plane of a triangle, but for round-off."""
        levels = (self._corners[:, 0] * self.normals).dot(_ONES)
        parts = (self.vertices @ part.T for part in np.array_split(self.normals, len(self.normals) // 256 + 1))
        highest = np.concatenate([part.max(axis=0) for part in parts])
        return bool((highest <= levels + 10 * ROUND_OFF * max(self.size, float(np.abs(levels).max()))).all())

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and unit normals (P, 3)."""
        foot = self.foot(points)
        return foot.gaps, foot.normals

    def foot(self, points: Array) -> Foot:
        """What is nearest to points (P, 3), m."""
        triangle = self._tree.nearest(points)
        weights, places = nearest_on_triangles(points, self._corners[triangle])
        away = points - places
        normals = self.normals[triangle]
        gaps = ((points - self._corners[triangle, 0]) * normals).dot(_ONES)
        corners = (weights > 0).sum(axis=1)
        along = np.zeros_like(points)
        if (rows := (corners == 2).nonzero()[0]).size:
            opposite = weights[rows].argmin(axis=1)
            edge = self._edge_of[triangle[rows], (opposite + 1) % 3]
            gaps[rows], normals[rows] = self._at_edges(edge, away[rows], normals[rows])
            along[rows] = self._along[edge]
        if (rows := (corners == 1).nonzero()[0]).size:
            corner = self.triangles[triangle[rows], weights[rows].argmax(axis=1)]
            gaps[rows], normals[rows] = self._at_corners(corner, away[rows], normals[rows])
        return Foot(gaps, normals, places, along, corners == 3)

    def _at_edges(self, edge: Array, away: Array, own: Array) -> tuple[Array, Array]:
        """Gaps and normals at edges, of what is `away` (k, 3) from them; own: normals of the triangles, (k, 3)."""
        middle, across, steepest = self._middle[edge], self._across[edge], self._steepest[edge]
        up, aside = (away * middle).dot(_ONES), (away * across).dot(_ONES)
        sign = np.where(up < 0, -1.0, 1.0)
        up = np.abs(up)
        normals = up[:, None] * middle + np.clip(sign * aside, -steepest * up, steepest * up)[:, None] * across
        length = np.sqrt((normals * normals).dot(_ONES))
        is_at = length <= AT_CORNER * self.size
        normals = np.where(is_at[:, None], middle, normals / np.where(is_at, 1.0, length)[:, None])
        # Where the surface goes in, what is before it is nearer to one of both triangles, or as near but for round-off.
        bend = self._bend[edge]
        from_plane = (sign * bend > 0) | (is_at & (bend > 0))
        normals[from_plane] = own[from_plane]
        if (border := self._is_border[edge]).any():  # what is beside it is outside
            direct = np.sqrt((away * away).dot(_ONES))
            clear = border & (direct > AT_CORNER * self.size)
            normals[clear] = away[clear] / direct[clear, None]
            normals[border & ~clear] = own[border & ~clear]
        return (away * normals).dot(_ONES), normals

    def _at_corners(self, corner: Array, away: Array, own: Array) -> tuple[Array, Array]:
        """The same at vertices."""
        normals = self._corner_normals[corner]
        goes_out, goes_in, is_border = self._touched[:, corner]
        length, up = np.sqrt((away * away).dot(_ONES)), (away * normals).dot(_ONES)
        is_inside = (up < 0) & ~is_border
        is_flat = ~(goes_out | goes_in | is_border)
        from_plane = np.where(is_inside, goes_out, goes_in) | is_flat
        normals = np.where(from_plane[:, None], own, normals)
        clear = (length > AT_CORNER * self.size) & ~is_flat
        normals[clear] = away[clear] / np.where(is_inside, -length, length)[clear, None]
        return (away * normals).dot(_ONES), normals

    def planes_near(self, points: Array, reach: float) -> NearPlanes:
        """All planes that ways from points (P, 3), m, may go through which are no longer than a reach, m.

        Of the nearest place; of all that are nearer than others around them; and, where the surface goes in, of
        triangles whose nearest place is where it does: of each point the MORE_PLANES nearest.
        """
        foot = self.foot(points)
        near = (foot.gaps <= reach).nonzero()[0]
        nearest = NearPlanes(near, foot.gaps[near], foot.normals[near], np.zeros(len(near), dtype=int))
        outside = near[foot.gaps[near] >= -BESIDE * self.size]
        which, triangle = self._tree.meeting(points[outside] - reach, points[outside] + reach)
        row = outside[which]
        corners = self._corners[triangle]
        weights, places = nearest_on_triangles(points[row], corners)
        away = points[row] - places
        lengths, (gaps, normals) = np.sqrt((away * away).dot(_ONES)), self.planes(triangle, points[row])
        on = (weights > 0).sum(axis=1)
        edge = self._edge_of[triangle, (weights.argmin(axis=1) + 1) % 3]
        corner = self.triangles[triangle, weights.argmax(axis=1)]
        T, E = len(self.triangles), len(self.edges)
        # One number for each edge and corner that places are on; all triangles there see it, where it is the nearest.
        place = np.select([on == 3, on == 2], [triangle, T + edge], T + E + corner)
        _, first, of, count = np.unique(
            row * (T + E + len(self.vertices)) + place, return_index=True, return_inverse=True, return_counts=True
        )
        around = np.select([on == 3, on == 2], [1, np.where(self._is_border[edge], 1, 2)], self._valence[corner])
        is_least = count[of] == around
        goes_in = np.where(on == 2, self._bend[edge] > 0, self._touched[1, corner]) & (on < 3) & ~is_least
        is_first = np.zeros(len(row), dtype=bool)
        is_first[first] = True
        on_edge, at_corner = (is_least & is_first & (on == k) for k in (2, 1))
        gaps[on_edge], normals[on_edge] = self._at_edges(edge[on_edge], away[on_edge], normals[on_edge])
        gaps[at_corner], normals[at_corner] = self._at_corners(corner[at_corner], away[at_corner], normals[at_corner])
        known = (np.abs(gaps - foot.gaps[row]) <= SAME * self.size) & (
            (normals * foot.normals[row]).dot(_ONES) >= 1 - SAME
        )
        ahead = (lengths <= reach) & (gaps >= -BESIDE * self.size) & ~known
        kept = (ahead & ((is_least & is_first) | goes_in)).nonzero()[0]
        kept = kept[np.lexsort((lengths[kept], row[kept]))]
        rank = np.arange(len(kept)) - np.searchsorted(row[kept], row[kept])
        kept = kept[rank < MORE_PLANES]
        feature = 1 + np.where(goes_in, triangle, place)
        more = NearPlanes(row[kept], gaps[kept], normals[kept], feature[kept])
        return NearPlanes(*(np.concatenate(both) for both in zip(nearest, more, strict=True)))

    def first_crossed(self, starts: Array, ends: Array) -> Array:
        """Numbers of the triangles that straight ways (P, 3) to (P, 3) go through first, from before them; else -1."""
        limits = ROUND_OFF * self.size, BESIDE * self.size, OVERLAP
        found = self._tree.first_crossed(starts, ends, limits, self.normals, self._inward)
        if found is not None:
            return found
        way, triangle, before, after = self._met(starts, ends)
        near = ((after < -ROUND_OFF * self.size) & (before >= -BESIDE * self.size)).nonzero()[0]
        way, triangle, before, after = (each[near] for each in (way, triangle, before, after))
        share, at = self._places(starts, ends, way, before, after)
        held = self._hold(triangle, at).nonzero()[0]
        order = held[np.lexsort((after[held], share[held], way[held]))]
        found = np.full(len(starts), -1)
        found[way[order[::-1]]] = triangle[order[::-1]]
        return found

    def pierced(self, starts: Array, ends: Array) -> tuple[Array, Array, Array, Array]:
        """Where ways (P, 3) to (P, 3) go through triangles either way.

        Returns:
            ways, triangles: (k,) their numbers.
            depth: (k,) how far they go on behind, or come from before if that is less, m.
            places: (k, 3), m.
        """
        way, triangle, before, after = self._met(starts, ends)
        apart = (before * after < 0).nonzero()[0]
        way, triangle, before, after = (each[apart] for each in (way, triangle, before, after))
        _, at = self._places(starts, ends, way, before, after)
        held = self._hold(triangle, at)
        return way[held], triangle[held], np.minimum(np.abs(before), np.abs(after))[held], at[held]

    def _met(self, starts: Array, ends: Array) -> tuple[Array, Array, Array, Array]:
        """Ways and triangles whose boxes meet, and how far before the planes (k,), m, the ways begin and end."""
        margin = BESIDE * self.size
        way, triangle = self._tree.meeting(np.minimum(starts, ends) - margin, np.maximum(starts, ends) + margin)
        before, after = (self.planes(triangle, at[way])[0] for at in (starts, ends))
        return way, triangle, before, after

    def _places(self, starts: Array, ends: Array, way: Array, before: Array, after: Array) -> tuple[Array, Array]:
        """Shares (k,) and places (k, 3) of ways where they are in planes, of which they are so far before, m."""
        share = np.clip(before / np.where(before == after, 1.0, before - after), 0.0, 1.0)
        return share, starts[way] + share[:, None] * (ends - starts)[way]

    def _hold(self, triangle: Array, at: Array) -> Array:
        """Which triangles (k,) hold places in their planes, (k, 3), m."""
        areas = ((at[:, None] - self._corners[triangle]) * self._inward[triangle]).dot(_ONES)
        held: Array = areas.min(axis=1) >= -OVERLAP * areas.sum(axis=1)
        return held

    def planes(self, triangle: Array, points: Array) -> tuple[Array, Array]:
        """Distances (P,), m, of points (P, 3), m, from the planes of triangles (P,), and normals (P, 3)."""
        normals = self.normals[triangle]
        return ((points - self._corners[triangle, 0]) * normals).dot(_ONES), normals


def edges_of(triangles: Array) -> tuple[Array, Array, Array]:
    """Edges (E, 2), triangles beside them (E, 2), and which edge begins at each corner of triangles, (T, 3).

    Of more than two triangles at an edge the first two are named; -1 is none.
    """
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, edge = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    edge = edge.ravel()
    order = np.argsort(edge, kind="stable")
    first = np.searchsorted(edge[order], np.arange(len(edges)))
    counts = np.bincount(edge)
    second = np.where(counts > 1, order[np.minimum(first + 1, len(order) - 1)] // 3, -1)
    beside = np.stack([order[first] // 3, second], axis=1)
    return edges, beside, edge.reshape(-1, 3)
