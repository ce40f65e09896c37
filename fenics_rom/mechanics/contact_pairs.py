"""Pairs of a point and an obstacle in one step, and what the contact law asks of each; see `contact_solver`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.braking import WORK_ROUND_OFF, Braking
from fenics_rom.mechanics.complementarity import Delassus, FramedDelassus, Frames, response
from fenics_rom.mechanics.contact import ContactLaw, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_look import Look
from fenics_rom.mechanics.points_operator import Operator

if TYPE_CHECKING:
    from fenics_rom.mechanics.own_adjoint import PairRows


class PairsProblem(NamedTuple):
    """Of C active pairs, in their frames."""

    frames: Frames
    operator: FramedDelassus
    free: Array  # relative mid-step velocity without contact, (3, C), m/s
    q: Array  # the same less the targets, (3, C), m/s
    start: Array  # forces to begin with, (3, C), N
    target: Array  # c (C,), m/s
    sliding: Array | None  # c_t (2, C), m/s; None where nothing slides


@dataclass(slots=True)
class Pairs:
    """What the law says of every pair in one step, obstacle after obstacle, in their frames; velocities in m/s."""

    frames: Frames
    free: Array  # relative mid-step velocity without contact, (3, O P)
    relative: Array  # relative velocity at the start of the step, (3, O P)
    level: Array  # (O P,) normal velocities below which a pair takes part
    target: Array  # c (O P,)
    compliance: float  # of each pair along its normal, m/s/N; 0 for the rigid law
    braking: Braking | None  # with c_t (2, O P); None where nothing slides

    def problem(self, active: Array, operator: Delassus, forces: Array, are_kept: bool) -> PairsProblem:
        """Of active pairs, which begins with forces of all pairs (O P, 3); `are_kept`: see FramedDelassus."""
        frames, free, target = self.frames, self.free, self.target
        sliding = None if self.braking is None else self.braking.targets
        if len(active) < len(target):
            frames, free, target = frames.of(active), free.take(active, axis=1), target.take(active)
            forces, sliding = forces.take(active, axis=0), None if sliding is None else sliding.take(active, axis=1)
        q = free.copy()
        q[0] -= target
        if sliding is not None:
            q[1:] -= sliding
        framed = operator.framed(frames, self.compliance, are_kept)
        return PairsProblem(frames, framed, free, q, frames.turned(forces)[0], target, sliding)

    def stop_asking_friction(self, active: Array) -> bool:
        """Sets c_t = 0 for all active pairs; whether it was not.

        A point that is wedged between two obstacles, each with a c_t of its own, may not be able to stick to either:
        then no forces solve the problem. Without c_t what it does stick to needs no velocity from friction.
        """
        return self.braking is not None and self.braking.stop_asking(active)

    def ask_friction_anew(self) -> None:
        """Forgets which c_t are others, as more pairs take part: the power of friction is that of all of them."""
        if self.braking is not None and self.braking.helped is not None:
            self.braking = self.braking.anew(self.relative[1:] / 2)

    def asks_less(
        self, active: Array, forces: Array, velocities: Array, problem: PairsProblem, friction: float
    ) -> bool:
        """Whether the c_t of active pairs are others than before, as friction would do work on the body.

        Of these are forces and velocities u = v̂ - w - c n - c_t, (3, C) each.
        """
        if self.braking is None:
            return False

        def by_targets(change: Array) -> tuple[Array, Array]:
            by_q = np.zeros(forces.shape)
            np.negative(change, by_q[1:])
            by_forces = response(problem.operator, friction, forces, velocities, by_q)
            return by_forces[1:], (problem.operator.moved(by_forces) + by_q)[1:]

        negligible = WORK_ROUND_OFF * float(np.abs(forces).max()) * float(np.abs(problem.q).max())
        return self.braking.asks_less(active, forces[1:], velocities[1:], negligible, by_targets)


class SolvedPairs(NamedTuple):
    """How the forces of a step were found."""

    points: PointMotion
    obstacles: ObstacleMotion
    look: Look | None  # at them; None: nobody knows, and none turns
    pushed: Array  # which of all pairs pushed in the step before, (O P,)
    operator: Operator  # Delassus operator (3P, 3P), m/s/N
    dt: float  # s
    quasi_static: bool
    pairs: Pairs
    gaps: Array  # of all pairs (O P,), m
    active: Array  # (C,) those that took part
    problem: PairsProblem  # of these
    forces: Array  # (3, C), N
    velocities: Array  # u with them, less the targets, (3, C), m/s
    is_loose: bool  # whether they solve the problem but for a residual
    rows: "PairRows | None" = None  # of a body that touches itself, how they move with its points


FIRST = 3  # sweeps of a step, or solutions of a sweep, after which what may not be stopped stays so


class Decided(NamedTuple):
    """What a sweep decided of all pairs."""

    chosen: Array  # (O P,) which take part
    outwards: Array  # (O P,) normal velocities without contact that tell what leaves, m/s
    braking: Braking | None


class Settled:
    """What sweeps of one step decided: what takes part or leaves stays so, or they never end.

    So does what may not be stopped, once sweeps are near the step: first ones say little of it. A sweep that solves
    contact under several forces of actuators decides what the last one says: those before were only tried, as a cable
    that pushes. Where these are many, they alternate with what contact decides, until that stays so.
    """

    def __init__(self) -> None:
        self._sweeps = self._solutions = 0  # that decided something, and of this sweep
        self._decided: Decided | None = None
        self._last: Decided | None = None  # of this sweep, or the one before

    def begin_sweep(self) -> None:
        """Ends the sweep before."""
        self._sweeps, self._solutions, self._decided = self._sweeps + (self._last is not None), 0, self._last

    def outwards(self, free: Array) -> Array:
        """The normal velocities without contact (O P,) that tell what leaves, from those of this sweep, m/s."""
        return free if self._decided is None else self._decided.outwards

    def decided(self) -> Decided | None:
        """What was decided before, without braking where that is found anew; None where nothing was."""
        if self._solutions >= FIRST:
            self._decided = self._last
        if self._decided is None or max(self._sweeps, self._solutions) > FIRST:
            return self._decided
        return self._decided._replace(braking=None)

    def take_part(self, chosen: Array, pairs: Pairs) -> None:
        """Adds pairs that took part before, and what was decided of what friction stops."""
        before = self.decided()
        if before is None:
            return
        chosen |= before.chosen
        if before.braking is not None and pairs.braking is not None:
            before.braking.renew(pairs.braking.targets)
            pairs.braking = before.braking

    def keep(self, chosen: Array, free: Array, braking: Braking | None) -> None:
        """Takes note of a solution; free: normal velocities without contact (O P,), m/s."""
        self._last = Decided(chosen, self.outwards(free), braking)
        self._solutions += 1


class NormalLaw(NamedTuple):
    """What the law says of the normal velocities of all pairs (O P,), m/s."""

    level: Array  # below which a pair takes part
    target: Array  # c, that they are to have at least
    compliance: float = 0.0  # by which they are lower per force, m/s/N


# What the law says of all pairs, from how fast they come near and would go without contact, (O P,), m/s.
Asked = Callable[[Array, Array], NormalLaw]


_LOWEST = -1e300  # of targets, beside gaps that are infinite, m/s
BACK = 1 + 1e-9  # beside 1 + e: points alike, whose speeds differ by round-off, all bounce, or none of them


class NormalRule:
    """The law in steps of dt, s, with arrays for its numbers, as in every step a number takes longer.

    Args:
        law: rigid, with restitution, or a spring and a dashpot.
        pairs: O P, their number.
        dt, quasi_static: as in ContactSolver.solve.
        radii: (O,) of the largest ball that each obstacle holds, m: what goes deeper in a step goes through.

    Attributes:
        key: law, dt and quasi_static.
        is_elastic: whether impacts of the rigid law lose nothing.
        too_far: (O P,) how deep the law last let each pair go, over the radius of its obstacle: more than 1 was held
            back. None where no pair goes as deep as the smallest radius.
    """

    too_far: Array | None = None

    def __init__(self, law: ContactLaw, pairs: int, dt: float, quasi_static: bool, radii: Sequence[float]):
        self.key = law, dt, quasi_static
        self._thinnest = min(radii, default=np.inf) / dt  # as a velocity
        self._thin = np.repeat(radii, pairs // max(len(radii), 1)) / dt
        self._spring, self._quasi_static = law.stiffness is not None, quasi_static
        self._enters = -1 / dt  # by which a gap is closed before springs act
        e, (rate, self._compliance) = law.restitution, law.in_steps(dt)
        self.is_elastic, self._bounces = e == 1.0, e > 0.0
        self._rate, self._half, self._share, self._pressed = (
            np.full(pairs, x) for x in (rate, 0.5, (1 - e) / 2, BACK * (1 + e))
        )
        self._zeros = np.zeros(pairs)

    def linear(self, gaps: Array, approach: Array) -> tuple[Array, Array]:
        """-g/h and (-g/h + a/2)/2 of any rigid pairs, from their gaps and approach, or derivatives of these."""
        closing = self._rate[0] * gaps
        return closing, (closing + approach / 2) / 2

    def asks(self, gaps: Array, gap: float, w: Array | None, approach: Array, outwards: Array) -> NormalLaw:
        """What the law says.

        Args:
            gaps: of all pairs, (O P,), m; `gap` is the smallest.
            w: velocities of the obstacles, (O, 3), m/s; None: they are at rest.
            approach: a = n·(v - w) of all pairs, (O P,), m/s.
            outwards: the same in the middle of the step without contact, (O P,), m/s.
        """
        closing = gaps * self._rate
        if self._spring:
            closing = np.where(gaps > 0, gaps * self._enters, closing)
            return NormalLaw(closing, closing, self._compliance)
        if self._quasi_static:
            level = np.minimum(closing, self._zeros)
            return NormalLaw(level, level)
        return self.of(closing, gap, w, approach, outwards)

    def of(self, closing: Array, gap: float, w: Array | None, approach: Array, outwards: Array) -> NormalLaw:
        """The same of rigid pairs with inertia, from `closing` = -g/h (O P,), m/s; of the gap only the sign matters."""
        stopped = approach * self._half
        later = (closing + stopped) * self._half
        level = np.maximum(closing, later)
        target = np.minimum(stopped, later, out=later)
        if self._bounces:
            leaves = True if self.is_elastic else outwards >= approach * self._pressed
            np.copyto(target, approach * self._share, where=leaves)
        if gap < 0.0:  # no deeper than a step's motion of the obstacle and of the body
            deepest = np.abs(approach) + np.abs(outwards)
            if w is not None:
                deepest += np.sqrt((w * w).sum(axis=1)).repeat(len(closing) // len(w))
            np.copyto(target, 0.0, where=closing > deepest)
        np.minimum(target, self._zeros, out=target)
        self.too_far = None
        if np.isfinite(self._thinnest):
            deep = closing - np.maximum(target, _LOWEST)  # of planes that are not there gaps are infinite
            if deep.item(deep.argmax()) > self._thinnest:  # else nothing goes so far
                self.too_far = np.maximum(deep, 0.0) / self._thin
                np.copyto(target, np.minimum(closing, 0.0), where=self.too_far > 1)
        return NormalLaw(level, target)


def kept_out(asked: Asked, gaps: Array, dt: float, but: "slice | Array", approach: Array, outwards: Array) -> NormalLaw:
    """What the law asks in a step of dt, s, of pairs with gaps (O P,), m, that do not go farther; but of some."""
    law, surface = asked(approach, outwards), np.minimum(-gaps / dt, 0.0)
    surface[but] = -np.inf
    return law._replace(target=np.maximum(law.target, surface))


def target_slopes(
    law: ContactLaw, gaps: Array, target: Array, approach: Array, dt: float, quasi_static: bool = False
) -> tuple[Array, Array]:
    """∂c/∂g, 1/s, and ∂c/∂a of pairs whose gaps, c and a are these, (C,) each; see `NormalRule`."""
    if law.stiffness is not None:
        return np.where(gaps > 0, -1 / dt, law.in_steps(dt)[0]), np.zeros(len(target))
    if quasi_static:
        return np.where(target < 0, -1 / dt, 0.0), np.zeros(len(target))
    half, bounced, held = approach / 2, (1 - law.restitution) / 2 * approach, -gaps / dt
    later = (half + held) / 2
    off_half, off_bounced, off_later = (np.abs(target - each) for each in (half, bounced, later))  # one is round-off
    closes = (later < half) & (off_later <= np.minimum(off_half, off_bounced))  # its gap, in two steps
    shares = np.where(off_half <= off_bounced, 0.5, (1 - law.restitution) / 2)
    by_gap, by_approach = np.where(closes, -1 / (2 * dt), 0.0), np.where(closes, 0.25, shares)
    is_held = np.abs(target - held) < np.minimum(np.minimum(off_half, off_bounced), off_later)  # before what is thin
    by_gap, by_approach = np.where(is_held, -1 / dt, by_gap), np.where(is_held, 0.0, by_approach)
    return by_gap * (target < 0), by_approach * (target < 0)


def passive_forces(f: Array, problem: PairsProblem) -> tuple[Array, Array]:
    """Forces that solve the problem but for a residual, made smaller until they do no work on the body; u with them."""
    moved = problem.operator.moved(f)
    spent, given = float(f.ravel().dot(moved.ravel())), float(f.ravel().dot(problem.free.ravel()))
    share = min(1.0, max(0.0, -given / spent)) if spent > 0 else 1.0
    return share * f, share * moved + problem.q
