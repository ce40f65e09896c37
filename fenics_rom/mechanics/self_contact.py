"""Contact of a body with itself, beside that with obstacles: a point meets the triangle of its surface that it faces.

To `contact_solver` the body's own surface is one more obstacle, which stands still. What is other is S: a row of a pair
is that of its point less those of the corners of the triangle, by their weights in the nearest place. It moves as the
two do relative to one another, and its force acts on both. Gaps, normals and weights are those of the start of a step.
The place turns with the triangle, so that also no couple is left where friction acts over a gap: with the foot F of the
point x, corners at x_k with the weights w_k, and d_k from their middle, J as in `surface_points`,

    s = v̂ - Σ w_k v̂_k - ω × (x - F),    ω = J⁻¹ Σ d_k × v̂_k/3.

A body in a frame says where its points are in the middle of the step: so its momenta stay to round-off.
"""

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.complementarity.delassus import Delassus
from fenics_rom.mechanics.contact import ContactLaw, ContactSolution, ObstacleMotion, Opposite, PointMotion
from fenics_rom.mechanics.contact_look import SAME_SIDE, Look
from fenics_rom.mechanics.contact_pairs import Asked, Pairs, Settled, SolvedPairs, kept_out
from fenics_rom.mechanics.contact_solver import PENETRATION_TOLERANCE
from fenics_rom.mechanics.mesh_contact import MeshContact
from fenics_rom.mechanics.obstacle_outline import FLAT
from fenics_rom.mechanics.obstacle_poses import NO_TURN, distance_from
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.mechanics.own_surface import OwnSurface, corner_maps
from fenics_rom.mechanics.points_operator import Operator, moved_by
from fenics_rom.mechanics.surface_pairs import OnSurface, unit_normals

NO_DERIVATIVE = (
    "effects.contact.self_contact: a step in which points were held where they would go through the body has no "
    "derivative: use those in which they go by less than a quarter of its wall; a smaller dt is the cure"
)
MOST_CROSSINGS = 12  # times that ways of points are looked at in a step, or a sweep of one
_ONES = np.ones(3)


class _Crossing(NamedTuple):
    """What points (k,) meet that would go through a triangle in the step."""

    row: Array  # (k,) of the points
    nodes: Array  # (k, 3) corners of the triangles
    weights: Array  # (k, 3) of these
    normals: Array  # (k, 3) of the triangles there and then
    gaps: Array  # (k,) m, of what goes on as fast as they would

    def beside(self, found: OnSurface) -> OnSurface:
        """With what other points face."""
        others = ~np.isin(found.row, self.row)
        parts = zip(found, (self.row, self.nodes, self.weights, found.places[:0], self.normals, self.gaps), strict=True)
        return OnSurface(*(np.concatenate([one[others], other]) for one, other in parts))

    def anew(self, other: "_Crossing", ends: Array) -> "_Crossing":
        """With others, where points are at ends (n, 3), m.

        What met a triangle, and now goes through one beside it, is kept away from the first by as much more.
        """
        _, mine, its = np.intersect1d(self.row, other.row, return_indices=True)
        alike = (self.normals[mine] * other.normals[its]).dot(_ONES) > SAME_SIDE
        corners, gaps = ends[other.nodes[its]], self.gaps.copy()
        depth = ((corners[:, 0] - ends[other.row[its]]) * unit_normals(corners)).dot(_ONES)
        gaps[mine[alike]] -= np.maximum(depth, 0.0)[alike]
        own, others = np.delete(np.arange(len(gaps)), mine[~alike]), np.delete(np.arange(len(other.row)), its[alike])
        both = zip(self._replace(gaps=gaps), other, strict=True)
        return _Crossing(*(np.concatenate([one[own], of[others]]) for one, of in both))


