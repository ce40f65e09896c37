"""Contact forces of a step by compiled loops, where numba is; those that these do not find are `ContactSolver`'s."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, jit, or_numpy
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.compiled import contact_law, shapes, springs
from fenics_rom.mechanics.compiled.contact_law import (
    FOUND,
    MOST_ROUNDS,
    NOTHING,
    OTHERWISE,
    Found,
    Law,
    Pairs,
    pairs_from,
)
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.complementarity import Frames
from fenics_rom.mechanics.contact import ContactLaw, ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_look import Look, look_at
from fenics_rom.mechanics.contact_pairs import Decided, Settled, SolvedPairs
from fenics_rom.mechanics.contact_pairs import Pairs as AskedPairs
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.mechanics.points_operator import Operator, PointsOperator, moved_by

Known = Callable[[], tuple[AskedPairs | None, SolvedPairs | None]]
UNKNOWN = in_one_piece(np.empty((0, 0)))  # inverse of an operator
_SWUNG = ContactSearch._fields.index("swung")
NO_OUTWARDS, _NOWHERE = np.empty(0), np.empty((0, 3))
find_forces, ask_springs = jit(contact_law.find_forces), jit(springs.ask_springs)
ask, measure = jit(contact_law.ask), jit(shapes.measure)


def find_near_forces(law: Law, W: PointsOperator, P: int, swung: Array, pairs: Pairs) -> Found:
    """As `find_forces`, of points alone that take part: the operator of all is never made as a whole."""
    at, sweeps = np.arange(len(pairs.chosen)) % P, 0
    is_near = np.zeros(P, dtype=bool)
    for _ in range(MOST_ROUNDS):
        is_near[at[pairs.chosen]] = True
        near = is_near[at]
        if not near.any():
            return Found(NOTHING, 0, 0.0)
        few, some = Pairs(*(each[near] for each in pairs)), is_near.nonzero()[0]
        found = find_forces(law, in_plain(W.among(some)), UNKNOWN, len(some), swung[near], few)
        sweeps += found.sweeps
        if found.status != FOUND:
            return found._replace(sweeps=sweeps)
        pairs.forces[:] = 0.0
        pairs.forces[near], pairs.chosen[near] = few.forces, few.chosen
        moved = moved_by(W, pairs.forces.reshape(-1, P, 3).sum(axis=0)).reshape(-1, 3)
        outwards = pairs.free[:, 0] + (pairs.axes[:, 0] * moved[at]).sum(axis=1)
        missed = (outwards < pairs.level) & ~near
        if not missed.any():
            pairs.target[near], pairs.helped[near] = few.target, few.helped
            return found._replace(sweeps=sweeps)
        pairs.chosen[missed] = True
    return Found(OTHERWISE, sweeps, 0.0)


def keep_decided(pairs: Pairs, decided: Decided, some: Array | slice) -> None:
    """Has the law ask of pairs (n,), some of all, what sweeps before have decided."""
    pairs.chosen[:] |= decided.chosen[some]
    braked = decided.braking
    if braked is not None and braked.helped is not None:
        pairs.helped[:] = braked.helped[some]
        pairs.target[:, 1:] *= 2 * braked.slopes[some, None]


class Told(NamedTuple):
    """What compiled loops found in a step."""

    law: Law
    pairs: Pairs
    gaps: Array  # (N,), m
    forces: Array  # on the points (P, 3), N
    sweeps: int
    normal_power: float | None  # W
    swung: Array | None  # of the steps before

    def solution(self, w: Array, seen: Look | None) -> ContactSolution:
        """The same as of any search; w: velocities of the obstacles (O, 3), m/s; `seen` of what turns."""
        active, pairs = self.active, self.pairs
        found = active, pairs.axes[active, 0], pairs.forces[active]
        told = self.forces, self.sweeps, *found, w[:, :3], self.normal_power
        return ContactSolution(*told, surface_velocities=None if seen is None else seen.surface(active))

    @property
    def touches(self) -> bool:
        """Whether a pair took part."""
        return bool(self.pairs.chosen.any())

    @property
    def active(self) -> Array:
        """Pairs (C,) that took part."""
        active: Array = self.pairs.chosen.nonzero()[0]
        return active

    @property
    def braking(self) -> braking.Braking | None:
        """What friction was asked to stop; None where nothing slides."""
        if self.law.friction == 0 or self.law.is_at_rest:
            return None
        asked = braking.Braking(np.ascontiguousarray(self.pairs.target[:, 1:].T), self.swung)
        if self.pairs.helped.any():
            asked.know(self.pairs.helped, np.ascontiguousarray(self.pairs.relative[:, 1:].T) / 2)
        return asked

    def known(
        self,
        solver: "CompiledContact",
        begins: Array,
        points: Callable[[], PointMotion],
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
    ) -> Known:
        """Tells what the law asked, and how forces were found.

        `begins` are forces (N, 3), N, with which that began; `points` tells, if someone asks, what the points do;
        delassus, dt and obstacles are as in `ContactSolver.solve`.
        """
        chosen = self.pairs.chosen

        def known() -> tuple[AskedPairs, SolvedPairs | None]:
            pairs, active = self.asked(), self.active
            if not self.touches:
                return pairs, None
            _, operator = solver.operator_of(delassus, chosen, chosen.tobytes())
            problem = pairs.problem(active, operator, begins, False)
            (f,) = problem.frames.turned(self.pairs.forces.take(active, axis=0))
            found = pairs, self.gaps, active, problem, f, problem.operator.moved(f) + problem.q, False
            moved, pushed = points(), ContactSearch(begins).pushed
            look = solver.seen(moved.displacement, obstacles, dt)
            return pairs, SolvedPairs(moved, obstacles, look, pushed, delassus, dt, self.law.is_at_rest, *found)

        return known

    def asked(self) -> AskedPairs:
        """What the law said of all pairs."""
        pairs = self.pairs
        free, relative = (np.ascontiguousarray(each.T) for each in (pairs.free, pairs.relative))
        frames = Frames(np.ascontiguousarray(pairs.axes[:, 0]))
        target = np.ascontiguousarray(pairs.target[:, 0])
        return AskedPairs(frames, free, relative, pairs.level, target, self.law.compliance, self.braking)


class CompiledContact(ContactSolver):
    """Of obstacles whose shapes are compiled. Arguments and attributes as in ContactSolver.

    Attributes:
        shapes: rows of the obstacles, see `shape_rows`.
    """

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw, shapes: Array):
        super().__init__(points, obstacles, law)
        self.shapes = shapes
        self._nothing_swung = np.zeros(len(self.points) * len(shapes), dtype=np.int64)
        self._seen: Look | None = None  # in the last step, where an obstacle turns
        self._in_steps: tuple[tuple[ContactLaw, float, bool], Law] | None = None

    def law_in_steps(self, dt: float, quasi_static: bool = False) -> Law:
        """The law in steps of dt, s, as numbers."""
        asked = self.law, dt, quasi_static
        if self._in_steps is None or self._in_steps[0] != asked:
            radius = min((obstacle.core[0] for obstacle in self.obstacles), default=np.inf)
            self._in_steps = asked, Law.of(*asked, radius)
        return self._in_steps[1]

    def swung(self, search: ContactSearch) -> Array:
        """In how many steps in a row friction did not stop pairs, (N,)."""
        return self._nothing_swung if search.swung is None else search.swung

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
        start = self._begin(points)
        told = self._find(points, delassus, dt, obstacles, quasi_static, start.forces, settled)
        if told is not None:
            if settled is not None:
                settled.keep(told.pairs.chosen, told.pairs.free[:, 0], told.braking)
            known = told.known(self, start.forces, lambda: points, delassus, dt, obstacles)
            return self.keep(told, known, obstacles.velocities(dt), self._seen)
        return super().solve(points, delassus, dt, obstacles, quasi_static, settled, is_patient)

    def seen(self, displacement: Array, obstacles: ObstacleMotion, dt: float) -> Look | None:
        """Of points that have moved by (P, 3), m, in a step of dt, s; None where nothing turns."""
        return look_at(self._distances, self.points, displacement, obstacles, dt) if obstacles.turns else None

    def keep(self, told: Told, known: Known, w: Array, seen: Look | None) -> ContactSolution | None:
        """Contact of a step that compiled loops found; the next search begins with it. None where nothing touches.

        Args:
            told: what they found.
            known: tells of it, if someone asks, as `last_step`.
            w, seen: as in `Told.solution`.
        """
        asked = told.braking
        self.note(known, told.touches, told.pairs.forces, None if asked is None else asked.swung)
        return told.solution(w, seen) if told.touches else None

    def note(self, known: Known, touches: bool, forces: Array, swung: Array | None) -> None:
        """Takes note of a step that compiled loops found, with which the next search begins.

        Args:
            known: as in `keep`.
            touches: whether a pair took part.
            forces: of the pairs (N, 3), N.
            swung: (N,) in how many steps in a row friction did not stop them; None: it stopped all.
        """
        self._told, self.follows, self._touches = known, False, touches
        if touches:
            kept = self.search  # `_replace` by names takes twice as long, in every step
            self.search = ContactSearch._make((forces, *kept[1:_SWUNG], swung, *kept[_SWUNG + 1 :]))
        else:
            self._touch_nothing()

    @or_numpy
    def _find(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        start: Array,
        settled: Settled | None,
    ) -> Told | None:
        """Forces of a step; None where loops did not find them. start: (N, 3) to begin with, N."""
        if self.keeps_out:
            return None
        law, pairs, begun = self.law_in_steps(dt, quasi_static), pairs_from(start, self.law.friction), self._begun[1]
        P, free, velocity = len(self.points), *map(np.ascontiguousarray, (points.free_velocity, points.velocity))
        self._seen = None
        if obstacles.turns:
            self._seen = gaps, _, pairs.axes[:, 0], w, turning = self._looked_at(points.displacement, obstacles, dt)
            assert turning is not None
            beside = Beside(w, turning.now, turning.first)
        else:
            gaps, beside = np.empty(len(start)), Beside(obstacles.velocities(dt), obstacles.velocities_before, _NOWHERE)
            measure(self.shapes, obstacles.start, self.points + points.displacement, gaps, pairs.axes[:, 0])
        outwards = NO_OUTWARDS if settled is None else np.ascontiguousarray(settled.outwards(NO_OUTWARDS))
        ask(law, gaps, free, velocity, beside, begun.forces_before, outwards, pairs, np.inf)
        if law.compliance:
            ask_springs(law, gaps, np.inf, pairs)
        swung, decided = begun.swung, None if settled is None else settled.decided()
        if decided is not None:
            keep_decided(pairs, decided, slice(None))
            if decided.braking is not None:
                swung = decided.braking.swung_before
        swings = self._nothing_swung if swung is None else swung
        if isinstance(delassus, np.ndarray):
            found = find_forces(law, np.ascontiguousarray(delassus), UNKNOWN, P, swings, pairs)
        else:
            found = find_near_forces(law, delassus, P, swings, pairs)
        if found.status == OTHERWISE:
            return None
        forces = pairs.forces if len(self.shapes) == 1 else pairs.forces.reshape(-1, P, 3).sum(axis=0)
        power = found.normal_power if law.friction > 0 else None
        return Told(law, pairs, gaps, forces, found.sweeps, power, swung)
