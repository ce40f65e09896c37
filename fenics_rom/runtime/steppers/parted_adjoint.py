"""Back through a step that is made of parts: put together from the slopes that each of them tells, as the step is.

Velocities x fulfil ρ(x, place, velocities at the start, u) = Sᵀ f + B z, however they were found, contact forces f
their law, of what the points do: ŝ in the middle of the step, κ with the velocities of the start, and d, where they
are; and forces z of actuators χ(x, z, ..) = 0. So with K = ∂(ρ - Sᵀ f - B z)/∂x

    [K -B; X Z] (δx, δz) = ∂(Sᵀ f)/∂f δf - (∂ρ, ∂χ),        δŝ = U δx + .., δκ likewise,

in which the law is linearised (mechanics/contact_adjoint.py): with W = U [K -B; X Z]⁻¹ ∂(Sᵀ f)/∂f. What J owes to x
and z goes to the rest by the transposed matrix. ∂J/∂x is written x_.

A place is a shape q (m,), and in a moving frame that before it (`frame_slopes`); velocities likewise: k numbers.
"""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.runtime.steppers.acts.found_slopes import FoundSlopes
from fenics_rom.runtime.steppers.adjoint import NONE, Reads, StateAdjoint, StepSlopes
from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps, strained_back
from fenics_rom.runtime.steppers.slopes import Slopes
from fenics_rom.runtime.steppers.touch_adjoint import Touch

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.elastic.strains_adjoint import StrainsAdjoint


class StepPart(Protocol):
    """A step, or a part of one."""

    @property
    def own(self) -> slice:
        """Which of k velocities it solves for."""

    @property
    def shape(self) -> slice:
        """Which of k numbers of a place are the shape."""

    @property
    def law(self) -> LawAdjoint:
        """What resists the shape."""

    @property
    def found(self) -> FoundSlopes | None:
        """Forces of actuators that are found."""

    @property
    def residual(self) -> ResidualMaps | None:
        """What contact points yield beyond the basis."""

    @property
    def turned(self) -> Array | None:
        """∂(loads)/∂q (m, m) where they act; None: they stay."""

    @property
    def half(self) -> float:
        """h/2, s: where loads act at the expected middle it goes with the v̂ that was expected by it."""

    @property
    def by_velocity_before(self) -> Array | None:
        """∂ρ/∂v̂ (k, m) of the step before, which the law carries along; None: nothing feels it."""

    @property
    def by_forces(self) -> Array:
        """∂(Sᵀ f)/∂f (k, 3P) of contact forces that are known; (k, 0) where nothing touched."""

    def back(self, place_: Array, velocity_: Array) -> tuple[Array, Array, Array]:
        """What place and velocities at the start, and x, are owed (k,) by both at the end."""

    def balance(self) -> tuple[Slopes, Array]:
        """Of ρ (k,) but for contact, the law and forces that are found; and ∂(forces)/∂u (k, p)."""

    def touch(self) -> Touch | None:
        """Of contact points, if any were touched."""

    def stored(self) -> tuple[Array, Array]:
        """Slopes of what is stored at its end with place and velocities, (k,), but for the law and beyond the basis."""


class Ends(NamedTuple):
    """The state on both sides of a step, but for a frame; all shapes with rigid displacements."""

    ω: Array  # (m,), infinite for rigid motions
    q: Array
    q_after: Array
    rows_after: Array | None  # of the residual part (n, 3P)