class _Itself:
    """The surface of a body as what its own points meet.

    Args:
        surface: of the body.
        points: how many contact points it has, P.

    Attributes:
        margin: from how near on they meet, m.
        crossing: points that are to meet the triangles that they would go through; None: there are none.
        row: of the points that do, (k,).
        opposite: what each of these meets.
    """

    is_convex: ClassVar = True
    outline: ClassVar = FLAT
    crossing: "_Crossing | None"

    def __init__(self, surface: OwnSurface, points: int):
        self.surface, self.margin, self.crossing = surface, 0.0, None
        self._gaps, self._normals = np.full(points, np.inf), np.tile([1.0, 0.0, 0.0], (points, 1))

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Gaps (P,), m, infinite of points that meet nothing, and normals (P, 3), where the points are at (P, 3), m."""
        found = self.surface.near(points, self.margin)
        if self.crossing is not None:
            found = self.crossing.beside(found)
        self.row, self.opposite = found.row, Opposite(found.nodes, found.weights)
        gaps, normals = self._gaps.copy(), self._normals.copy()
        gaps[found.row], normals[found.row] = found.gaps, found.normals
        return gaps, normals

    def curvature(self, points: Array) -> Array:
        """As of an Obstacle; nobody asks for it: `own_adjoint` knows how normals turn."""
        return np.zeros((len(points), 3, 3))

    @property
    def extent(self) -> float:
        """As of an Obstacle."""
        return np.inf

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Obstacle: what is deeper is soon taken to have passed; no ball that would go through points."""
        return self.surface.deepest / 4, np.empty((0, 3))


