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
pairs that do it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.complementarity import NEGLIGIBLE_RESIDUAL, Delassus, Solution, solve
from fenics_rom.mechanics.contact import ContactLaw, ContactResidual, ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.obstacles import Obstacle

_ONES, _ROOT_3 = np.ones(3), np.sqrt(3.0)
PENETRATION_TOLERANCE = 1e-9  # of the size of the body: as deep in an obstacle as round-off may have put a point
WORK_ROUND_OFF = 1e-12  # of force times velocity: work that is no work
_MOST_KEPT = 4  # operators of pairs, of those that were active last


class ContactSolver:
    """Contact of the points of a body with obstacles.

    It keeps the last forces, to begin the next search with, and nothing else of the past.

    Args:
        points: (P, 3) at rest, m.
        obstacles: O of them.
        law: how they meet.

    Attributes:
        last_forces: of all pairs (O P, 3), N, obstacle after obstacle.
        residual: steps whose forces solve the problem but for a residual.
    """

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        self.residual = ContactResidual()
        self.points, self.obstacles, self.law = np.array(points, dtype=float), tuple(obstacles), law
        self.last_forces = np.zeros((len(self.obstacles) * len(self.points), 3))
        self._delassus, self._operators = np.empty((0, 0)), dict[bytes, Delassus]()

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

    def solve(
        self, points: PointMotion, delassus: Array, dt: float, obstacles: ObstacleMotion, quasi_static: bool = False
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

        Raises:
            StepError: no forces found; the next step begins as this one did.
        """
        w = obstacles.velocities(dt)
        distances = self._distances(points.displacement, obstacles.start)
        if self.law.stiffness is None and _out_of_reach(float(distances[0].min()) / dt, points, w):
            return None
        pairs = self._all_pairs(distances, points, dt, obstacles, w, quasi_static)
        chosen = pairs.due(pairs.normal_velocity)
        active = chosen.nonzero()[0]
        if not len(active):
            return None
        iterations, start = 0, self.last_forces
        while True:
            solution, forces, q = self._solve_pairs(pairs, active, delassus, start)
            iterations += solution.iterations
            if len(active) == len(chosen):
                start = forces
            else:
                start = np.zeros_like(pairs.normals)
                start[active] = forces
            by_pair = start.reshape(-1, len(self.points), 3)
            point_forces = by_pair[0] if len(by_pair) == 1 else by_pair.sum(axis=0)
            repeat = pairs.stop_helping_friction(active, forces, solution.velocities, q)
            if len(active) < len(chosen):
                moved = delassus.dot(point_forces.ravel()).reshape(points.free_velocity.shape)
                velocity = self._relative(points.free_velocity + moved, w)
                missed = pairs.due((pairs.normals * velocity).dot(_ONES)) & ~chosen
                if missed.any():
                    chosen |= missed
                    repeat = True
            if not repeat:
                break
            active = chosen.nonzero()[0]
        self.last_forces = start
        if solution.residual > NEGLIGIBLE_RESIDUAL:
            self.residual = ContactResidual(self.residual.steps + 1, max(self.residual.residual, solution.residual))
        normals, rough = pairs.of_active(pairs.normals, active), self.law.friction > 0
        return ContactSolution(point_forces, by_pair.sum(axis=1), iterations, active, normals, forces, w, rough)

    def _all_pairs(
        self,
        distances: tuple[Array, Array],
        points: PointMotion,
        dt: float,
        obstacles: ObstacleMotion,
        w: Array,
        quasi_static: bool,
    ) -> "_Pairs":
        """What the law says of every pair of a point and an obstacle; w (O, 3) velocities of the obstacles, m/s."""
        law, (gaps, normals) = self.law, distances
        free, relative = self._relative(points.free_velocity, w), self._relative(points.velocity, w)
        if w.tobytes() != obstacles.velocities_before.tobytes():  # six times as fast as to compare numbers
            # What keeps touching an obstacle that accelerates has its velocity between the steps, and not yet the mean
            # one of this step. Taken for an approach, the difference would let it sink in further in every step.
            pushed, half_change = self.last_forces.any(axis=1), (w - obstacles.velocities_before) / 2
            relative[pushed] += np.repeat(half_change, len(self.points), axis=0)[pushed]
        approach, compliance = (normals * relative).dot(_ONES), 0.0
        if law.stiffness is not None:
            damper = law.stiffness * dt / 2 + law.damping
            level = target = gaps * (-law.stiffness / damper)
            compliance = 1 / damper
        elif quasi_static:
            level = target = np.maximum(gaps, 0.0) / -dt
        else:
            e = law.restitution
            level, half = gaps / -dt, (1 - e) / 2 * approach
            level, target = np.maximum(level, (level + half) / (2 - e)), np.minimum(half, 0.0)
            if gaps.min() < 0.0:  # no deeper than a step's motion of the obstacle or of the body
                deepest = gaps / dt + np.abs(approach) + np.sqrt((w * w).dot(_ONES)).repeat(len(self.points))
                target = np.maximum(target, -np.maximum(deepest, 0.0))
        sliding = None
        if law.friction > 0 and not quasi_static:  # what sticks is to stop within the step
            sliding = (relative - approach[:, None] * normals) / 2
        return _Pairs(normals, free, (normals * free).dot(_ONES), level, target, compliance, sliding)

    def _solve_pairs(
        self, pairs: "_Pairs", active: Array, delassus: Array, start: Array
    ) -> tuple[Solution, Array, Array]:
        """The solution for the active pairs, passive forces (C, 3), N, and the velocities (C, 3) they stop, m/s."""
        normals = pairs.of_active(pairs.normals, active)
        free = pairs.of_active(pairs.free, active)
        q = free - pairs.of_active(pairs.target, active)[:, None] * normals
        if pairs.tangential_target is not None:
            q -= pairs.of_active(pairs.tangential_target, active)
        operator = self._operator(delassus, active)
        if pairs.compliance:
            operator = Delassus(_compliant(operator.matrix, normals, pairs.compliance))
        solution = solve(operator, q, normals, self.law.friction, pairs.of_active(start, active))
        if solution.residual > NEGLIGIBLE_RESIDUAL:
            return solution, _passive(solution.forces, operator.matrix, free), q
        return solution, solution.forces, q

    def _distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """Gaps (O P,), m, and normals (O P, 3), obstacle after obstacle."""
        x = self.points + displacement
        if len(self.obstacles) == 1:
            return self.obstacles[0].distance(x - offsets)
        distances = [obstacle.distance(x - moved) for obstacle, moved in zip(self.obstacles, offsets, strict=True)]
        return np.concatenate([gap for gap, _ in distances]), np.concatenate([normal for _, normal in distances])

    def _relative(self, velocity: Array, w: Array) -> Array:
        """Velocities of the points (P, 3) relative to each obstacle (O P, 3), m/s."""
        return velocity - w if len(w) == 1 else (velocity - w[:, None]).reshape(-1, 3)

    def _operator(self, delassus: Array, active: Array) -> Delassus:
        """Relative velocities of the active pairs per force of theirs; kept while both stay the same."""
        key = active.tobytes()
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


@dataclass
class _Pairs:
    """What the law says of every pair in one step, obstacle after obstacle; velocities in m/s."""

    normals: Array  # (O P, 3)
    free: Array  # relative mid-step velocity without contact, (O P, 3)
    normal_velocity: Array  # its normal part, (O P,)
    level: Array  # (O P,) normal velocities below which a pair takes part
    target: Array  # c (O P,)
    compliance: float  # of each pair along its normal, m/s/N; 0 for the rigid law
    tangential_target: Array | None  # c_t (O P, 3); None where nothing slides

    def due(self, normal_velocity: Array) -> Array:
        """Pairs that come too close at relative mid-step velocities with these normal parts (O P,)."""
        return normal_velocity < self.level

    def of_active(self, values: Array, active: Array) -> Array:
        """Those of the active pairs (C,); where these are all, nothing needs to be picked."""
        return values if len(active) == len(values) else values[active]

    def stop_helping_friction(self, active: Array, forces: Array, velocities: Array, q: Array) -> bool:
        """Sets c_t = 0 for active pairs whose friction would do work on the body; whether there are any.

        Of these are forces, velocities u = v̂ - w - c n - c_t, and q, the same without contact forces, (C, 3) each.
        """
        if self.tangential_target is None:
            return False
        normals, c_t = self.of_active(self.normals, active), self.of_active(self.tangential_target, active)
        helps = _helping(forces, c_t, normals, velocities, q)
        if helps is None:
            return False
        self.tangential_target[active[helps]] = 0.0
        return True


def _out_of_reach(closing: float, points: PointMotion, w: Array) -> bool:
    """Whether no pair can be due, as not even the smallest gap closes at a speed, m/s, that is reached in the step.

    A pair is due at a normal velocity below -g/h, or below (-g/h + (1 - e)/2 a)/(2 - e): nothing is beyond a bound of
    both, whatever direction things move in.
    """
    fastest = np.abs(w).max()
    return closing > _ROOT_3 * (
        2 * (np.abs(points.free_velocity).max() + fastest) + np.abs(points.velocity).max() + fastest
    )


def _passive(f: Array, W: Array, free: Array) -> Array:
    """Forces that solve the problem but for a residual, made smaller until they do no work on the body."""
    spent, given = float(f.ravel().dot(W.dot(f.ravel()))), float(f.ravel().dot(free.ravel()))
    return f * min(1.0, max(0.0, -given / spent)) if spent > 0 else f


def _compliant(W: Array, normals: Array, compliance: float) -> Array:
    """W with a compliance of each pair along its normal, m/s/N."""
    C = len(normals)
    W = W.copy()
    W.reshape(C, 3, C, 3)[np.arange(C), :, np.arange(C)] += compliance * normals[:, :, None] * normals[:, None, :]
    return W


def _helping(f: Array, c_t: Array, normals: Array, u: Array, q: Array) -> Array | None:
    """Pairs whose friction would do work on the body, or None if it does none as a whole; u = v̂ - w - c n - c_t."""
    with_targets = float(f.ravel().dot(c_t.ravel()))
    if with_targets <= 0:  # with u_t it never does
        return None
    negligible = WORK_ROUND_OFF * float(np.abs(f).max()) * float(np.abs(q).max())
    if with_targets <= negligible:
        return None
    tangential = f - (f * normals).dot(_ONES)[:, None] * normals
    work = (tangential * (u + c_t)).dot(_ONES)
    helps = (work > negligible) & c_t.any(axis=1)  # each but once: where c_t = 0, what is left is round-off
    return helps if work.sum() > negligible and helps.any() else None