class Expectation(NamedTuple):
    """v̂ of a step as it was expected: v - T ρ(v), at v̂ and under the forces of the step before, with a T of before."""

    part: StepPart  # the step at that v̂, and at an ω̂ of its own, under contact forces that are known
    law: "StrainsAdjoint"
    places: Array  # of forces that are found, in the input (n,)
    T: Array  # (m, m), the inverse of what a step resists with
    lack: Array  # ρ (m,)
    whole: Array  # v̂ (m,) that comes of it
    farthest: float  # |v̂| that the law takes at most
    made_tangent: bool  # whether in this step, else in an earlier one
    by_spin: float = 0.0  # a: ω̂ is ω + a (ω - ω̂ of the step before), of a free body
    led: StepPart | None = None  # the step at the v̂ that comes of it, of a body that a base carries

    def back(self, expected_: Array, tangent_: Array) -> tuple[Array, ...]:
        """What is owed to place and velocities (k,), what the law carries, u (p,), f, z, the tangent and ω̂ before.

        And to the base: T is of where it goes, too, so that ρ's slopes with it count at the v̂ that is expected.
        """
        square = float(self.whole @ self.whole)
        if square > self.farthest**2:
            share = self.farthest / square**0.5
            expected_ = share * (expected_ - float(self.whole @ expected_) / square * self.whole)
        w, shape = -self.T.T @ expected_, self.part.shape
        of_T = -np.outer(w, self.T @ self.lack)
        tangent_ = (of_T + of_T.T) / 2 + (tangent_ if len(tangent_) else 0.0)
        balance, by_input = self.part.balance()
        ρ_ = np.zeros(len(balance.x))
        ρ_[shape] = w
        frame_is_free = self.part.own.start < shape.start
        if frame_is_free:  # what the origin does is found with it
            ρ_[:3] = -np.linalg.solve(balance.x[:3, :3].T, w @ balance.x[shape, :3])
        place_, velocity_, x_ = ρ_ @ balance.place, ρ_ @ balance.velocity, ρ_ @ balance.x
        v_ = expected_ + x_[shape]
        own_, of_shape, tangent_ = self.law.expected_back(w, v_, tangent_, made_tangent=self.made_tangent)
        place_[shape] += of_shape
        by_u = -ρ_ @ by_input
        reactions_ = by_u[self.places]
        by_u[self.places] = 0.0
        spin_, base_ = np.zeros(3), NONE
        if self.led is not None:
            led, _ = self.led.balance()
            mean_ = w @ led.x[shape, :6] / 2
            place_[:6], velocity_[:6] = w @ led.place[shape, :6], w @ led.velocity[shape, :6] + mean_
            base_ = np.concatenate([w @ led.end[shape], mean_])
        if frame_is_free:
            velocity_[3:6] += (1 + self.by_spin) * x_[3:6]
            spin_ = -self.by_spin * x_[3:6]
        return place_, velocity_, own_, by_u, -ρ_ @ self.part.by_forces, reactions_, tangent_, spin_, base_


class Span(NamedTuple):
    """Shapes P (k, m) that a step is within, of a balance of k coordinates: Pᵀ ρ = 0, with v̂ in the span of P."""

    shapes: Array  # P
    rate: Array  # Pᵀ v̂ (m,)
    lack: Array  # ρ (k,), where the span has it not

    def of(self, size: int, first: int) -> Array:
        """The same of as many unknowns (size, any), those of the coordinates from the first one on."""
        k, m = self.shapes.shape
        within = np.zeros((size, size - k + m))
        within[:first, :first] = np.eye(first)
        within[first : first + k, first : first + m] = self.shapes
        within[first + k :, first + m :] = np.eye(size - first - k)
        return within


