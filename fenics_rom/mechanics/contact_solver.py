"""Unilateral contact with friction inside one step of passive midpoint integration (PMI).

PMI finds the mid-step velocity from A v̂ = b + Sᵀ f, A = 2/h M + D + h/2 K; then x⁺ = x + h v̂ and v⁺ = 2 v̂ - v. For
the points that can touch, whose displacement is S x, that is v̂ = free + W f with the free velocity S A⁻¹ b and the
Delassus operator W = S A⁻¹ Sᵀ, and the forces f do the work h Σ f·v̂ in the step. A pair of a point and an obstacle has
a gap g and a normal n at the start of the step; with w the obstacle's velocity, a = n·(v - w) and s = n·(v̂ - w) the law
is (Moreau's, taken at the midpoint)

    0 <= λ ⟂ s - c >= 0,    c = (1 - e)/2 min(a, 0)                 of what leaves again,
                            c = min(a/2, (a/2 - g/h)/2, 0)          of what does not,

so that an impact ends with n·(v⁺ - w) = -e a exactly, and relative to the obstacle the work h λ c <= 0 is done: contact
never adds energy, and none is lost for e = 1. What does not leave ends on the surface, at rest, in two steps that press
it: all there is with e = 0, and with 0 < e < 1 what would be back within the step, n·(free - w) < (1 + e) a. A pair
takes part if without it the body would come closer than it needs to be stopped by the next step, whether it leaves or
not: g + h s + h/2 min(2 s - a, 0) < 0. So an impact with e > 0 is up to 1 + e/2 times a step's motion before the
surface, and what is pressed back while it leaves has room to be stopped. In steps of one length nothing enters an
obstacle that moves at a constant speed, but a point that moves freely and is thrown back within one step: by at most
half of its motion. What keeps touching an obstacle that accelerates has its a against the obstacle's velocity then.
What is deeper than the way of a step, h (|a| + |n·(free - w)| + |w|), has c = 0. What would end deeper than the largest
ball that the obstacle holds has c = min(-g/h, 0): it ends before it, and leaves as fast as it came (`HeldBack`).

Friction is Coulomb's, with s_t = v̂_t - w_t - c_t and c_t = (v_t - w_t)/2: what sticks has v_t⁺ = w_t. Where friction
as a whole would do work on the body, having turned its motion round within the step, c_t = 0 takes its place for the
pairs that do it, and a share of c_t for those that have swung so for some steps (`braking`); for all of them where no
forces make it stop, as where a point is wedged between two obstacles.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.braking import Braking
from fenics_rom.mechanics.complementarity import NEGLIGIBLE_RESIDUAL, Delassus, Frames, solve
from fenics_rom.mechanics.complementarity.solution import ADVICE, advice_of, largest
from fenics_rom.mechanics.contact import ContactLaw, ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_look import Look, look_at, relative_velocities
from fenics_rom.mechanics.contact_pairs import Asked, NormalRule, Pairs, Settled, SolvedPairs, kept_out, passive_forces
from fenics_rom.mechanics.contact_search import ContactSearch, TangentPlanes, near_points
from fenics_rom.mechanics.followed_contact import Followed, LawToFollow, PairsMotion, follow_contact
from fenics_rom.mechanics.obstacle_poses import distances_from
from fenics_rom.mechanics.obstacles import Obstacle
from fenics_rom.mechanics.points_operator import Operator, moved_by, operator_of
from fenics_rom.mechanics.reach import reach_of

_ONES = np.ones(3)
PENETRATION_TOLERANCE = 1e-9  # of the size of the body: as deep in an obstacle as round-off may have put a point
LastStep = Callable[[], tuple[Pairs | None, SolvedPairs | None]]  # see `ContactSolver.last_step`
_MOST_KEPT = 4  # operators of pairs, of those that were active last


class ContactSolver:
    """Contact of the points of a body with obstacles.

    Args:
        points: (P, 3) at rest, m.
        obstacles: O of them.
        law: how they meet.

    Attributes:
        search: all that it keeps of the past, to begin the next search with.
        follows: whether the last step took no search.
        clear: the smallest gap at the start of the last step, m, if that was out of reach; else 0.
        speeds: velocities of obstacles at all pairs (O P, 3) in the last step, m/s; None where none turns.
    """

    keeps_out = False  # whether no point goes on through a plane that the step before did not foresee
    speeds: Array | None = None
    _own = slice(0, 0)  # of all pairs those of the body with itself, where it touches itself
    _considered: Pairs | None = None
    _solved: SolvedPairs | None = None

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        self.points, self.obstacles, self.law = np.array(points, dtype=float), tuple(obstacles), law
        self.search, self._touches, self.follows, self.clear = self.first_search, True, False, 0.0
        self._delassus: Operator = np.empty((0, 0))
        self._operators = dict[bytes, tuple[Array, Delassus]]()
        self._rule: NormalRule | None = None
        self._offsets, self._placed = np.empty((0, 3)), list[Array]()  # the points at rest, less these
        self._told: LastStep | None = None  # of it, if it took no search
        self._begun = b"", self.search  # velocities at its start, and what was kept of the past then

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
                f"contact: use a start outside of all obstacles, but {-gaps[deepest]:.3g} m inside "
                f"{names[obstacle]!r} is the point at {(self.points[point] + displacement[point]).tolist()}"
            )

    def depth_inside(self, points: PointMotion, velocity: Array, dt: float, obstacles: ObstacleMotion) -> float:
        """How deep, m, what points that go with (P, 3) have to do with goes through the body itself; 0: none does."""
        return 0.0

    def within_reach(self, points: PointMotion, dt: float, obstacles: ObstacleMotion) -> Array:
        """Points that may need contact forces in a step as of `solve`: see `near_points`."""
        gaps = self.gaps(points.displacement, obstacles.start)
        return near_points(gaps, self._reach(points, obstacles, dt), self.search.forces)

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
        """Contact forces of one step; None where nothing touches.

        Args:
            points: what the contact points do, and would do without contact.
            delassus: W (3P, 3P) mid-step velocities per force, m/s/N, symmetric, positive semidefinite; not to be
                changed in place: parts of it are kept as long as the same one is given.
            dt: step size h, s.
            obstacles: how they move.
            quasi_static: without impacts: a gap may close within the step but not beyond, s >= -max(g, 0)/h, and what
                sticks does not move.
            settled: of the step, where it is solved in sweeps; this one adds to it.
            is_patient: whether to go on where Newton's method finds no forces, which can take a hundred times as long.

        Raises:
            StepError: no forces found; the next step begins as this one did.
        """
        search = self._begin(points)
        was_steady = search.is_steady
        look = self._looked_at(points.displacement, obstacles, dt)
        gaps, normals = look.gaps, look.normals
        asked = self._asked(look, obstacles, dt, quasi_static)
        is_tried, slides = False, self.law.friction > 0 and not quasi_static
        if search.laws and settled is None:
            is_tried = True
            known = free, relative = self._relative(points, obstacles, look)
            motion = PairsMotion.of(search.frames_along(normals), free, relative, asked, slides)
            of_delassus = partial(self.operator_of, delassus), partial(self._moved, delassus)
            chosen, beside = motion.outwards < motion.asked.level, search
            while self.rule(dt, quasi_static).too_far is None and (law := LawToFollow.of(beside, chosen)) is not None:
                followed = follow_contact(self.law, law, motion, *of_delassus)
                if followed is None:
                    break
                if followed.missed is None:
                    self.search, step = beside, (delassus, dt, obstacles, quasi_static, look)
                    return self.keep_followed(followed, motion.frames, lambda: (points, *known), *step)
                chosen, beside = chosen | followed.missed, beside.beside(law.key, followed.solution.kept)
        if not self._touches and look.gap > self._reach(points, obstacles, dt):  # else it hardly pays to ask
            self.pass_by()
            self.clear = look.gap
            return None
        pairs = self._all_pairs(*self._relative(points, obstacles, look), normals, asked, slides, settled)
        self._considered, chosen = pairs, pairs.free[0] < pairs.level
        if settled is not None:
            settled.take_part(chosen, pairs)
        key = chosen.tobytes()
        self._touches = b"\x01" in key
        if not self._touches:
            self._touch_nothing()
            if settled is not None:
                settled.keep(chosen, pairs.free[0], pairs.braking)
            return None
        iterations, are_kept = 0, pairs.frames is search.frames
        while True:
            active, operator = self.operator_of(delassus, chosen, key)
            problem = pairs.problem(active, operator, search.forces, are_kept)
            try:
                of_pairs = problem.operator, problem.q, self.law.friction, problem.start
                solution = solve(*of_pairs, search.law_of(key), not is_tried, was_steady, is_patient)
            except StepError as error:
                if is_patient and pairs.stop_asking_friction(active):
                    continue
                advice = advice_of(operator.matrix, self._wedges(active))
                raise StepError(str(error).replace(ADVICE, advice)) from error
            is_loose = solution.residual > NEGLIGIBLE_RESIDUAL
            if is_loose and self._wedges(active) and pairs.stop_asking_friction(active):
                continue
            forces, velocities, iterations = solution.forces, solution.velocities, iterations + solution.iterations
            if is_loose:
                forces, velocities = passive_forces(forces, problem)
            pair_forces = problem.frames.in_space(forces)
            start = pair_forces
            if len(active) < len(chosen):
                start = np.zeros(normals.shape)
                start[active] = pair_forces
            laws, held = search.with_law(key, solution.kept), self._begun[1].held
            search = ContactSearch(start, search.residual, laws, pairs.frames, held=held)
            point_forces = self._at_points(start)
            missed = None
            if len(active) < len(chosen):
                moved = self._of_pairs(moved_by(delassus, point_forces).reshape(-1, 3))
                missed = ((normals * moved).dot(_ONES) + pairs.free[0] < pairs.level) > chosen
            if missed is not None and largest(missed):
                chosen |= missed
                pairs.ask_friction_anew()
            elif not pairs.asks_less(active, forces, velocities, problem, self.law.friction):
                break
            is_tried = False  # others than those that did not do what they did
            key = chosen.tobytes()
        if settled is not None:
            settled.keep(chosen, pairs.free[0], pairs.braking)
        if is_loose:
            search = search._replace(residual=search.residual.with_step(solution.residual))
        if (far := self.rule(dt, quasi_static).too_far) is not None and (most := float(far[active].max())) > 1:
            search = search._replace(held=search.held.with_step(dt / most))
        found = pairs, gaps, active, problem, forces, velocities, is_loose
        if pairs.braking is not None:
            search = search._replace(swung=pairs.braking.swung)
        self._solved = SolvedPairs(points, obstacles, look, self._begun[1].pushed, delassus, dt, quasi_static, *found)
        self.search = search
        power = None
        if self.law.friction:
            closing = velocities[0] + problem.target
            power = float(forces[0].dot(closing - pairs.compliance * forces[0] if pairs.compliance else closing))
        normals, w = normals.take(active, axis=0), obstacles.velocities(dt)[:, :3]
        found_so = active, normals, pair_forces, w, power, None, look.surface(active)
        return ContactSolution(point_forces, iterations, *found_so)

    def _begin(self, points: PointMotion) -> ContactSearch:
        """Forgets the last step; what the search of this one begins with."""
        self._forget()
        if (speeds := points.velocity.tobytes()) != self._begun[0]:  # else it is asked again in the same step
            self._begun = speeds, self.search
        return self.search

    def _forget(self) -> None:
        """Forgets the last step."""
        self._considered, self._solved, self._told, self.follows, self.clear = None, None, None, False, 0.0

    def pass_by(self) -> None:
        """Takes note of a step out of reach of all obstacles."""
        self._forget()
        self._touch_nothing()

    def _touch_nothing(self) -> None:
        """Takes note of a step in which nothing swings."""
        if self.search.swung is not None:
            self.search = self.search._replace(swung=None)

    def keep_followed(
        self,
        found: Followed,
        frames: Frames,
        told: Callable[[], tuple[PointMotion, Array, Array]],
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        look: Look | None = None,
        planes: TangentPlanes | None = None,
    ) -> ContactSolution:
        """Contact of a step in which all pairs did what they did in the step before; the next search begins with it.

        Args:
            found: what they did.
            frames: of all.
            told: tells, if someone asks, what the points do, and what `_relative` says of that.
            delassus, dt, obstacles, quasi_static: as in `solve`.
            look: of the step; None: at what does not turn.
            planes: those of round obstacles that points have not left.
        """
        key, active, operator, solution, forces, power, are_framed, _ = found
        search, law, pushed = self.search, self.law, self._begun[1].pushed
        stays = frames is search.frames and (search.planes is None or planes is not None)
        unturned = search.unturned + 1 if stays else 0
        kept = search.residual, search.with_law(key, solution.kept), frames, True, unturned, planes
        self.search = ContactSearch(forces, *kept, held=search.held)

        def known() -> tuple[Pairs, SolvedPairs]:
            points, free, relative = told()
            seen = self._looked_at(points.displacement, obstacles, dt) if look is None else look
            asked = self._asked(seen, obstacles, dt, quasi_static)
            pairs = self._all_pairs(free, relative, frames.normals, asked, law.friction > 0 and not quasi_static)
            problem = pairs.problem(active, operator, forces, False)
            own, (f, u) = frames.of(active), solution[:2]
            if not are_framed:
                f, u = own.turned(own.from_lasting_axes(f), own.from_lasting_axes(u))
            found_so = pairs, seen.gaps, active, problem, f, u, False
            return pairs, SolvedPairs(points, obstacles, seen, pushed, delassus, dt, quasi_static, *found_so)

        self._told, self.follows = known, True
        among, normals, w = forces, frames.normals, obstacles.velocities(dt)[:, :3]
        if len(active) < len(forces):
            among, normals = forces.take(active, axis=0), normals.take(active, axis=0)
        surface = None if look is None else look.surface(active)
        return ContactSolution(self._at_points(forces), 0, active, normals, among, w, power, None, surface)

    @property
    def last_step(self) -> LastStep:
        """Tells, also when other steps followed, what the law asked, where a pair could be due, and what was found."""
        if self._told is not None:
            return self._told
        known = self._considered, self._solved
        return lambda: known

    def _looked_at(self, displacement: Array, obstacles: ObstacleMotion, dt: float) -> Look:
        """What the law looks at, of points that have moved by (P, 3), m."""
        look = look_at(self._distances, self.points, displacement, obstacles, dt)
        self.speeds = None if look.turning is None else look.w
        return look

    def _relative(self, points: PointMotion, obstacles: ObstacleMotion, look: Look) -> tuple[Array, Array]:
        """Velocities of all pairs (O P, 3), m/s, in the middle of the step without contact, and at its start."""
        of_pairs = self._of_pairs(points.free_velocity), self._of_pairs(points.velocity)
        return relative_velocities(*of_pairs, look, obstacles, self._begun[1])

    def _all_pairs(
        self, free: Array, relative: Array, normals: Array, asked: Asked, slides: bool, settled: Settled | None = None
    ) -> Pairs:
        """What the law says of every pair of a point and an obstacle.

        Args:
            free, relative: as `_relative` gives them.
            normals: (O P, 3).
            asked: the normal law.
            slides: whether what sticks is to stop within the step.
            settled: as in `solve`.
        """
        frames = self.search.frames_along(normals)
        free, relative = frames.turned(free, relative)
        outwards = free[0] if settled is None else settled.outwards(free[0])
        braking = Braking(relative[1:] / 2, self._begun[1].swung) if slides else None
        return Pairs(frames, free, relative, *asked(relative[0], outwards), braking)

    def _asked(self, look: Look, obstacles: ObstacleMotion, dt: float, quasi_static: bool) -> Asked:
        """The normal law of a step, of all pairs."""
        w = None if obstacles.end is obstacles.start else look.w
        asked = partial(self.rule(dt, quasi_static).asks, look.gaps, look.gap, w)
        keeps_out = self.law.stiffness is None and (self.keeps_out or look.turning is not None)
        return partial(kept_out, asked, look.gaps, dt, self._own) if keeps_out else asked

    def rule(self, dt: float, quasi_static: bool = False) -> NormalRule:
        """The normal law in steps of dt, s."""
        if self._rule is None or self._rule.key != (self.law, dt, quasi_static):
            pairs, radii = len(self.obstacles) * len(self.points), [obstacle.core[0] for obstacle in self.obstacles]
            self._rule = NormalRule(self.law, pairs, dt, quasi_static, radii)
        return self._rule

    def _distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """Gaps (O P,), m, and normals (O P, 3), obstacle after obstacle."""
        if offsets is not self._offsets:
            self._offsets, self._placed = offsets, [self.points - moved for moved in offsets[:, :3]]
        if offsets.shape[1] > 3:
            return distances_from(self.obstacles, self.points + displacement, offsets)
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

    def _moved(self, delassus: Operator, forces: Array) -> Array:
        """Velocities of all pairs (O P, 3), m/s, that forces of all pairs cause."""
        return self._of_pairs(moved_by(delassus, self._at_points(forces)).reshape(-1, 3))

    def _at_points(self, forces: Array) -> Array:
        """Forces of all pairs (O P, 3) together on the points (P, 3)."""
        return forces if len(self.obstacles) == 1 else forces.reshape(-1, len(self.points), 3).sum(axis=0)

    def operator_of(self, delassus: Operator, chosen: Array, key: bytes) -> tuple[Array, Delassus]:
        """The active pairs, and their relative velocities per force; kept as long as both stay the same."""
        if delassus is not self._delassus:
            self._delassus, self._operators = delassus, {}
        if key not in self._operators:
            P, active = len(self.points), chosen.nonzero()[0]
            are_all = len(active) == P and len(self.obstacles) == 1
            part = delassus if are_all and isinstance(delassus, np.ndarray) else operator_of(delassus, active % P)
            self._operators = dict(list(self._operators.items())[1 - _MOST_KEPT :]) | {key: (active, Delassus(part))}
        return self._operators[key]

    def _reach(self, points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
        """The largest gap, m, with which a pair of the rigid law can be due in a step of dt, s."""
        return reach_of(points, self.points, obstacles, dt)
