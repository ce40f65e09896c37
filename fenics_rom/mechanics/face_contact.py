"""Contact of obstacles with the faces of a body: beside its contact points, what sticks out of obstacles meets these.

To `contact_solver` the faces are one more obstacle for each that there is, and move with it. A pair's row of S is that
of its place, by weights of the contact points that carry it, and its force acts on these (`body_faces`). As a face
turns and slides along what it touches, its gap g is no linear function of where its corners x_i are. So forces are
found with the rows of the start of the step; then with those that the motion has that these lead to, until it stays.
With normals n and weights w of the middle of the step, and ways Δ_i of the corners less their mean, the row

    w_i n + q_i,    q_i = (g⁺ - g - Σ w_k n·Δx_k) Δ_i / Σ |Δ_k|²

has Σ rows·Δx = g⁺ - g exactly (a discrete gradient, Gonzalez 2000). So no gap drifts, and contact adds no energy.
Faces that corners come to in the step are added.

An obstacle that turns has its gaps in its own axes. There corners are at y = Rᵀ(x - p), and go in a step by

    y⁺ - y = Ĝᵀ h (v̂ - w),    Ĝ = (R + R⁺)/2,    w = p̂' + ω̂ × ((x + x⁺)/2 - (p + p⁺)/2)

exactly. So n is turned by Ĝ into the axes of the world, Δ_i = h (v̂_i - w_i), and w is found in the same sweeps.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.body_faces import DEEPEST, BodyFaces, Places
from fenics_rom.mechanics.complementarity.delassus import Delassus
from fenics_rom.mechanics.contact import Carriers, ContactLaw, ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_look import Look, TurningLook
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_search import FaceSlots
from fenics_rom.mechanics.contact_solver import PENETRATION_TOLERANCE
from fenics_rom.mechanics.frame_motion import rotation_matrices
from fenics_rom.mechanics.mesh_contact import MeshContact
from fenics_rom.mechanics.met_faces import MetFaces, slots_of
from fenics_rom.mechanics.obstacle_outline import FLAT
from fenics_rom.mechanics.obstacle_poses import placed, rotated, seen
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.mechanics.own_surface import OwnSurface
from fenics_rom.mechanics.points_operator import Operator, moved_by
from fenics_rom.mechanics.self_contact import SelfContact

MOST_SWEEPS = 12
ROUND_OFF = 1e-13  # of the size of a triangle: as well a gap at the end of a step is foreseen
MOST_BENT = 0.1  # what a row may have beside weights: more is of corners that go past an edge
_ONES, _FIRST = np.ones(3), np.array([1.0, 0.0, 0.0])


class _Between(NamedTuple):
    """Pairs (k,) that are at faces."""

    pair: Array  # (k,) their numbers
    nodes: Array  # (k, 3) that carry them
    weights: Array  # (k, 3) of these
    maps: Array  # (k, 3, 3, 3) what the velocity of each adds to the pair's


class _Ways(NamedTuple):
    """How P points go in a step past O obstacles."""

    starts: list[Array]  # (P, 3) as each obstacle sees them, m
    ends: list[Array]  # the same at the end
    found: Array  # (O, P, 3) relative to what of obstacles is where they are, as forces were found, m
    now: Array  # (O, P, 3) the same with these forces


class FaceContact(MeshContact):
    """Of a body whose faces obstacles meet. Arguments as in ContactSolver.

    Args:
        faces: of the body.
        own: the surface of the body, where it touches itself.
    """

    def __init__(
        self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw, faces: BodyFaces, *own: OwnSurface
    ):
        self._faces, self._solids, P = faces, len(obstacles), len(points)
        self._met = [MetFaces(P) for _ in obstacles]
        self._are_soft = law.stiffness is not None  # also in a step that is taken without springs
        super().__init__(points, (*obstacles, *self._met), law, *own)
        self._at_faces = slice(self._solids * P, 2 * self._solids * P)
        self.keeps_out = True  # no gap of a face ends below 0, whatever it turned by
        self._w = np.zeros((self._solids, P, 3))  # material of obstacles, where points are in mid-step, m/s
        self._last_found: list[Places] | None = None  # in the last sweep
        self._nearest = np.inf  # gap of the points that were looked at last, m
        self._face_operator: tuple[Operator, _Between, bytes, tuple[Array, Delassus]] | None = None
        self._slots = FaceSlots(np.full((self._solids, P), -1), np.zeros((self._solids, P, 3)))
        self._put([self._none] * self._solids)

    @property
    def _none(self) -> Places:
        return self._faces.at(self.points, FLAT, np.empty(0, dtype=int))

    def gaps(self, displacement: Array, offsets: Array) -> Array:
        """As in ContactSolver: of the points alone."""
        seen = zip(self._given[: self._solids], self._seen(displacement, offsets), strict=True)
        gaps: Array = np.min([obstacle.distance(points)[0] for obstacle, points in seen], axis=0)
        return gaps

    def near(self, displacement: Array, offsets: Array, margin: float = 0.0) -> list[Places]:
        """Of each obstacle places at faces with gaps up to a margin, m, lowest first, as seen from it; as in `gaps`."""
        return self._places(self._seen(displacement, offsets), margin)

    def check_start(self, displacement: Array, offsets: Array, names: Sequence[str]) -> None:
        """As in ContactSolver; and that nothing that sticks out of an obstacle is inside a face."""
        size = float(np.ptp(self.points, axis=0).max())
        for name, offset, places in zip(names, offsets, self.near(displacement, offsets), strict=True):
            if len(places.gaps) and places.gaps[0] < -PENETRATION_TOLERANCE * size:
                raise StepError(
                    f"contact: use a start outside of all obstacles, but {name!r} is {-places.gaps[0]:.3g} m "
                    f"inside a face of the body at {placed(places.at[:1], offset)[0].tolist()}"
                )
        self._put([self._none] * self._solids)
        super().check_start(displacement, np.concatenate([offsets, offsets]), [*names, *names])

    def within_reach(self, points: PointMotion, dt: float, obstacles: ObstacleMotion) -> Array:
        """As in ContactSolver, with what carries places that may be touched."""
        margin = 2 * self._due(points, obstacles, dt)
        found = self.near(points.displacement, obstacles.start, margin)
        carriers = [places.nodes.ravel() for places in found]
        return np.unique(np.concatenate([super().within_reach(points, dt, obstacles), *carriers]))

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
        starts = self._seen(points.displacement, obstacles.start)
        places, turns, iterations = self.points + points.displacement, _mean_turns(obstacles), 0
        found = None if settled is None or settled is not self._settled else self._last_found
        if found is None:
            reach = self._due(points, obstacles, dt)
            found = [
                places._replace(normals=rotated(places.normals, row))
                for places, row in zip(self._places(starts, 2 * reach), obstacles.start, strict=True)
            ]
            if self._nearest > reach + self._faces.reach and not self._own.stop:
                self.pass_by()
                self.clear = self._nearest - self._faces.reach
                return None
            self._put(found)
            self._w = _speeds(places + dt / 2 * points.free_velocity, obstacles, dt)
        both = np.tile(np.arange(self._solids), 2)
        motion = ObstacleMotion(*(part.take(both, axis=0) for part in obstacles))
        if obstacles.end is obstacles.start:
            motion = motion._replace(end=motion.start)
        for _ in range(MOST_SWEEPS):
            self.search = self.search._replace(laws=(), slots=self._slots)  # no step is followed: S is another in each
            gaps, normals = zip(*((met.gaps, met.normals) for met in self._met), strict=True)
            self._renew(self._at_faces, np.concatenate(gaps), np.concatenate(normals))
            of_step = dt, motion, quasi_static, settled, is_patient
            contact = super().solve(points, delassus, *of_step)
            self.search, self.clear = self.search._replace(slots=self._slots), 0.0
            velocity = points.free_velocity
            if contact is not None:
                velocity = velocity + moved_by(delassus, contact.forces).reshape(velocity.shape)
                iterations += contact.iterations
            w = _speeds(places + dt / 2 * velocity, obstacles, dt)
            ends = self._seen(points.displacement + dt * velocity, obstacles.end)
            ways = _Ways(starts, ends, dt * (velocity - self._w), dt * (velocity - w))
            found, are_foreseen = self._look_ahead(ways, turns, found, contact)
            if are_foreseen:
                break
            self._w = w
        self._last_found = found
        if contact is None:
            return None
        nodes, weights = self._carriers(contact.pairs)
        nearest = np.take_along_axis(nodes, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        met = np.array([*both, self._solids])[contact.pairs // len(self.points)]  # the last one: of itself
        return contact._replace(
            iterations=iterations,
            pairs=met * len(self.points) + nearest,
            obstacle_velocities=obstacles.velocities(dt)[:, :3],
            carriers=Carriers(nodes, weights),
        )

    def depth_inside(self, points: PointMotion, velocity: Array, dt: float, obstacles: ObstacleMotion) -> float:
        """As in ContactSolver."""
        deepest, found = super().depth_inside(points, velocity, dt, obstacles), self._last_found
        assert found is not None
        for k, ends in enumerate(self._seen(points.displacement + dt * velocity, obstacles.end)):
            before = found[k]
            gaps = self._faces.at(ends, self._given[k].outline, before.keys).gaps
            through = -gaps[(gaps < before.gaps) & (gaps < -self._faces.wall / 2)]
            deepest = max(deepest, float(through.max(initial=0.0)))
        return deepest

    def _looked_at(self, displacement: Array, obstacles: ObstacleMotion, dt: float) -> Look:
        """As in ContactSolver; places at faces go beside what of obstacles is there."""
        look, between = super()._looked_at(displacement, obstacles, dt), self._reached
        if look.turning is None:
            return look
        mean, now = (of[: self._solids] for of in obstacles.velocities_at(self.points + displacement, dt))
        normals, w = look.normals.copy(), look.w.copy()
        normals[self._at_faces] = np.concatenate([met.normals for met in self._met])
        at_start, first = look.turning.now.copy(), look.turning.first.copy()
        first[self._at_faces] = normals[self._at_faces]
        obstacle = between.pair[:, None] // len(self.points) - self._solids
        for of_pairs, of_points in ((w, self._w), (at_start, now)):
            of_pairs[between.pair] = np.einsum("kcij,kcj->ki", between.maps, of_points[obstacle, between.nodes])
        self.speeds = np.concatenate([mean.reshape(-1, 3), np.zeros_like(self.points)])  # and of the body itself
        self._looked = look._replace(normals=normals, w=w, turning=TurningLook(at_start, first))
        return self._looked

    def _seen(self, displacement: Array, offsets: Array) -> list[Array]:
        """Where points that have moved by (P, 3) are, as seen from obstacles that have by (O, 3), m, or are posed."""
        return [seen(self.points + displacement, row) for row in offsets]

    def _places(self, seen: list[Array], margin: float) -> list[Places]:
        """Of each obstacle those near faces of points that it sees there, (P, 3), m, lowest gaps first."""
        depth, found, self._nearest = max(DEEPEST * self._faces.size, margin), list[Places](), np.inf
        deepest = self._faces.size if self._are_soft else 0.0
        for obstacle, points in zip(self._given[: self._solids], seen, strict=True):
            gaps = obstacle.distance(points)[0]
            self._nearest = min(self._nearest, float(gaps.min()))
            places = self._faces.near(points, gaps, obstacle.outline, margin, max(deepest, depth))
            if deepest:
                places = places.of(self._are_springs(places, len(found), depth))
            found.append(places.of(slice(len(self.points))))
        return found

    def _are_springs(self, places: Places, obstacle: int, depth: float) -> Array:
        """Which places (k,) springs may act at, of one obstacle, by its number.

        Of places where a corner is inside only the least deep one counts, so that its gap is continuous as it slides
        from one triangle to another one. What is deeper than a depth, m, has pushed in the step before.
        """
        search, P = self.search, len(self.points)
        pair = slice((self._solids + obstacle) * P, (self._solids + obstacle + 1) * P)
        slots = self._slots if search.slots is None else search.slots
        pushed = slots.keys[obstacle][search.forces[pair].any(axis=1)] // self._faces.parts
        part = places.keys // self._faces.parts
        order = np.lexsort((-places.gaps, part))
        is_first = part >= len(self._given[obstacle].outline.corners)  # edges cross several ones
        is_first[order] |= np.diff(part[order], prepend=-1) > 0
        are: Array = (places.gaps >= 0) | (is_first & ((places.gaps >= -depth) | np.isin(part, pushed)))
        return are

    def _put(self, found: list[Places], bends: list[Array] | None = None) -> None:
        """Takes note of all places; those that go on from the step before stay the same pairs.

        `bends`: q (k, 3, 3) of each; None: 0.
        """
        before, P = self._slots if self.search.slots is None else self.search.slots, len(self.points)
        keys, at, pair, maps = before.keys.copy(), before.at.copy(), list[Array](), list[Array]()
        for k, (met, places) in enumerate(zip(self._met, found, strict=True)):
            slots = slots_of(places, keys[k], at[k], self._faces.parts)
            keys[k, slots], at[k, slots] = places.keys, places.at
            met.gaps, met.normals = np.full(P, np.inf), met.normals.copy()
            met.gaps[slots], met.normals[slots] = places.gaps, places.normals
            pair.append((self._solids + k) * P + slots)
            maps.append(places.weights[:, :, None, None] * np.eye(3))
            if bends is not None:
                maps[-1] = maps[-1] + places.normals[:, None, :, None] * bends[k][:, :, None]
        nodes, weights = (np.concatenate([getattr(of, name) for of in found]) for name in ("nodes", "weights"))
        self._slots = FaceSlots(keys, at)
        self._reached = _Between(np.concatenate(pair), nodes, weights, np.concatenate(maps))

    def _look_ahead(
        self, ways: _Ways, turns: list[Array] | None, found: list[Places], contact: ContactSolution | None
    ) -> tuple[list[Places], bool]:
        """Puts places as they are on ways that points go; these, and whether they were so.

        Args:
            ways: see above.
            turns: Ĝ of each obstacle; None: none turns.
            found: places as they were put before, with gaps at the start.
            contact: with these.
        """
        between, limit, first = self._reached, ROUND_OFF * self._faces.size, 0
        pushing = np.zeros(len(between.pair), dtype=bool)
        if contact is not None:
            forces = (contact.pair_forces * contact.normals).dot(_ONES)
            pushing = np.isin(between.pair, contact.pairs[forces > 0])
        put, bends, foreseen = list[Places](), list[Array](), True
        for k, (before, after) in enumerate(zip(found, self._places(ways.ends, 0.0), strict=True)):
            start, end_there = ways.starts[k], ways.ends[k]
            outline, rows = self._given[k].outline, slice(first, first + len(before.keys))
            more = np.setdiff1d(after.keys[after.gaps < -limit], before.keys)[: len(self.points) - len(before.keys)]
            if len(more):
                begun = self._faces.at(start, outline, more)
                before = Places(*map(np.concatenate, zip(before, begun.of(begun.gaps >= -limit), strict=True)))
            middle = self._faces.at((start + end_there) / 2, outline, before.keys)
            if turns is not None:
                middle = middle._replace(normals=_units(middle.normals.dot(turns[k].T)))
            end, way = self._faces.at(end_there, outline, before.keys), ways.now[k][before.nodes]
            across, least = way - way.mean(axis=1, keepdims=True), end.gaps < np.minimum(before.gaps, 0.0)
            size = np.square(across).sum(axis=(1, 2))
            along = (middle.weights * (way * middle.normals[:, None]).dot(_ONES)).sum(axis=1)
            rest = end.gaps - before.gaps - along
            rest[np.abs(rest) <= limit / 2] = 0.0  # round-off, which is not to bend rows of what hardly moves
            bent = np.abs(rest) <= MOST_BENT * np.sqrt(size)
            was, bent_now = slice(0, rows.stop - rows.start), np.where(bent, rest / np.where(size > 0, size, 1.0), 0.0)
            moved = np.einsum("kcij,kcj->ki", between.maps[rows], ways.found[k][before.nodes[was]])
            left = end.gaps[was] - before.gaps[was] - (moved * before.normals[was]).dot(_ONES)
            is_off = bent[was] & (np.abs(left) > limit) & (pushing[rows] | least[was])
            foreseen &= len(before.keys) == was.stop and not is_off.any()
            put.append(middle._replace(gaps=before.gaps, at=before.at))
            bends.append(bent_now[:, None, None] * across)
            first = rows.stop
        if not foreseen:
            self._put(put, bends)
        return put, foreseen

    def _of_pairs(self, values: Array) -> Array:
        """As in ContactSolver."""
        pairs, between = super()._of_pairs(values), self._reached
        pairs[between.pair] = np.einsum("kcij,kcj->ki", between.maps, values[between.nodes])
        return pairs

    def _at_points(self, forces: Array) -> Array:
        """As in ContactSolver."""
        at_nodes, between = forces.copy(), self._reached
        at_nodes[self._at_faces] = 0.0
        together = super()._at_points(at_nodes)
        np.add.at(together, between.nodes, np.einsum("kcij,ki->kcj", between.maps, forces[between.pair]))
        return together

    def operator_of(self, delassus: Operator, chosen: Array, key: bytes) -> tuple[Array, Delassus]:
        """As in ContactSolver."""
        if not chosen[self._at_faces].any():
            return super().operator_of(delassus, chosen, key)
        known, between = self._face_operator, self._reached
        if known is None or known[0] is not delassus or known[1] is not between or known[2] != key:
            active = chosen.nonzero()[0]
            found = active, Delassus(self._between(delassus, active))
            self._face_operator = known = delassus, between, key, found
        return known[3]

    def _moved_by(self, pairs: Array) -> tuple[Array, Array]:
        """As in MeshContact."""
        few, few_maps = super()._moved_by(pairs)
        nodes = np.tile(few[:, :1], max(3, few.shape[1]))
        maps = np.zeros((*nodes.shape, 3, 3))
        nodes[:, : few.shape[1]], maps[:, : few.shape[1]] = few, few_maps
        _, own, of = np.intersect1d(pairs, self._reached.pair, return_indices=True)
        nodes[own, :3], maps[own] = self._reached.nodes[of], 0.0
        maps[own, :3] = self._reached.maps[of]
        return nodes, maps

    def _carriers(self, pairs: Array) -> tuple[Array, Array]:
        """Points that carry the places of pairs (C,), and weights of these, (C, 3)."""
        nodes, weights = np.tile(pairs[:, None] % len(self.points), 3), np.tile(_FIRST, (len(pairs), 1))
        _, own, of = np.intersect1d(pairs, self._reached.pair, return_indices=True)
        nodes[own], weights[own] = self._reached.nodes[of], self._reached.weights[of]
        return nodes, weights

    def _wedges(self, active: Array) -> bool:
        """As in ContactSolver."""
        return super()._wedges(active) or bool((active >= self._at_faces.start).any())


class FaceAndSelfContact(FaceContact, SelfContact):
    """Of a body whose faces obstacles meet, and that may touch itself at its contact points."""


def _mean_turns(obstacles: ObstacleMotion) -> list[Array] | None:
    """Ĝ (3, 3) of each in a step; None where none turns."""
    if not obstacles.turns:
        return None
    return list((rotation_matrices(obstacles.start[:, 3:]) + rotation_matrices(obstacles.end[:, 3:])) / 2)


def _speeds(middles: Array, obstacles: ObstacleMotion, dt: float) -> Array:
    """w (O, P or 1, 3) of what of obstacles is in some places (P, 3), m, in the middle of a step of dt, s; m/s."""
    twists = obstacles.velocities(dt)[:, None]
    if not obstacles.turns:
        return twists
    arms = middles - (obstacles.start + obstacles.end)[:, None, :3] / 2
    return twists[..., :3] + np.cross(twists[..., 3:], arms)


def _units(vectors: Array) -> Array:
    return vectors / np.sqrt(np.square(vectors).dot(_ONES))[:, None]