class PartedAdjoint(NamedTuple):
    """A step that was taken, in one or more parts, the last one first.

    Carried: what the law carries, and the residual's rows (n, 3P); `rows_first`: the other way round.
    """

    parts: "tuple[StepPart, ...]"
    ends: Ends
    is_kink: bool  # where there is no derivative, but one to each side
    given: Array | None = None  # ∂strokes/∂q (m, n) at the start, from where parts of a step go on
    rows_first: bool = False
    expectation: Expectation | None = None
    span: Span | None = None

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """What the step passes back of derivatives with what it led to, and with what was read then."""
        (ω, q, q_after, rows_after), energy, shape = self.ends, reads.energy, self.parts[0].shape
        place_, velocity_ = np.zeros((2, shape.start + len(q)))
        if len(after.frame):
            place_[: shape.start], velocity_[: shape.start] = after.frame[:6] + reads.place, after.frame[6:12]
        (by_e, by_r), ρ = after.state.reshape(2, -1), len(after.rigid)
        of_e = np.concatenate([after.rigid, ω[ρ:] * by_e[ρ:]])
        place_[shape], velocity_[shape] = of_e + reads.q, by_r
        if energy:
            stored = self.parts[0].stored()
            place_, velocity_ = place_ + energy * stored[0], velocity_ + energy * stored[1]
        size = 0 if rows_after is None else rows_after.size
        rows_, own_ = np.split(after.auxiliary, [size if self.rows_first else len(after.auxiliary) - size])
        if not self.rows_first:
            rows_, own_ = own_, rows_
        residual = self.parts[0].residual
        if residual is not None and rows_after is not None:
            rows_ = rows_.reshape(rows_after.shape) + energy * residual.of_energy(rows_after)
            rows_[0] += strained_back(residual.part, reads.beyond)
        state, to_start = (place_, velocity_, rows_, own_), np.zeros(1)
        found = list[tuple[Array, Array, Array]]()
        for number, part in enumerate(self.parts):
            later = (after.forces, after.reactions, after.frame[12:]) if number == 0 else (NONE, NONE, NONE)
            state, by_u, by_goal, along, of_damping, expected_, base_, span_ = _back(
                part, *state, energy if number == 0 else 0.0, later, self.span
            )
            share = 1 - number / len(self.parts)  # of the way to what is given, at the end of the part
            if part.found is not None:
                given = np.where(part.found.at_once, 1.0, share)
                by_u[part.found.places] += given * by_goal
                to_start = to_start + (1 - given) * by_goal
            found.append((by_u, along, of_damping))
        place_, velocity_, rows_, own_ = state
        forces_, reactions_, tangent_, spin_ = NONE, NONE, NONE, np.zeros(3)
        if self.expectation is not None:
            of_start = self.expectation.back(expected_, after.tangent)
            place_, velocity_, own_ = place_ + of_start[0], velocity_ + of_start[1], own_ + of_start[2]
            found.append((of_start[3], found[0][1], found[0][2]))
            forces_, reactions_, tangent_, spin_, base_ = *of_start[4:8], base_ + of_start[8]
        inputs, along_ω, damping = (np.sum(each, axis=0) for each in zip(*found, strict=True))
        if self.given is not None:
            place_[shape] += self.given @ to_start
        if len(along_ω):
            along_ω = along_ω + by_e * q_after - place_[shape] * q / ω
        both = np.concatenate([place_[shape] / ω, velocity_[shape]])
        both[:ρ] = 0.0
        before = StateAdjoint(
            both,
            place_[shape][:ρ].copy(),
            np.concatenate([rows_.ravel(), own_] if self.rows_first else [own_, rows_.ravel()]),
            forces_,
            tangent_,
            reactions_,
            after.span + span_ if len(after.span) else span_,
            frame=np.concatenate([place_[: shape.start], velocity_[: shape.start], spin_])
            if len(after.frame)
            else NONE,
        )
        return StepSlopes(before, inputs, along_ω, damping, base_)


State = tuple[Array, Array, Array, Array]  # derivatives with place, velocities, the residual's rows, and a law's own