class SelfContact(MeshContact):
    """Of a body that may touch itself. Arguments as in ContactSolver.

    Args:
        surface: of the body, that touches itself.

    Attributes:
        surface: as given.
    """

    _last: tuple[Any, Any, Callable[[], tuple[Any, ...]]]  # what the last step began with, and tells what it was given

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw, surface: OwnSurface):
        self.surface, self._itself, self._O, P = surface, _Itself(surface, len(points)), len(obstacles), len(points)
        super().__init__(points, (*obstacles, self._itself), law)
        self._own = slice(self._O * P, (self._O + 1) * P)
        self._has_touched, self._is_held = False, True
        self._middle, self._maps = np.empty((0, 3)), np.empty((0, 3, 3, 3))
        self._mapped: tuple[Opposite, Array] | None = None  # of which these maps are
        self._pairs_operator: tuple[Operator, Array, bytes, tuple[Array, Delassus]] | None = None

    def gaps(self, displacement: Array, offsets: Array) -> Array:
        """As in ContactSolver: from obstacles; infinite without these."""
        placed = self.points + displacement
        known = zip(self._given[: self._O], offsets, strict=True)
        of_each = [distance_from(obstacle, placed, row)[0] for obstacle, row in known]
        return np.min([np.full(len(placed), np.inf), *of_each], axis=0)

    def check_start(self, displacement: Array, offsets: Array, names: Sequence[str]) -> None:
        """As in ContactSolver; and that the body is not through itself."""
        self._itself.margin, size = 0.0, float(np.ptp(self.points, axis=0).max())
        places = self.points + displacement
        gaps, _ = self._itself.distance(places)
        deepest = int(gaps.argmin())
        if gaps[deepest] < -PENETRATION_TOLERANCE * size:
            there = self._itself.opposite.nodes[self._itself.row == deepest][0, 0]
            first, second = (self.surface.names[point] for point in (deepest, there))
            raise StepError(
                f"contact: use a start where no surface is inside another one of the body, but {first!r} is "
                f"{-gaps[deepest]:.3g} m inside {second!r} at {places[deepest].tolist()}"
            )
        if self._O:
            super().check_start(displacement, np.concatenate([offsets, _resting(offsets)]), names)

    def within_reach(self, points: PointMotion, dt: float, obstacles: ObstacleMotion) -> Array:
        """As in ContactSolver, with what these points may touch of the body."""
        self._look(points, dt)
        self._itself.crossing = None
        near = super().within_reach(points, dt, obstacles) if self._O else np.empty(0, dtype=int)
        gaps, _ = self._itself.distance(self.points + points.displacement)
        carriers = self._itself.opposite.nodes.ravel()
        return np.unique(np.concatenate([near, np.isfinite(gaps).nonzero()[0], carriers]))

    def solve(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        settled: Settled | None = None,
        is_patient: bool = True,
    ) -> ContactSolution | None:
        """As in ContactSolver."""
        self._last = self.search, self._begun, lambda: (points, delassus, dt, obstacles, quasi_static)
        planes = self._planes if settled is not None and settled is self._settled else None
        self._look_around(points, dt, settled)
        if planes is not None:  # which points met in sweeps before
            self._planes = planes
            self._renew(self._own, *self._itself.distance(self.points + points.displacement))
        self.search = self.search._replace(laws=())  # no step is followed, as S is another in each
        of_step = beside(obstacles), quasi_static, settled, is_patient
        begun = self.search
        contact = super().solve(points, delassus, dt, *of_step)
        for _ in range(MOST_CROSSINGS):
            if not self._add_crossings(points, delassus, dt, contact):
                break
            self._renew(self._own, *self._itself.distance(self.points + points.displacement))
            self.search = begun
            contact = super().solve(points, delassus, dt, *of_step)
        if self._itself.crossing is not None and self.search.held.steps == begun.held.steps:
            share = self._itself.core[0] / self._goes(points.free_velocity, dt)
            self.search = self.search._replace(held=begun.held.with_step(min(share, 1.0) * dt))
        return self._told_of(contact)

    @staticmethod
    def _goes(velocity: Array, dt: float) -> float:
        """How far points with velocities (P, 3), m/s, go relative to one another in a step at most, m."""
        return 2 * dt * _fastest(velocity - velocity.mean(axis=0))

    def _add_crossings(
        self, points: PointMotion, delassus: Operator, dt: float, contact: ContactSolution | None
    ) -> bool:
        """Has points that would go through triangles under such forces meet these; whether there are any."""
        velocity = points.free_velocity
        if contact is not None:
            velocity = velocity + moved_by(delassus, contact.forces).reshape(velocity.shape)
        places, goes, little = self.points + points.displacement, self._goes(velocity, dt), self._itself.core[0]
        if goes <= little or self.surface.margin(places, (dt * velocity,), goes) <= little:
            return False  # what turns so little meets what it faces
        found = self.surface.crossings(places, dt * velocity)
        nodes = self.surface.triangles[found.triangle]
        maps = self._maps_of_crossing(found.row, nodes, found.weights)
        relative = velocity[found.row] - np.einsum("kcij,kcj->ki", maps, velocity[nodes])
        gaps = -found.times * dt * (relative * found.normals).dot(_ONES)
        crossing, known = _Crossing(found.row, nodes, found.weights, found.normals, gaps), self._itself.crossing
        if known is not None:
            ends = places + dt * velocity
            crossing = known.anew(crossing, ends)
        self._itself.crossing = crossing
        return len(found.row) > 0

    def _told_of(self, contact: ContactSolution | None) -> ContactSolution | None:
        """Contact of a step, as it is told."""
        self._has_touched = contact is not None
        self.clear = 0.0  # nobody knows how far what turns may go before it meets itself
        if contact is None:
            return None
        return contact._replace(
            obstacle_velocities=contact.obstacle_velocities[: self._O], opposite=self._opposite(contact.pairs)
        )

    @property
    def last_step(self) -> Callable[[], tuple[Pairs | None, SolvedPairs | None]]:
        """As in ContactSolver; a step that touched is found once more, with how pairs move with points."""
        if not self._has_touched:
            return super().last_step
        search, begun, tell = self._last

        def known() -> tuple[Pairs | None, SolvedPairs | None]:
            from fenics_rom.mechanics.own_adjoint import OwnPairs, PairRows  # here, as few are differentiated

            given = tell()
            points, again = given[0], copy(self)
            again.search, again._begun = search, begun
            SelfContact.solve(again, *given)
            if again._itself.crossing is not None:
                raise StepError(NO_DERIVATIVE)
            pairs, solved = super(SelfContact, again).last_step()
            if solved is None:
                return pairs, None
            of_each, (nodes, maps) = again._own_rows(solved.active), again._moved_by(solved.active)
            within = (of_each >= 0).nonzero()[0]
            own = OwnPairs.of(self.surface, of_each[within], self.points + points.displacement, points.middle)
            return pairs, solved._replace(rows=PairRows(nodes, maps, own, within, self._O))

        return known

    def _asked(self, look: Look, obstacles: ObstacleMotion, dt: float, quasi_static: bool) -> Asked:
        """As in ContactSolver; what would go through a triangle does not go farther."""
        asked, crossing = super()._asked(look, obstacles, dt, quasi_static), self._itself.crossing
        if crossing is None or self.law.stiffness is not None:
            return asked
        others = np.ones(len(look.gaps), dtype=bool)
        others[self._own.start + crossing.row] = False
        return partial(kept_out, asked, look.gaps, dt, others)

    def depth_inside(self, points: PointMotion, velocity: Array, dt: float, obstacles: ObstacleMotion) -> float:
        """As in ContactSolver."""
        gaps, normals = self._itself.distance(self.points + points.displacement)
        goes = dt * (normals * self._of_pairs(velocity)[self._own]).dot(_ONES)
        depth = -(gaps + goes)
        deepest = float(depth[(goes < 0) & (depth > self._itself.core[0])].max(initial=0.0))
        return max(deepest, super().depth_inside(points, velocity, dt, obstacles))

    def _look_around(self, points: PointMotion, dt: float, settled: Settled | None) -> None:
        """Begins a step, or a sweep: where pairs are looked for, and where points are in its middle."""
        margin = self._itself.margin
        self._look(points, dt)
        if settled is not None and settled is self._settled:  # what takes part stays so
            self._itself.margin = max(self._itself.margin, margin)
        else:
            self._itself.crossing = None
        self._planes = None
        self._is_held = points.middle is None
        self._middle = self.points + points.displacement if points.middle is None else points.middle

    def _look(self, points: PointMotion, dt: float) -> None:
        """Pairs are looked for as far as what is near goes to one another in a step of dt, s, twice as fast."""
        ways = 8 * dt * points.free_velocity, 2 * dt * points.velocity
        most = 2 * sum(_fastest(way - way.mean(axis=0)) for way in ways)
        self._itself.margin = self.surface.margin(self.points + points.displacement, ways, most)
        self.reach = self._itself.margin / 2

    def _reach(self, points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
        """As in ContactSolver; of the body itself pairs are none but those that may be due."""
        return max(super()._reach(points, obstacles, dt), self._itself.margin)

    def _opposite(self, pairs: Array) -> Opposite:
        """What pairs (C,) meet of the body."""
        own, parts = self._own_rows(pairs), self._itself.opposite
        nodes, weights = np.zeros((len(pairs), 3), dtype=int), np.zeros((len(pairs), 3))
        nodes[own >= 0], weights[own >= 0] = (part[own[own >= 0]] for part in parts)
        return Opposite(nodes, weights)

    def _turning(self) -> Array:
        """By what corners of triangles move the places that points touch, (k, 3 corners, 3, 3)."""
        opposite = self._itself.opposite
        if self._mapped is None or self._mapped[0] is not opposite or self._mapped[1] is not self._middle:
            self._mapped = opposite, self._middle
            self._maps = self._corner_maps(opposite)
            if self._itself.crossing is not None:
                crosses = np.isin(self._itself.row, self._itself.crossing.row).nonzero()[0]
                of_these = self._itself.row[crosses], opposite.nodes[crosses], opposite.weights[crosses]
                self._maps[crosses] = self._maps_of_crossing(*of_these)
        return self._maps

    def _maps_of_crossing(self, row: Array, nodes: Array, weights: Array) -> Array:
        """The same of points (k,) with places on triangles (k, 3) that they go through.

        Where these are in the middle of the step matters to momenta alone, which supports take.
        """
        if self._is_held:
            return np.asarray(weights[:, :, None, None] * np.eye(3))
        return corner_maps(self._middle[row], self._middle[nodes], weights)

    def _corner_maps(self, opposite: Opposite) -> Array:
        """The same of what points meet."""
        return corner_maps(self._middle[self._itself.row], self._middle[opposite.nodes], opposite.weights)

    def _of_pairs(self, values: Array) -> Array:
        """As in ContactSolver."""
        pairs = np.tile(values, (len(self.obstacles), 1))
        there = np.einsum("kcij,kcj->ki", self._turning(), values[self._itself.opposite.nodes])
        pairs[self._own.start + self._itself.row] -= there
        return pairs

    def _at_points(self, forces: Array) -> Array:
        """As in ContactSolver."""
        together: Array = forces.reshape(len(self.obstacles), -1, 3).sum(axis=0)
        own = forces[self._own.start + self._itself.row]
        if own.any():
            borne = np.einsum("kcij,ki->kcj", self._turning(), own)
            np.subtract.at(together, self._itself.opposite.nodes, borne)
        return together

    def operator_of(self, delassus: Operator, chosen: Array, key: bytes) -> tuple[Array, Delassus]:
        """As in ContactSolver."""
        if not chosen[self._own].any():
            return super().operator_of(delassus, chosen, key)
        known, maps = self._pairs_operator, self._turning()
        if known is None or known[0] is not delassus or known[1] is not maps or known[2] != key:
            active = chosen.nonzero()[0]
            found = active, Delassus(self._between(delassus, active))
            self._pairs_operator = known = delassus, maps, key, found
        return known[3]

    def _moved_by(self, pairs: Array) -> tuple[Array, Array]:
        """As in MeshContact: with its point, and with three that carry what it meets."""
        own, C = self._own_rows(pairs), len(pairs)
        within = (own >= 0).nonzero()[0]
        own = own[within]
        nodes, maps = np.repeat(pairs[:, None] % len(self.points), 4, axis=1), np.zeros((C, 4, 3, 3))
        maps[:, 0] = np.eye(3)
        nodes[within, 1:], maps[within, 1:] = self._itself.opposite.nodes[own], -self._turning()[own]
        return nodes, maps

    def _own_rows(self, pairs: Array) -> Array:
        """Which of the pairs of the body with itself pairs (C,) are, (C,); -1 of those with obstacles."""
        known = np.full(len(self.points), -1)
        known[self._itself.row] = np.arange(len(self._itself.row))
        return np.where(pairs // len(self.points) == self._O, known[pairs % len(self.points)], -1)


def beside(obstacles: ObstacleMotion) -> ObstacleMotion:
    """How obstacles move, and the body itself, which is one that stands still."""
    rests, before = _resting(obstacles.start), obstacles.velocities_before
    start = np.concatenate([obstacles.start, rests])
    end = start if obstacles.end is obstacles.start else np.concatenate([obstacles.end, rests])
    return ObstacleMotion(start, end, np.concatenate([before, np.zeros((1, before.shape[1]))]))


def _resting(rows: Array) -> Array:
    """What of these rows of obstacles is that of one that stays where it is, (1, any)."""
    return np.concatenate([np.zeros(3), NO_TURN])[None, : rows.shape[1]]


def _fastest(velocities: Array) -> float:
    """Largest of some velocities (P, 3)."""
    return float(np.sqrt(np.square(velocities).dot(_ONES).max(initial=0.0)))
