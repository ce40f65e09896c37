"""Unilateral contact with friction inside one step of passive midpoint integration (PMI).

PMI finds the mid-step velocity from A v̂ = b + Sᵀ f, A = 2/h M + D + h/2 K; then x⁺ = x + h v̂ and v⁺ = 2 v̂ - v. For
the points that can touch, whose displacement is S x, that is v̂ = free + W f with the free velocity S A⁻¹ b and the
Delassus operator W = S A⁻¹ Sᵀ, and the forces f do the work h Σ f·v̂ in the step. A pair of a point and an obstacle has
a gap g and a normal n at the start of the step; with w the obstacle's velocity, a = n·(v - w) and s = n·(v̂ - w) the law
is (Moreau's, taken at the midpoint)

    0 <= λ ⟂ s - c >= 0,    c = (1 - e)/2 min(a, 0),

so that an impact ends with n·(v⁺ - w) = -e a exactly, and relative to the obstacle the work h λ c <= 0 is done: contact
never adds energy, and none is lost for e = 1. A pair takes part if without it the body would come closer than it needs
to be stopped by the next step: g + h s + h (1 - e)/2 min(2 s - a, 0) < 0. So the body stops up to one step's motion
before the surface. In steps of one length it does not enter an obstacle that moves at a constant speed, but where a
point that leaves is thrown back within one step: then by at most (1 - e)/2 of a step's motion. What keeps touching an
obstacle that accelerates has its a against the obstacle's velocity at that moment, and c is made so small that nothing
gets deeper inside than a step's motion.

Friction is Coulomb's, with s_t = v̂_t - w_t - c_t and c_t = (v_t - w_t)/2: what sticks has v_t⁺ = w_t. Where friction
as a whole would do work on the body, having turned its motion round within the step, c_t = 0 takes its place for the
pairs that do it; for all of them where no forces make it stop, as where a point is wedged between two obstacles.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.complementarity import NEGLIGIBLE_RESIDUAL, Delassus, Frames, solve
from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.mechanics.contact import ContactLaw, ContactSearch, ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_pairs import Pairs, SolvedPairs, normal_law, passive_forces
from fenics_rom.mechanics.obstacles import Obstacle

_ONES, _ROOT_3 = np.ones(3), math.sqrt(3.0)
PENETRATION_TOLERANCE = 1e-9  # of the size of the body: as deep in an obstacle as round-off may have put a point
_MOST_KEPT = 4  # operators of pairs, of those that were active last


class ContactSolver:
    """Contact of the points of a body with obstacles.

    Args:
        points: (P, 3) at rest, m.
        obstacles: O of them.
        law: how they meet.

    Attributes:
        search: all that it keeps of the past, to begin the next search with.
        considered: what the law asked of all pairs in the last step; None where none could be due.
        solved: how its forces were found; None where nothing touched. Those who differentiate ask for both.
    """

    considered: Pairs | None = None
    solved: SolvedPairs | None = None

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        self.points, self.obstacles, self.law = np.array(points, dtype=float), tuple(obstacles), law
        self.search = self.first_search
        self._touches = True
        self._delassus, self._operators = np.empty((0, 0)), dict[bytes, Delassus]()
        self._frames: tuple[bytes, Frames] | None = None
        self._offsets, self._placed = np.empty((0, 3)), list[Array]()  # the points at rest, less these

    @property
    def first_search(self) -> ContactSearch:
        """Begins with no forces."""
        return ContactSearch(np.zeros((len(self.obstacles) * len(self.points), 3)))

    def gaps(self, displacement: Array, offsets: Array) -> Array:
        """Smallest gap of each point (P,), m, that has moved by (P, 3), m, from obstacles that have by (O, 3), m."""
        return self._distances(displacement, offsets)[0].reshape(len(self.obstacles), -1).min(axis=0)

    def check_start(self, displacement: Array, offsets: Array, names: Sequence[str]) -> None:
        """Checks that no point is inside an obstacle, of these names, by more than 1e-9 of the size of the body.

        Raises:
            StepError: one is; it says where, and how deep. Arguments as in `gaps`.
        """
        gaps = self._distances(displacement, offsets)[0]
        size = float(max(np.ptp(self.points, axis=0).max(), np.abs(self.points).max()))
        deepest = int(gaps.argmin())
        if gaps[deepest] < -PENETRATION_TOLERANCE * size:
            obstacle, point = divmod(deepest, len(self.points))
            raise StepError(
                f"contact: allowed is a start outside of all obstacles, but {-gaps[deepest]:.3g} m inside "
                f"{names[obstacle]!r} is the point at {(self.points[point] + displacement[point]).tolist()}"
            )

    def within_reach(self, points: PointMotion, dt: float, obstacles: ObstacleMotion) -> Array:
        """Those points that may need contact forces in a step, or twice as fast; none where no point does.

        Arguments as in `solve`.
        """
        gaps = self.gaps(points.displacement, obstacles.start)
        if self.law.stiffness is not None:
            return np.arange(len(gaps))
        reach = _reach(points, obstacles, dt)
        return np.flatnonzero(gaps <= 2 * reach) if gaps.min() <= reach else np.empty(0, dtype=int)

    def solve(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        settled: "Settled | None" = None,
    ) -> ContactSolution | None:
        """Contact forces of one step; None where nothing touches.

        Args:
            points: what the contact points do, and would do without contact.
            delassus: W (3P, 3P) mid-step velocities per force, m/s/N, symmetric, positive semidefinite; not to be
                changed in place: parts of it are kept as long as the same array is given.
            dt: step size h, s.
            obstacles: how they move.
            quasi_static: without impacts: a gap may close within the step but not beyond, s >= -max(g, 0)/h, and what
                sticks does not move.
            settled: of the step, where it is solved in sweeps; this one adds to it.

        Raises:
            StepError: no forces found; the next step begins as this one did.
        """
        self.considered, self.solved, w = None, None, obstacles.velocities(dt)
        gaps, normals = self._distances(points.displacement, obstacles.start)
        gap = gaps.item(gaps.argmin())
        is_near = self._touches or self.law.stiffness is not None  # where the last step touched, it hardly pays to ask
        if not is_near and out_of_reach(gap, points, obstacles, dt):
            return None
        pairs = self._all_pairs(gaps, gap, normals, points, dt, obstacles, w, quasi_static)
        self.considered = pairs
        chosen = pairs.free[0] < pairs.level
        if settled is not None:
            settled.take_part(chosen, pairs)
        active = chosen.nonzero()[0]
        self._touches = len(active) > 0
        if not self._touches:
            return None
        iterations, search = 0, self.search
        while True:
            key = active.tobytes()
            problem = pairs.problem(active, self._operator(delassus, active, key), search.forces)
            kept = search.kept if search.pairs == key else None
            try:
                solution = solve(problem.operator, problem.q, self.law.friction, problem.start, kept)
            except StepError as error:
                if pairs.stop_asking_friction(active):
                    continue
                told = "; a point is wedged between obstacles, where friction may leave none"
                raise StepError(f"{error}{told if self._wedges(active) else ''}") from error
            is_loose = solution.residual > NEGLIGIBLE_RESIDUAL
            if is_loose and self._wedges(active) and pairs.stop_asking_friction(active):
                continue
            iterations += solution.iterations
            forces, velocities = solution.forces, solution.velocities
            if is_loose:
                forces, velocities = passive_forces(forces, problem)
            pair_forces = problem.frames.in_space(forces)
            start = pair_forces
            if len(active) < len(chosen):
                start = np.zeros(normals.shape)
                start[active] = pair_forces
            search = ContactSearch(start, search.residual, key, solution.kept)
            point_forces = self._at_points(start)
            repeat = pairs.stop_helping_friction(active, forces, velocities, problem)
            if len(active) < len(chosen):
                moved = self._of_pairs(delassus.dot(point_forces.ravel()).reshape(-1, 3))
                missed = ((normals * moved).dot(_ONES) + pairs.free[0] < pairs.level) > chosen
                if largest(missed):
                    chosen |= missed
                    repeat = True
            if not repeat:
                break
            active = chosen.nonzero()[0]
        if settled is not None:
            settled.keep(chosen, pairs)
        if is_loose:
            search = search._replace(residual=search.residual.with_step(solution.residual))
        found = pairs, gaps, active, problem, forces, velocities, is_loose
        self.search, self.solved = search, SolvedPairs(points, obstacles.start, delassus, dt, quasi_static, *found)
        power = None
        if self.law.friction:
            power = float(forces[0].dot(velocities[0] + problem.target - pairs.compliance * forces[0]))
        return ContactSolution(point_forces, iterations, active, _of(normals, active), pair_forces, w, power)

    def _all_pairs(
        self,
        gaps: Array,
        gap: float,
        normals: Array,
        points: PointMotion,
        dt: float,
        obstacles: ObstacleMotion,
        w: Array,
        quasi_static: bool,
    ) -> Pairs:
        """What the law says of every pair of a point and an obstacle.

        Args:
            gaps, normals: (O P,), m, and (O P, 3).
            gap: the smallest, m.
            points, dt, obstacles, quasi_static: as in `solve`.
            w: (O, 3) velocities of the obstacles, m/s.
        """
        law, key = self.law, normals.tobytes()
        free, relative = self._of_pairs(points.free_velocity), self._of_pairs(points.velocity)
        if obstacles.end is not obstacles.start:
            motion = self._of_obstacles(w)
            free, relative = free - motion, relative - motion
        if w.tobytes() != obstacles.velocities_before.tobytes():  # six times as fast as to compare numbers
            # What keeps touching an obstacle that accelerates has its velocity between the steps, and not yet the mean
            # one of this step. Taken for an approach, the difference would let it sink in further in every step.
            pushed = self.search.forces.any(axis=1)
            relative = relative + pushed[:, None] * self._of_obstacles((w - obstacles.velocities_before) / 2)
        if self._frames is None or self._frames[0] != key:
            self._frames = key, Frames(normals)
        frames = self._frames[1]
        free, relative = frames.turned(free, relative)
        level, target, compliance = normal_law(law, gaps, gap, relative[0], w, dt, quasi_static)
        slides = law.friction > 0 and not quasi_static  # what sticks is to stop within the step
        return Pairs(frames, free, relative, level, target, compliance, relative[1:] / 2 if slides else None)

    def _distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """Gaps (O P,), m, and normals (O P, 3), obstacle after obstacle."""
        if offsets is not self._offsets:
            self._offsets, self._placed = offsets, [self.points - moved for moved in offsets]
        if len(self.obstacles) == 1:
            return self.obstacles[0].distance(self._placed[0] + displacement)
        placed = zip(self.obstacles, self._placed, strict=True)
        distances = [obstacle.distance(points + displacement) for obstacle, points in placed]
        return np.concatenate([gap for gap, _ in distances]), np.concatenate([normal for _, normal in distances])

    def _wedges(self, active: Array) -> bool:
        """Whether some point takes part with several obstacles."""
        return len(np.unique(active % len(self.points))) < len(active)

    def _of_pairs(self, values: Array) -> Array:
        """Values of the points (P, 3), of each pair (O P, 3)."""
        return values if len(self.obstacles) == 1 else np.tile(values, (len(self.obstacles), 1))

    def _of_obstacles(self, values: Array) -> Array:
        """Values of the obstacles (O, 3), of each pair (O P, 3)."""
        return values.repeat(len(self.points), axis=0)

    def _at_points(self, forces: Array) -> Array:
        """Forces of all pairs (O P, 3) together on the points (P, 3)."""
        return forces if len(self.obstacles) == 1 else forces.reshape(-1, len(self.points), 3).sum(axis=0)

    def _operator(self, delassus: Array, active: Array, key: bytes) -> Delassus:
        """Relative velocities of the active pairs per force of theirs; kept while both, known by key, stay the same."""
        if delassus is not self._delassus:
            self._delassus, self._operators = delassus, {}
        if key not in self._operators:
            P = len(self.points)
            if len(active) == P and len(self.obstacles) == 1:
                part = delassus
            else:
                rows = (3 * (active % P)[:, None] + np.arange(3)).ravel()
                part = delassus[rows[:, None], rows]
            self._operators = dict(list(self._operators.items())[1 - _MOST_KEPT :]) | {key: Delassus(part)}
        return self._operators[key]


class Settled:
    """What sweeps of one step decided: what takes part, or may not be stopped, stays so, or they never end."""

    def __init__(self) -> None:
        self._chosen: Array | None = None  # (O P,)
        self._sliding: Array | None = None  # c_t (2, O P)

    def take_part(self, chosen: Array, pairs: Pairs) -> None:
        """Adds pairs that took part before, with the c_t that they had."""
        if self._chosen is not None:
            chosen |= self._chosen
            pairs.sliding = self._sliding

    def keep(self, chosen: Array, pairs: Pairs) -> None:
        """Takes note of a sweep."""
        self._chosen, self._sliding = chosen, pairs.sliding


def out_of_reach(gap: float, points: PointMotion, obstacles: ObstacleMotion, dt: float) -> bool:
    """Whether in a step of dt, s, no pair of the rigid law can be due, if the smallest gap is this, m."""
    return gap > _reach(points, obstacles, dt)


def _reach(points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
    """The largest gap, m, with which a pair of the rigid law can be due in a step of dt, s.

    A pair is due at a normal velocity below -g/h, or below (-g/h + (1 - e)/2 a)/(2 - e): nothing is that closes less
    than a bound of both, whatever direction things move in.
    """
    w = max(np.abs(obstacles.velocities(dt)).max(), np.abs(obstacles.velocities_before).max())
    fastest = 2 * np.abs(points.free_velocity).max() + np.abs(points.velocity).max() + 3 * w
    return float(dt * _ROOT_3 * fastest)


def _of(values: Array, active: Array) -> Array:
    """Those of the active pairs (C,); where these are all, nothing needs to be picked."""
    return values if len(active) == len(values) else values.take(active, axis=0)
