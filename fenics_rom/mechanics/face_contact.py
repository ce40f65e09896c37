"""Contact of obstacles with the faces of a body: beside its contact points, what sticks out of obstacles meets these.

To `contact_solver` the faces are one more obstacle for each that there is, and move with it. A pair's row of S is that
of its place, by weights of the contact points that carry it, and its force acts on these (`body_faces`). As a face
turns and slides along what it touches, its gap g is no linear function of where its corners x_i are. So forces are
found with the rows of the start of the step; then with those that the motion has that these lead to, until it stays.
With normals n and weights w of the middle of the step, and ways Δ_i of the corners less their mean, the row

    w_i n + q_i,    q_i = (g⁺ - g - Σ w_k n·Δx_k) Δ_i / Σ |Δ_k|²

has Σ rows·Δx = g⁺ - g exactly (a discrete gradient, Gonzalez 2000). So no gap drifts, and contact adds no energy.
Faces that corners come to in the step are added.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.body_faces import DEEPEST, BodyFaces, Places
from fenics_rom.mechanics.complementarity.delassus import Delassus, operator_among, operator_between
from fenics_rom.mechanics.contact import Carriers, ContactLaw, ContactSolution, ObstacleMotion, PointMotion, moved_by
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_search import FaceSlots
from fenics_rom.mechanics.contact_solver import PENETRATION_TOLERANCE
from fenics_rom.mechanics.mesh_contact import MeshContact
from fenics_rom.mechanics.obstacle_outline import FLAT
from fenics_rom.mechanics.obstacles import Obstacle

NO_DERIVATIVE = (
    "effects.contact.points = 'faces': steps that touch have no derivative: allowed are those where nothing touches, "
    "or contact points alone"
)
MOST_SWEEPS = 12
ROUND_OFF = 1e-13  # of the size of a triangle: as well a gap at the end of a step is foreseen
MOST_BENT = 0.1  # what a row may have beside weights: more is of corners that go past an edge
_ONES, _FIRST = np.ones(3), np.array([1.0, 0.0, 0.0])


class _Faces:
    """The faces of a body as what one obstacle meets.

    Attributes:
        gaps, normals: of P pairs, (P,), m, infinite of those that are none, and (P, 3).
    """

    is_convex: ClassVar = True
    outline: ClassVar = FLAT
    extent: ClassVar = np.inf

    def __init__(self, points: int):
        self.gaps, self.normals = np.full(points, np.inf), np.tile([1.0, 0.0, 0.0], (points, 1))

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Gaps and normals, wherever points are."""
        return self.gaps, self.normals

    def curvature(self, points: Array) -> Array:
        """As of an Obstacle."""
        raise StepError(NO_DERIVATIVE)

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Obstacle: no ball that would go through points."""
        return np.inf, np.empty((0, 3))


class _Between(NamedTuple):
    """Pairs (k,) that are at faces."""

    pair: Array  # (k,) their numbers
    nodes: Array  # (k, 3) that carry them
    weights: Array  # (k, 3) of these
    maps: Array  # (k, 3, 3, 3) what the velocity of each adds to the pair's


class FaceContact(MeshContact):
    """Of a body whose faces obstacles meet. Arguments as in ContactSolver.

    Args:
        faces: of the body.
    """

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw, faces: BodyFaces):
        self._faces, self._O, P = faces, len(obstacles), len(points)
        self._met = [_Faces(P) for _ in obstacles]
        super().__init__(points, (*obstacles, *self._met), law)
        self._at_faces = slice(self._O * P, 2 * self._O * P)
        self.keeps_out = law.stiffness is None  # no gap of a face ends below 0, whatever it turned by
        self._nearest = np.inf  # gap of the points that were looked at last, m
        self._pairs_operator: tuple[Array, _Between, bytes, tuple[Array, Delassus]] | None = None
        self._slots = FaceSlots(np.full((self._O, P), -1), np.zeros((self._O, P, 3)))
        self._put([self._none] * self._O)

    @property
    def _none(self) -> Places:
        return self._faces.at(self.points, FLAT, np.empty(0, dtype=int))

    def gaps(self, displacement: Array, offsets: Array) -> Array:
        """As in ContactSolver: of the points alone."""
        seen = zip(self._given[: self._O], self._seen(displacement, offsets), strict=True)
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
                    f"contact: allowed is a start outside of all obstacles, but {name!r} is {-places.gaps[0]:.3g} m "
                    f"inside a face of the body at {(places.at[0] + offset).tolist()}"
                )
        self._put([self._none] * self._O)
        super().check_start(displacement, np.concatenate([offsets, offsets]), [*names, *names])

    def within_reach(self, points: PointMotion, dt: float, obstacles: ObstacleMotion) -> Array:
        """As in ContactSolver, with what carries places that may be touched."""
        margin = 2 * self._reach(points, obstacles, dt)
        found = self.near(points.displacement, obstacles.start, margin)
        carriers = [places.nodes.ravel() for places in found]
        return np.unique(np.concatenate([super().within_reach(points, dt, obstacles), *carriers]))

    def solve(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        settled: Settled | None = None,
        is_patient: bool = True,
    ) -> ContactSolution | None:
        """As in ContactSolver."""
        starts = self._seen(points.displacement, obstacles.start)
        reach = self._reach(points, obstacles, dt)
        found = self._places(starts, 2 * reach)
        if self._nearest > reach + self._faces.reach:
            self.pass_by()
            self.clear = self._nearest - self._faces.reach
            return None
        self._put(found)
        both = np.tile(np.arange(self._O), 2)
        motion = ObstacleMotion(*(part.take(both, axis=0) for part in obstacles))
        if obstacles.end is obstacles.start:
            motion = motion._replace(end=motion.start)
        w, iterations = obstacles.velocities(dt), 0
        for _ in range(MOST_SWEEPS):
            self.search = self.search._replace(laws=(), slots=self._slots)  # no step is followed: S is another in each
            self._planes = None  # of other faces
            of_step = dt, motion, quasi_static, settled, is_patient
            contact = super().solve(points, delassus, *of_step)
            self.search, self.clear = self.search._replace(slots=self._slots), 0.0
            velocity = points.free_velocity
            if contact is not None:
                velocity = velocity + moved_by(delassus, contact.forces).reshape(velocity.shape)
                iterations += contact.iterations
            ways = [dt * (velocity - of_obstacle) for of_obstacle in w]
            found, are_foreseen = self._look_ahead(starts, ways, found, contact)
            if are_foreseen:
                break
        if contact is None:
            return None
        nodes, weights = self._carried(contact.pairs, _FIRST, self._between.weights)
        nearest = np.take_along_axis(nodes, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
        return contact._replace(
            iterations=iterations,
            pairs=contact.pairs // len(self.points) % self._O * len(self.points) + nearest,
            obstacle_velocities=w,
            carriers=Carriers(nodes, weights),
        )

    def _seen(self, displacement: Array, offsets: Array) -> list[Array]:
        """Where points that have moved by (P, 3) are, as seen from each obstacle that has by (O, 3), m."""
        return [self.points + displacement - offset for offset in offsets]

    def _places(self, seen: list[Array], margin: float) -> list[Places]:
        """Of each obstacle those near faces of points that it sees there, (P, 3), m, lowest gaps first."""
        depth, found, self._nearest = max(DEEPEST * self._faces.size, margin), list[Places](), np.inf
        for obstacle, points in zip(self._given[: self._O], seen, strict=True):
            gaps = obstacle.distance(points)[0]
            self._nearest = min(self._nearest, float(gaps.min()))
            places = self._faces.near(points, gaps, obstacle.outline, margin, depth)
            found.append(places.of(slice(len(self.points))))
        return found

    def _put(self, found: list[Places], bends: list[Array] | None = None) -> None:
        """Takes note of all places; those that go on from the step before stay the same pairs.

        `bends`: q (k, 3, 3) of each; None: 0.
        """
        before, P = self._slots if self.search.slots is None else self.search.slots, len(self.points)
        keys, at, pair, maps = before.keys.copy(), before.at.copy(), list[Array](), list[Array]()
        for k, (met, places) in enumerate(zip(self._met, found, strict=True)):
            slots = _slots_of(places, keys[k], at[k], self._faces.parts)
            keys[k, slots], at[k, slots] = places.keys, places.at
            met.gaps, met.normals = np.full(P, np.inf), met.normals.copy()
            met.gaps[slots], met.normals[slots] = places.gaps, places.normals
            pair.append((self._O + k) * P + slots)
            maps.append(places.weights[:, :, None, None] * np.eye(3))
            if bends is not None:
                maps[-1] = maps[-1] + places.normals[:, None, :, None] * bends[k][:, :, None]
        nodes, weights = (np.concatenate([getattr(of, name) for of in found]) for name in ("nodes", "weights"))
        self._slots = FaceSlots(keys, at)
        self._between = _Between(np.concatenate(pair), nodes, weights, np.concatenate(maps))

    def _look_ahead(
        self, starts: list[Array], ways: list[Array], found: list[Places], contact: ContactSolution | None
    ) -> tuple[list[Places], bool]:
        """Puts places as they are on ways from starts, (P, 3) of each obstacle, m; these, and whether they were so.

        Args:
            starts, ways: see above.
            found: places as they were put before, with gaps at the start.
            contact: with these.
        """
        between, limit, first = self._between, ROUND_OFF * self._faces.size, 0
        pushing = np.zeros(len(between.pair), dtype=bool)
        if contact is not None:
            forces = (contact.pair_forces * contact.normals).dot(_ONES)
            pushing = np.isin(between.pair, contact.pairs[forces > 0])
        ends = [start + way for start, way in zip(starts, ways, strict=True)]
        put, bends, foreseen = list[Places](), list[Array](), True
        for k, (before, after) in enumerate(zip(found, self._places(ends, 0.0), strict=True)):
            outline, rows = self._given[k].outline, slice(first, first + len(before.keys))
            more = np.setdiff1d(after.keys[after.gaps < -limit], before.keys)[: len(self.points) - len(before.keys)]
            if len(more):
                begun = self._faces.at(starts[k], outline, more)
                before = Places(*map(np.concatenate, zip(before, begun.of(begun.gaps >= -limit), strict=True)))
            middle, end = (self._faces.at(starts[k] + share * ways[k], outline, before.keys) for share in (0.5, 1.0))
            way = ways[k][before.nodes]
            across, least = way - way.mean(axis=1, keepdims=True), end.gaps < np.minimum(before.gaps, 0.0)
            size = np.square(across).sum(axis=(1, 2))
            along = (middle.weights * (way * middle.normals[:, None]).dot(_ONES)).sum(axis=1)
            rest = end.gaps - before.gaps - along
            bent = np.abs(rest) <= MOST_BENT * np.sqrt(size)
            was, bent_now = slice(0, rows.stop - rows.start), np.where(bent, rest / np.where(size > 0, size, 1.0), 0.0)
            moved = np.einsum("kcij,kcj->ki", between.maps[rows], way[was])
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
        pairs, between = np.tile(values, (len(self.obstacles), 1)), self._between
        pairs[between.pair] = np.einsum("kcij,kcj->ki", between.maps, values[between.nodes])
        return pairs

    def _at_points(self, forces: Array) -> Array:
        """As in ContactSolver."""
        of_each, between = forces.reshape(len(self.obstacles), -1, 3), self._between
        together: Array = of_each[: self._O].sum(axis=0) + of_each[2 * self._O :].sum(axis=0)
        np.add.at(together, between.nodes, np.einsum("kcij,ki->kcj", between.maps, forces[between.pair]))
        return together

    def operator_of(self, delassus: Array, chosen: Array, key: bytes) -> tuple[Array, Delassus]:
        """As in ContactSolver."""
        if not chosen[self._at_faces].any():
            return super().operator_of(delassus, chosen, key)
        known, between = self._pairs_operator, self._between
        if known is None or known[0] is not delassus or known[1] is not between or known[2] != key:
            active = chosen.nonzero()[0]
            nodes, maps = self._carried(active, _FIRST[:, None, None] * np.eye(3), between.maps)
            moved = operator_between(*operator_among(delassus, nodes), maps)
            self._pairs_operator = known = delassus, between, key, (active, Delassus(moved))
        return known[3]

    def _carried(self, pairs: Array, at_points: Array, at_faces: Array) -> tuple[Array, Array]:
        """Points (C, 3) that carry pairs (C,), and a value of each pair: that of all at points, or of each at faces."""
        nodes, values = np.tile(pairs[:, None] % len(self.points), 3), np.repeat(at_points[None], len(pairs), axis=0)
        _, own, of = np.intersect1d(pairs, self._between.pair, return_indices=True)
        nodes[own], values[own] = self._between.nodes[of], at_faces[of]
        return nodes, values

    def _wedges(self, active: Array) -> bool:
        """As in ContactSolver."""
        return super()._wedges(active) or bool((active >= self._at_faces.start).any())


def _slots_of(places: Places, keys: Array, at: Array, parts: int) -> Array:
    """Slots (k,) of places among P, by what they had before; of one that passes to another face the same.

    Args:
        places: k of them.
        keys, at: what slots had, (P,) and (P, 3).
        parts: of the body, as of BodyFaces.
    """
    slots, free = np.full(len(places.keys), -1), np.ones(len(keys), dtype=bool)
    _, own, known = np.intersect1d(places.keys, keys, return_indices=True)
    slots[own], free[known] = known, False
    for row in (slots < 0).nonzero()[0]:
        among = (free & (keys // parts == places.keys[row] // parts) & (keys >= 0)).nonzero()[0]
        if len(among):
            slot = among[np.square(at[among] - places.at[row]).sum(axis=1).argmin()]
        else:
            slot = np.where(free, keys, keys.max() + 1).argmin()  # one that had none, if there is one
        slots[row], free[slot] = slot, False
    return slots