def _back(
    part: StepPart,
    place_: Array,
    velocity_: Array,
    rows_: Array,
    own_: Array,
    energy: float,
    later: tuple[Array, Array, Array],
    span: Span | None,
) -> tuple[State, Array, Array, Array, Array, Array, Array, Array]:
    """What is owed to the state before a part; to inputs, goals of strokes, ω, D, v̂ as expected, a base, and a span.

    `later`: what later steps owe to contact forces (3P,), to forces that were found (n,) and to ω̂; empty: nothing.
    """
    own, shape, law, found = part.own, part.shape, part.law, part.found
    owed, seen_, base = law.after(own_, energy), NONE, slice(0, part.own.start)
    end_ = place_[base]
    if part.residual is not None:
        rows_, seen_ = part.residual.pull_back(rows_)
    place_[shape] += owed.end
    place_, velocity_, x_ = part.back(place_, velocity_)
    place_[shape] += owed.start
    x_[shape] += owed.velocity
    if len(later[2]):
        x_[3:6] += later[2]

    balance, by_input = part.balance()
    balance.x[shape, shape] += law.by_velocity
    balance.place[shape, shape] += law.by_shape
    touch = part.touch()
    if touch is not None and touch.push is not None:
        balance = balance.with_(touch.push, -1.0)
    whole = balance.x[own, own]
    if found is not None:
        whole = found.bordered(whole, by_input[own][:, found.places])
    y, n, z_ = np.zeros(len(place_)), len(x_[own]), np.zeros(len(whole) - len(x_[own]))
    within, first = None, shape.start - own.start
    if span is not None:
        within = span.of(len(whole), first)
    if len(later[1]):
        z_ = later[1]
    if touch is not None:
        of_points = _through_contact(part, touch, (whole, within), (x_, z_), seen_, later[0])
        place_, velocity_, x_, of_rows, end_ = (
            place_ + of_points[0], velocity_ + of_points[1], x_ + of_points[2], of_points[3], end_ + of_points[4]
        )  # fmt: skip
    owed_, span_ = np.concatenate([x_[own], z_]), NONE
    solved = _solved(whole.T, within, owed_)
    y[own], η = np.split(solved, [n])
    if span is not None:
        left_ = (owed_ - whole.T @ solved)[first:n]
        span_ = np.outer(left_, span.rate) - np.outer(span.lack, y[shape] @ span.shapes)
    place_, velocity_ = place_ - y @ balance.place, velocity_ - y @ balance.velocity
    mean_ = (x_ - y @ balance.x)[base] / 2  # of both twists
    velocity_[base] += mean_
    if own.start:
        end_ = end_ - y @ balance.end
    if touch is not None and rows_.size:
        rows_ = rows_ + of_rows + touch.rows_of_push(y)
    own_, of_shape, expected_ = law.before(y[shape], owed)
    place_[shape] += of_shape
    if part.by_velocity_before is not None:
        own_ = law.with_velocity(own_, -y @ part.by_velocity_before)
    if len(expected_) and part.turned is not None:
        expected_ = expected_ + part.half * (y[shape] @ part.turned)
    by_u, by_goal = y @ by_input, NONE
    if found is not None:
        by_u, by_goal = found.back(η, by_u)
        place_[shape] -= η @ found.by_shape
        velocity_[shape] -= η @ found.by_rate
        if len(expected_):
            expected_ = expected_ - part.half * (η @ found.by_middle)
    state, base_ = (place_, velocity_, rows_, own_), np.concatenate([end_, mean_])
    return state, by_u, by_goal, *law.by_model(y[shape], owed), expected_, base_, span_


def _solved(whole: Array, within: Array | None, right: Array) -> Array:
    """The inverse of a matrix, or of what it is within a span, times something."""
    if within is None:
        return np.linalg.solve(whole, right)
    solved: Array = within @ np.linalg.solve(within.T @ whole @ within, within.T @ right)
    return solved


def _through_contact(
    part: StepPart,
    touch: Touch,
    whole: tuple[Array, Array | None],
    owed: tuple[Array, Array],
    seen_: Array,
    forces_: Array,
) -> tuple[Array, Array, Array, Array, Array]:
    """What is owed to place, velocities at the start, x (k,), the residual's rows (n, 3P) and a base, by contact."""
    own, (x_, z_) = part.own, owed
    place_, further = np.zeros((2, len(x_)))
    end_ = np.zeros(own.start)
    forces, φ = touch.by_forces[own], np.zeros(touch.by_forces.shape[1])
    if len(seen_):
        place_, further, φ, of_end = touch.seen_back(seen_)
        end_ = end_ + of_end
    if len(forces_):
        φ = φ + forces_
    all_spread = _solved(*whole, np.vstack([forces, np.zeros((len(z_), forces.shape[1]))]))
    spread = all_spread[: len(forces)]
    by_forces = [
        motion.x[:, own] @ spread + by_force
        for motion, by_force in zip(touch.motions, touch.by_yielding, strict=True)
    ]  # fmt: skip
    φ = φ + np.concatenate([(x_ + further)[own], z_]) @ all_spread
    points_ = touch.contact.through(*by_forces).pull_back(φ.reshape(-1, 3))
    d_, motions_ = points_.displacement.ravel(), [points_.free_velocity.ravel(), points_.velocity.ravel()]
    if points_.middle is not None:
        motions_.append(points_.middle.ravel())
    place_, velocity_, x_ = place_ + d_ @ touch.place, np.zeros(len(x_)), further
    for motion, owed_ in zip(touch.motions, motions_, strict=True):
        place_, velocity_, x_ = (
            place_ + owed_ @ motion.place,
            velocity_ + owed_ @ motion.velocity,
            x_ + owed_ @ motion.x,
        )
        if own.start:
            end_ = end_ + owed_ @ motion.end
    rows_ = touch.rows_back(d_, motions_) if part.residual is not None else NONE
    return place_, velocity_, x_, rows_, end_
