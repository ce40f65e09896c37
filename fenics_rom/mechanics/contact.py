"""Unilateral contact with friction inside one step of passive midpoint integration (PMI).

PMI finds the mid-step velocity from A v̂ = b + Sᵀ f, A = 2/h M + D + h/2 K; then x⁺ = x + h v̂ and v⁺ = 2 v̂ - v. For
the points that can touch, whose displacement is S x, that is v̂ = free + W f with free = S A⁻¹ b and W = S A⁻¹ Sᵀ, and
the forces f do the work h Σ f·v̂ in the step. A pair of a point and an obstacle has a gap g and a normal n at the
start of the step; with w the obstacle's velocity, a = n·(v - w) and s = n·(v̂ - w) the law is (Moreau's, taken at the
midpoint)

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

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.complementarity import NEGLIGIBLE_RESIDUAL, solve
from fenics_rom.mechanics.obstacles import Obstacle

Array = np.ndarray

_ONES = np.ones(3)
_INSIDE = 1e-9  # of the size of the body: as deep in an obstacle as round-off may have put a point
_ROUNDING = 1e-12  # of force times velocity: work that is no work


@dataclass(frozen=True)
class ContactLaw:
    """How a body meets obstacles.

    Args:
        restitution: e, in [0, 1]: the part of the approaching speed that an impact gives back.
        friction: Coulomb's coefficient μ >= 0.
        stiffness: k, N/m, of a spring at every point in place of the rigid law, which then knows no restitution:
            λ = max(0, -k g - (k h/2 + d) s). None: rigid.
        damping: d, N s/m, of a dashpot beside each spring.

    Raises:
        SceneError: a number out of its range, or damping or restitution that would not act.
    """

    restitution: float = 0.0
    friction: float = 0.0
    stiffness: float | None = None
    damping: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise SceneError(f"contact: restitution: allowed is a number in [0, 1], given: {self.restitution!r}")
        for name in ("friction", "damping"):
            if not 0 <= getattr(self, name) < math.inf:
                raise SceneError(f"contact: {name}: allowed is a finite number >= 0, given: {getattr(self, name)!r}")
        if self.stiffness is None:
            if self.damping:
                raise SceneError("contact: damping acts beside a stiffness, and none is given")
        elif not 0 < self.stiffness < math.inf:
            raise SceneError(f"contact: stiffness: allowed is a finite number > 0, in N/m, given: {self.stiffness!r}")
        elif self.restitution:
            raise SceneError("contact: restitution belongs to the rigid law: allowed beside a stiffness is 0")


class ContactWork(NamedTuple):
    """Where the work of contact in a step went, J: h Σ f·v̂ = supplied - contact - friction.

    Attributes:
        supplied: by obstacles that move.
        contact: dissipated by impacts, >= 0; with the penalty law also what its springs take up, or give back (< 0).
        friction: dissipated by friction, >= 0.
    """

    supplied: float
    contact: float
    friction: float


class ContactSolution(NamedTuple):
    """What contact does in one step.

    Attributes:
        forces: (P, 3) on the points, N.
        by_obstacle: (O, 3) resultants on the body, N.
        iterations: systems of equations solved.
        pairs: (C,) of those that took part: obstacle times P plus point.
        normals: (C, 3) theirs.
        pair_forces: (C, 3) theirs, N.
        obstacle_velocities: (O, 3), m/s.
        rough: whether there is friction.
    """

    forces: Array
    by_obstacle: Array
    iterations: int
    pairs: Array
    normals: Array
    pair_forces: Array
    obstacle_velocities: Array
    rough: bool

    @property
    def touching(self) -> int:
        """Number of pairs that push, by more than round-off."""
        pressure = (self.pair_forces * self.normals).dot(_ONES)
        return int(np.count_nonzero(pressure > 1e-9 * pressure.max()))

    def account(self, velocity: Array, dt: float) -> ContactWork:
        """Where the work went.

        Args:
            velocity: (P, 3) mid-step velocities v̂ of the points, m/s, as the step has found them.
            dt: of the step, s.
        """
        w = self.obstacle_velocities
        if len(w) == 1:
            relative = velocity[self.pairs] - w[0]
        else:
            obstacle, point = np.divmod(self.pairs, len(velocity))
            relative = velocity[point] - w[obstacle]
        whole = normal = float(self.pair_forces.ravel().dot(relative.ravel()))
        if self.rough:
            pressure = (self.pair_forces * self.normals).dot(_ONES)
            normal = float(pressure.dot((relative * self.normals).dot(_ONES)))
        supplied = float(self.by_obstacle.ravel().dot(w.ravel()))
        return ContactWork(dt * supplied, -dt * normal, dt * (normal - whole))


class ContactResidual(NamedTuple):
    """Steps whose forces solve the contact problem but for a residual.

    Attributes:
        steps: how many.
        residual: the largest, as a share of the velocities that the forces had to stop.
    """

    steps: int = 0
    residual: float = 0.0

    @property
    def message(self) -> str:
        """What to say of a run; empty where there is nothing to say."""
        if not self.steps:
            return ""
        return (
            f"in {self.steps} steps contact forces were found only to {self.residual:.0e} of the velocities that they "
            "stop, and made smaller so that they do no work; a smaller dt or less friction may help"
        )


class Contact:
    """Contact of the points of a body with obstacles.

    It keeps the last forces, to begin the next search with, and nothing else of the past.

    Args:
        points: (P, 3) at rest, m.
        obstacles: O of them.
        law: how they meet.

    Attributes:
        last: (O P, 3) the last forces, N, obstacle after obstacle.
    """

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        self.loose = ContactResidual()
        self.points, self.obstacles, self.law = np.array(points, dtype=float), tuple(obstacles), law
        self.last = np.zeros((len(self.obstacles) * len(self.points), 3))
        self._whole = self._part = np.empty((0, 0))
        self._chosen = b""

    def gaps(self, displacement: Array, offsets: Array) -> Array:
        """Smallest gap of each point (P,), m.

        Args:
            displacement: (P, 3), m.
            offsets: (O, 3) how far the obstacles have moved, m.
        """
        return self._distances(displacement, offsets)[0].reshape(len(self.obstacles), -1).min(axis=0)

    def check_start(self, displacement: Array, offsets: Array, names: Sequence[str]) -> None:
        """Checks that no point is inside an obstacle by more than round-off, 1e-9 of the size of the body.

        Args:
            displacement: (P, 3), m.
            offsets: (O, 3) how far the obstacles have moved, m.
            names: of the O obstacles.

        Raises:
            StepError: one is; it says where, and how deep.
        """
        gaps = self._distances(displacement, offsets)[0]
        size = float(max(np.ptp(self.points, axis=0).max(), np.abs(self.points).max()))
        deepest = int(gaps.argmin())
        if gaps[deepest] < -_INSIDE * size:
            obstacle, point = divmod(deepest, len(self.points))
            raise StepError(
                f"contact: allowed is a start outside of all obstacles, but {-gaps[deepest]:.3g} m inside "
                f"{names[obstacle]!r} is the point at {(self.points[point] + displacement[point]).tolist()}"
            )

    def resolve(
        self,
        displacement: Array,
        velocity: Array,
        free: Array,
        W: Array,
        dt: float,
        offsets_start: Array,
        offsets_end: Array,
        quasi_static: bool = False,
        w_before: Array | None = None,
    ) -> ContactSolution | None:
        """Contact forces of one step; None where nothing touches.

        Args:
            displacement: (P, 3) of the points at the start of the step, m.
            velocity: (P, 3) at the start of the step, m/s.
            free: (P, 3) mid-step velocities without contact, m/s.
            W: (3P, 3P) mid-step velocities per force, m/s/N, symmetric, positive semidefinite; not to be changed in
                place: parts of it are kept as long as the same array is given.
            dt: step size h, s.
            offsets_start: (O, 3) how far the obstacles have moved at the start of the step, m.
            offsets_end: (O, 3) at its end, m.
            quasi_static: without impacts: a gap may close within the step but not beyond, s >= -max(g, 0)/h, and what
                sticks does not move.
            w_before: (O, 3) velocities of the obstacles in the step before, m/s; None: as in this one.

        Raises:
            StepError: no forces found; the next step begins as this one did.
        """
        law, P = self.law, len(self.points)
        gaps, n = self._distances(displacement, offsets_start)
        w = (offsets_end - offsets_start) / dt
        relative_free, relative = self._relative(free, w), self._relative(velocity, w)
        if w_before is not None:
            self._follow(relative, (w - w_before) / 2)
        a = (n * relative).dot(_ONES)
        e = 1.0 if quasi_static or law.stiffness is not None else law.restitution
        if law.stiffness is not None:
            damper = law.stiffness * dt / 2 + law.damping
            level = c = gaps * (-law.stiffness / damper)
        elif quasi_static:
            level = c = np.maximum(gaps, 0.0) / -dt
        else:
            level, c = gaps / -dt, (1 - e) / 2 * np.minimum(a, 0.0)
            if gaps.min() < 0.0:  # no deeper than a step's motion of the obstacle or of the body
                deepest = gaps / dt + np.abs(a) + np.sqrt((w * w).dot(_ONES)).repeat(P)
                c = np.maximum(c, -np.maximum(deepest, 0.0))

        def due(s: Array) -> Array:
            """Pairs that come too close at the relative mid-step velocity s."""
            return s + (1 - e) * np.minimum(s - a / 2, 0.0) < level if e < 1 else s < level

        chosen = due((n * relative_free).dot(_ONES))
        pairs = chosen.nonzero()[0]
        if not len(pairs):
            return None
        slides = law.friction > 0 and not quasi_static
        c_t = (relative - a[:, None] * n) / 2 if slides else None
        iterations, start = 0, self.last
        while True:
            every = len(pairs) == len(chosen)  # then nothing needs to be picked
            normals = n if every else n[pairs]
            target = (c if every else c[pairs])[:, None] * normals
            if c_t is not None:
                aside = c_t if every else c_t[pairs]
                target += aside
            q = (relative_free if every else relative_free[pairs]) - target
            part = self._operator(W, pairs, P)
            if law.stiffness is not None:
                part = _compliant(part, normals, 1 / damper)
            solution = solve(part, q, normals, law.friction, start if every else start[pairs])
            f = solution.forces
            iterations += solution.iterations
            if solution.residual > NEGLIGIBLE_RESIDUAL:
                f = _passive(f, part, relative_free if every else relative_free[pairs])
            if every:
                start = f
            else:
                start = np.zeros((len(chosen), 3))
                start[pairs] = f
            by_pair = start.reshape(-1, P, 3)
            forces = by_pair[0] if len(by_pair) == 1 else by_pair.sum(axis=0)
            again = False
            if c_t is not None:
                helps = _helping(f, aside, normals, solution.velocities, q)
                if helps is not None:
                    c_t[pairs[helps]] = 0.0
                    again = True
            if not every:
                after = self._relative(free + W.dot(forces.ravel()).reshape(free.shape), w)
                more = due((n * after).dot(_ONES)) & ~chosen
                if more.any():
                    chosen |= more
                    pairs = chosen.nonzero()[0]
                    again = True
            if not again:
                break
        self.last = start
        if solution.residual > NEGLIGIBLE_RESIDUAL:
            self.loose = ContactResidual(self.loose.steps + 1, max(self.loose.residual, solution.residual))
        return ContactSolution(forces, by_pair.sum(axis=1), iterations, pairs, normals, f, w, law.friction > 0)

    def _distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """Gaps (O P,), m, and normals (O P, 3), obstacle after obstacle."""
        x = self.points + displacement
        found = [obstacle.distance(x - moved) for obstacle, moved in zip(self.obstacles, offsets, strict=True)]
        if len(found) == 1:
            return found[0]
        return np.concatenate([gap for gap, _ in found]), np.concatenate([normal for _, normal in found])

    def _relative(self, velocity: Array, w: Array) -> Array:
        """Velocities of the points (P, 3) relative to each obstacle (O P, 3), m/s."""
        return (velocity - w[:, None]).reshape(-1, 3)

    def _follow(self, relative: Array, ahead: Array) -> None:
        """Measures velocities of pairs that pushed in the step before against that of the obstacle between the steps.

        What keeps touching an obstacle that accelerates has that velocity, and not yet the mean one of this step. Taken
        for an approach, the difference would let it sink in a little further in every step.

        Args:
            relative: (O P, 3) to the mean velocities of the obstacles in this step, m/s; changed in place.
            ahead: (O, 3) these less those between the steps, m/s.
        """
        if ahead.any():
            pushed = self.last.any(axis=1)
            relative[pushed] += np.repeat(ahead, len(self.points), axis=0)[pushed]

    def _operator(self, W: Array, pairs: Array, P: int) -> Array:
        """Relative velocities of the pairs per force of the pairs; kept while both stay the same."""
        if len(pairs) == P and len(self.obstacles) == 1:
            return W
        key = pairs.tobytes()
        if W is not self._whole or key != self._chosen:
            rows = (3 * (pairs % P)[:, None] + np.arange(3)).ravel()
            self._whole, self._chosen, self._part = W, key, W[rows[:, None], rows]
        return self._part


def _passive(f: Array, W: Array, free: Array) -> Array:
    """Forces that solve the problem but for a residual, made smaller until they do no work on the body."""
    own, given = float(f.ravel().dot(W.dot(f.ravel()))), float(f.ravel().dot(free.ravel()))
    return f * min(1.0, max(0.0, -given / own)) if own > 0 else f


def _compliant(W: Array, normals: Array, compliance: float) -> Array:
    """W with a compliance of each pair along its normal, m/s/N."""
    C = len(normals)
    W = W.copy()
    W.reshape(C, 3, C, 3)[np.arange(C), :, np.arange(C)] += compliance * normals[:, :, None] * normals[:, None, :]
    return W


def _helping(f: Array, c_t: Array, normals: Array, u: Array, q: Array) -> Array | None:
    """Pairs whose friction would do work on the body, or None if it does none as a whole; u = v̂ - w - c n - c_t."""
    negligible = _ROUNDING * float(np.abs(f).max()) * float(np.abs(q).max())
    if not f.ravel().dot(c_t.ravel()) > negligible:  # with u_t it never does
        return None
    tangential = f - (f * normals).dot(_ONES)[:, None] * normals
    work = (tangential * (u + c_t)).dot(_ONES)
    helps = (work > negligible) & c_t.any(axis=1)  # each but once: where c_t = 0, what is left is round-off
    return helps if work.sum() > negligible and helps.any() else None
