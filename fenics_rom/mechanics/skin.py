"""The surface of a body, and how deep obstacles and other bodies are in it where contact does not keep them out.

Contact keeps contact points out of obstacles, and nothing else: where a surface has no contact points, and between
points that are farther apart than an obstacle is wide, it goes through. Depth is measured

    at the skin     by how deep the deepest point of its triangles is inside the obstacle;
    inside of it    of balls of a radius r that the obstacle holds (its core), whose centre is inside of the body,
                    by r + the distance of the centre from the skin.

Both are at most the depth that there is, so that nothing is told that is not so. Whether a point is inside of the skin
the solid angle of its triangles says (van Oosterom & Strackee, IEEE Trans. Biomed. Eng. 30, 1983).
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.obstacle_poses import between, distance_from, farthest_moved, placed
from fenics_rom.mechanics.triangles import covering_radius, nearest_on_triangles

if TYPE_CHECKING:
    from fenics_rom.mechanics.obstacles import Obstacle

UNTOUCHED = ""  # name of the part of a skin that has no contact points
# How deep something may be before it is told, in shares of how far a place is from the nodes of its triangle: between
# contact points, beside them (where what they keep out bends the skin) or what is held, and elsewhere; in demos the
# most is 0.07.
BETWEEN, BESIDE, ELSEWHERE = 1.0, 0.25, 0.1
SHARE_OF_OBSTACLE = 0.5  # of its inner radius: and no deeper, but between contact points
STRETCH = 1.5  # by so much a triangle may be longer than at rest and still be looked at
FEW = 48  # nodes that are looked at first
_SEARCHES = 4  # for the deepest point of a triangle, to a tenth of its size: of balls the first finds it exactly
_LATTICE = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4  # where in a triangle they begin
_ONES = np.ones(3)
_NO_NAMES: Mapping[str, Array] = {}


class Intruder(Protocol):
    """What may get into a body, rigid and convex."""

    def distance(self, points: Array) -> tuple[Array, Array]:
        """As of an Obstacle."""

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Obstacle."""

    def after(self, before: Any, share: float) -> "Intruder":
        """What it was after a share of the way from what it was before to what it is."""

    def moved(self, before: Any) -> float:
        """No point of it is farther from where it was before, m."""


class MovedIntruder(NamedTuple):
    """One that is displaced, or posed."""

    shape: "Obstacle"
    offset: Array  # (3,), m; or a pose (7,), see `obstacle_poses`

    def distance(self, points: Array) -> tuple[Array, Array]:
        """As of an Intruder."""
        return distance_from(self.shape, points, self.offset)

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Intruder."""
        radius, centres = self.shape.core
        return radius, placed(centres, self.offset)

    def after(self, before: "MovedIntruder", share: float) -> "MovedIntruder":
        """As of an Intruder."""
        return MovedIntruder(self.shape, between(before.offset[None], self.offset[None], share)[0])

    def moved(self, before: "MovedIntruder") -> float:
        """As of an Intruder."""
        return farthest_moved(self.shape, before.offset, self.offset)


class Intrusion(NamedTuple):
    """How deep something is in a body."""

    depth: float  # m
    place: Array  # of the skin, (3,), m
    part: str  # of the skin: a contact mode, between whose points it is, or UNTOUCHED
    surface: str = ""  # name of the surface that the place is on; "" of none


class Skin:
    """The surface of a body, and where it has contact points.

    Args:
        coordinates: of all nodes at rest, (N, 3), m.
        triangles: (F, 3) outward, between nodes.
        surfaces: nodes of the contact surface of each contact mode.
        movable: (N,) which nodes can move; triangles that cannot are not looked at.
        named: nodes of surfaces that have names, to say where something is.

    Attributes:
        nodes: (V,) on the skin, ascending.
        coordinates: theirs at rest, (V, 3), m.
        triangles: (F, 3) rows of these.
        spacing: (F,) largest distance of a point of a triangle at rest from the nearest node, m.
        covered: (F,) triangles between contact points.
        touched: (V,) which of its nodes are contact points.
        names: of contact modes that have a surface.
        few_rows: (f,) of nodes that are looked at first, spread over it.
        extent: its longest edge along the axes, m.
    """

    def __init__(
        self,
        coordinates: Array,
        triangles: Array,
        surfaces: Mapping[str, Array],
        movable: Array,
        named: Mapping[str, Array] = _NO_NAMES,
    ):
        self.nodes, rows = np.unique(triangles, return_inverse=True)
        self.triangles = rows.reshape(triangles.shape)
        self.coordinates = places = coordinates[self.nodes]
        self.spacing = covering_radius(places[self.triangles])
        self.names = [name for name, nodes in surfaces.items() if len(nodes)]
        self.touched = np.isin(self.nodes, np.concatenate([np.empty(0, dtype=int), *surfaces.values()]))
        self.covered = self.touched[self.triangles].all(axis=1)
        beside = self.touched[self.triangles].any(axis=1) | ~movable[triangles].all(axis=1)
        self._explained = self.spacing * np.where(self.covered, BETWEEN, np.where(beside, BESIDE, ELSEWHERE))
        self._watched = np.flatnonzero(movable[triangles].any(axis=1) & np.isfinite(self.spacing))
        self._of_mode = [np.isin(self.nodes, surfaces[name]) for name in self.names]
        self._named = {
            name: np.isin(self.nodes, named[name]) for name in sorted(named, key=lambda name: len(named[name]))
        }
        self.few_rows = np.unique(np.linspace(0, len(self.nodes) - 1, min(FEW, len(self.nodes))).astype(int))
        self.extent = float(np.ptp(places, axis=0).max()) if len(places) else 0.0
        self._reach = STRETCH * (_covering(places, places[self.few_rows]) + float(self.spacing.max(initial=0.0)))

    def may_meet(self, few: Array, gaps: Array, intruder: Intruder) -> bool:
        """Whether something may be in the body, by its gaps (f,), m, from nodes that are looked at first, (f, 3), m."""
        if self.room(gaps) <= 0:
            return True
        core, low, high = intruder.core[1], few.min(axis=0) - self._reach, few.max(axis=0) + self._reach
        return bool(((core > low) & (core < high)).all(axis=1).any())  # all of it may be inside

    def room(self, gaps: Array) -> float:
        """By how much less gaps (f,), m, from nodes that are looked at first may become before something may be in."""
        return float(gaps.min(initial=np.inf)) - self._reach

    def room_beside(self, other: "Skin", few: Array, others: Array) -> float:
        """By how much less the gap of two skins may become before they touch, by their nodes that are looked at first.

        Those are at few (f, 3) and others (g, 3), m.
        """
        apart = np.maximum(few.min(axis=0) - others.max(axis=0), others.min(axis=0) - few.max(axis=0))
        return float(apart.max()) - self._reach - other._reach

    def places(self, field: Array) -> Array:
        """Where its nodes are, (V, 3), m, in a body displaced by a field (N, 3), m."""
        places: Array = self.coordinates + field[self.nodes]
        return places

    def intrusions(self, places: Array, intruder: Intruder, springs: bool = False) -> list[Intrusion]:
        """How deep something is in the body, where it is deeper than the spacing of nodes explains: one of each part.

        Args:
            places: of the nodes of the skin, (V, 3), m.
            intruder: what may be in it.
            springs: whether contact points are kept out by springs, so that all may be as deep as they are.
        """
        gaps, (radius, core) = intruder.distance(places)[0], intruder.core
        ease = max(0.0, -float(gaps[self.touched].min(initial=0.0))) if springs else 0.0
        explained = np.where(self.covered, self._explained, np.minimum(self._explained, SHARE_OF_OBSTACLE * radius))
        found = self._at_skin(places, gaps, intruder, radius, explained + ease)
        inside = core[self.contain(places, core)] if len(core) else core
        if len(inside):
            where = self._watched[~self.covered[self._watched] | (self.spacing[self._watched] > radius)]
            below, row = self._below(places, inside, where if len(where) else self._watched)
            depth, before = radius + below.depth, found.get(below.part)
            is_within = below.depth >= radius  # all of a ball
            if (depth > explained[row] + ease or is_within) and (before is None or depth > before.depth):
                found[below.part] = below._replace(depth=depth)
        return list(found.values())

    def below(self, places: Array, points: Array) -> Intrusion:
        """How far below the skin, at places (V, 3), m, the deepest of points (P, 3), m, inside of it is."""
        return self._below(places, points, self._watched)[0]

    def part_at(self, corners: Array) -> str:
        """The part of the skin that a triangle between these rows (3,) of its nodes is on."""
        if not self.touched[corners].all():
            return UNTOUCHED
        shared = [int(nodes[corners].sum()) for nodes in self._of_mode]
        return self.names[int(np.argmax(shared))]

    def surface_at(self, corners: Array) -> str:
        """Name of the smallest surface that a triangle between these rows (3,) of its nodes is on; "" where none is."""
        return next((name for name, nodes in self._named.items() if nodes[corners].all()), "")

    def leave_out(self, gaps: Array) -> None:
        """Looks no more at triangles that something is in, by its gaps (V,), m, from the nodes."""
        near = gaps[self.triangles[self._watched]].min(axis=1) < BESIDE * self.spacing[self._watched]
        self._watched = self._watched[~near]

    def contain(self, places: Array, points: Array) -> Array:
        """Which of points (P, 3) are inside of the skin, (P,); both in m."""
        inside = ((points > places.min(axis=0)) & (points < places.max(axis=0))).all(axis=1)
        for row in np.flatnonzero(inside):
            inside[row] = solid_angle(places[self.triangles] - points[row]) > 2 * np.pi
        return inside

    def _at_skin(
        self, places: Array, gaps: Array, intruder: Intruder, radius: float, allowed: Array
    ) -> dict[str, Intrusion]:
        """The deepest points of the triangles that are deeper than allowed (F,), m, by part; gaps are of places, m."""
        watched = self._watched
        corner_gaps = gaps[self.triangles[watched]]
        lowest = corner_gaps.min(axis=1)
        near = (lowest < STRETCH * self.spacing[watched] - allowed[watched]).nonzero()[0]
        if not len(near):
            return {}
        rows, deepest = watched[near], lowest[near]
        corners = places[self.triangles[rows]]
        at = corners[np.arange(len(rows)), corner_gaps[near].argmin(axis=1)]
        if np.isfinite(radius):
            tried = _LATTICE @ corners
            there = intruder.distance(tried.reshape(-1, 3))[0].reshape(tried.shape[:2])
            # No point is farther from a tried one than a quarter of how far some are from the corners.
            may = there.min(axis=1) < STRETCH * self.spacing[rows] / 4 - allowed[rows]
            if not may.any():
                return {}
            rows, deepest, at, corners = rows[may], deepest[may], at[may], corners[may]
            tried = tried[may, there[may].argmin(axis=1)]
            for _ in range(_SEARCHES):
                there, normals = intruder.distance(tried)
                deeper = there < deepest
                deepest, at = np.where(deeper, there, deepest), np.where(deeper[:, None], tried, at)
                tried = nearest_on_triangles(tried - (there + radius)[:, None] * normals, corners)[1]
        found: dict[str, Intrusion] = {}
        for row in np.flatnonzero(-deepest > allowed[rows]):
            here = self.triangles[rows[row]]
            part = self.part_at(here)
            if part not in found or found[part].depth < -deepest[row]:
                found[part] = Intrusion(-float(deepest[row]), at[row], part, self.surface_at(here))
        return found

    def _below(self, places: Array, points: Array, among: Array) -> tuple[Intrusion, int]:
        """How far the deepest of points (P, 3) is below the nearest of some triangles, and which that is."""
        best = Intrusion(-1.0, np.zeros(3), UNTOUCHED), 0
        corners = places[self.triangles[among]]
        for point in points:
            _, feet = nearest_on_triangles(np.broadcast_to(point, (len(among), 3)), corners)
            away = np.sqrt(np.square(feet - point).dot(_ONES))
            row = int(away.argmin())
            if away[row] > best[0].depth:
                triangle = int(among[row])
                here = self.triangles[triangle]
                best = Intrusion(float(away[row]), feet[row], self.part_at(here), self.surface_at(here)), triangle
        return best


def _covering(places: Array, few: Array) -> float:
    """Largest distance from one of places (V, 3) to the nearest of a few (f, 3), m."""
    squares = np.full(len(places), np.inf)
    for point in few:
        squares = np.minimum(squares, np.square(places - point).dot(_ONES))
    return float(np.sqrt(squares.max(initial=0.0)))


def solid_angle(corners: Array) -> float:
    """Of triangles with corners (F, 3, 3) seen from the origin: 4 π inside of a closed surface, 0 outside."""
    a, b, c = corners.transpose(1, 0, 2)
    la, lb, lc = np.sqrt(np.square(corners).dot(_ONES)).T
    above = np.einsum("fi,fi->f", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("fi,fi->f", *pair) for pair in ((a, b), (b, c), (c, a)))
    return 2 * float(np.arctan2(above, la * lb * lc + ab * lc + bc * la + ca * lb).sum())
