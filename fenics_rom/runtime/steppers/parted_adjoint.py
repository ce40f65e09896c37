"""Back through a step that is made of parts: put together from the slopes that each of them tells, as the step is.

Velocities x fulfil ρ(x, place, velocities at the start, u) = Sᵀ f + B z, however they were found, contact forces f
their law, of what the points do: ŝ in the middle of the step, κ with the velocities of the start, and d, where they
are; and forces z of actuators χ(x, z, ..) = 0. So with K = ∂(ρ - Sᵀ f - B z)/∂x

    [K -B; X Z] (δx, δz) = ∂(Sᵀ f)/∂f δf - (∂ρ, ∂χ),        δŝ = U δx + .., δκ likewise,

in which the law is linearised (mechanics/contact_adjoint.py): with W = U [K -B; X Z]⁻¹ ∂(Sᵀ f)/∂f. What J owes to x
and z goes to the rest by the transposed matrix. ∂J/∂x is written x_.

A place is a shape q (m,), and in a moving frame that before it (`frame_slopes`); velocities likewise: k numbers.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.runtime.steppers.acts.found_slopes import FoundSlopes
from fenics_rom.runtime.steppers.adjoint import NONE, Reads, StateAdjoint, StepSlopes
from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps, strained_back
from fenics_rom.runtime.steppers.slopes import Slopes


class Touch(Protocol):
    """What contact points (P,) do in a step, and forces f on them, as they yield beyond the basis, too."""

    @property
    def contact(self) -> ContactAdjoint:
        """How the forces were found."""

    @property
    def place(self) -> Array:
        """∂d (3P, k) with the place."""

    @property
    def push(self) -> Slopes | None:
        """Of Sᵀ f where f stays; None: it stays, too."""

    @property
    def by_forces(self) -> Array:
        """∂(Sᵀ f)/∂f (k, 3P)."""

    @property
    def motions(self) -> tuple[Slopes, Slopes]:
        """Of ŝ and of κ, (3P, k)."""

    @property
    def by_yielding(self) -> tuple[Array, Array]:
        """∂ŝ and ∂κ with f, as points yield beyond the basis, (3P, 3P)."""

    def seen_back(self, seen_: Array) -> tuple[Array, Array, Array]:
        """What is owed to the place and x, (k,), and to f, (3P,), by what f is to the residual part."""

    def rows_back(self, d_: Array, ŝ_: Array, κ_: Array) -> Array:
        """What is owed to the residual's rows (n, 3P), by what points do (3P,)."""

    def rows_of_push(self, y: Array) -> Array:
        """The same by Sᵀ f, which is owed y (k,)."""


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

    ω: Array  # (m,), 1 for rigid motions
    rigid: int
    q: Array
    q_after: Array
    rows_after: Array | None  # of the residual part (n, 3P)


class PartedAdjoint(NamedTuple):
    """A step in one or more parts, the last one first.

    Carried: what the law carries, and the residual's rows (n, 3P); `rows_first`: the other way round.
    """

    parts: "tuple[StepPart, ...]"
    ends: Ends
    is_kink: bool
    given: Array | None = None  # ∂strokes/∂q (m, n) at the start, from where parts of a step go on
    rows_first: bool = False

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """As in StepAdjoint."""
        (ω, ρ, q, q_after, rows_after), energy, shape = self.ends, reads.energy, self.parts[0].shape
        place_, velocity_ = np.zeros((2, shape.start + len(q)))
        if len(after.frame):
            place_[: shape.start], velocity_[: shape.start] = after.frame[:6] + reads.place, after.frame[6:]
        by_e, by_r = after.state.reshape(2, -1)
        place_[shape], velocity_[shape] = ω * by_e + reads.q, by_r
        if ρ:
            place_[shape][:ρ] = after.rigid + reads.q[:ρ]
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
            state, by_u, by_goal, along, of_damping = _back(part, *state, energy if number == 0 else 0.0)
            share = 1 - number / len(self.parts)  # of the way to what is given, at the end of the part
            if part.found is not None:
                by_u[part.found.places] += share * by_goal
                to_start = to_start + (1 - share) * by_goal
            found.append((by_u, along, of_damping))
        place_, velocity_, rows_, own_ = state
        inputs, along_ω, damping = (np.sum(each, axis=0) for each in zip(*found, strict=True))
        if self.given is not None:
            place_[shape] += self.given @ to_start
        if len(along_ω):
            along_ω = along_ω + by_e * q_after - place_[shape] * q / ω
        both = np.concatenate([place_[shape] / ω, velocity_[shape]])
        both[:ρ] = 0.0
        before = StateAdjoint(
            both,
            place_[shape][:ρ].copy() if ρ else after.rigid,
            np.concatenate([rows_.ravel(), own_] if self.rows_first else [own_, rows_.ravel()]),
            frame=np.concatenate([place_[: shape.start], velocity_[: shape.start]]) if len(after.frame) else NONE,
        )
        return StepSlopes(before, inputs, along_ω, damping)


State = tuple[Array, Array, Array, Array]  # derivatives with place, velocities, the residual's rows, and a law's own


def _back(
    part: StepPart, place_: Array, velocity_: Array, rows_: Array, own_: Array, energy: float
) -> tuple[State, Array, Array, Array, Array]:
    """What is owed to the state before a part, and to inputs, goals of strokes, ω and D."""
    own, shape, law, found = part.own, part.shape, part.law, part.found
    owed, seen_ = law.after(own_, energy), NONE
    if part.residual is not None:
        rows_, seen_ = part.residual.pull_back(rows_)
    place_[shape] += owed.end
    place_, velocity_, x_ = part.back(place_, velocity_)
    place_[shape] += owed.start
    x_[shape] += owed.velocity

    balance, by_input = part.balance()
    balance.x[shape, shape] += law.by_velocity
    balance.place[shape, shape] += law.by_shape
    touch = part.touch()
    if touch is not None and touch.push is not None:
        balance = balance.with_(touch.push, -1.0)
    whole = balance.x[own, own]
    if found is not None:
        whole = found.bordered(whole, by_input[own][:, found.places])
    y, n = np.zeros(len(place_)), len(whole) - len(x_[own])
    if touch is not None:
        of_points = _through_contact(part, touch, whole, x_, seen_)
        place_, velocity_, x_, of_rows = (
            place_ + of_points[0], velocity_ + of_points[1], x_ + of_points[2], of_points[3]
        )  # fmt: skip
    owed_all = np.linalg.solve(whole.T, np.concatenate([x_[own], np.zeros(n)]))
    y[own], η = np.split(owed_all, [len(whole) - n])
    place_, velocity_ = place_ - y @ balance.place, velocity_ - y @ balance.velocity
    if touch is not None and rows_.size:
        rows_ = rows_ + of_rows + touch.rows_of_push(y)
    own_, of_shape = law.before(y[shape], owed)
    place_[shape] += of_shape
    by_u, by_goal = y @ by_input, NONE
    if found is not None:
        by_u, by_goal = found.back(η, by_u)
        place_[shape] -= η @ found.by_shape
        velocity_[shape] -= η @ found.by_rate
    return (place_, velocity_, rows_, own_), by_u, by_goal, *law.by_model(y[shape], owed)


def _through_contact(
    part: StepPart, touch: Touch, whole: Array, x_: Array, seen_: Array
) -> tuple[Array, Array, Array, Array]:
    """What is owed to place, velocities at the start, x (k,) and the residual's rows (n, 3P), by way of contact."""
    (mean, kept), own, place_, further = touch.motions, part.own, np.zeros(len(x_)), np.zeros(len(x_))
    forces, φ = touch.by_forces[own], np.zeros(touch.by_forces.shape[1])
    if len(seen_):
        place_, further, φ = touch.seen_back(seen_)
    n = len(forces)
    spread = np.linalg.solve(whole, np.vstack([forces, np.zeros((len(whole) - n, forces.shape[1]))]))[:n]
    W, by_start = (
        motion.x[:, own] @ spread + by_force
        for motion, by_force in zip((mean, kept), touch.by_yielding, strict=True)
    )  # fmt: skip
    φ = φ + (x_ + further)[own] @ spread
    d_, κ_, ŝ_ = (moved.ravel() for moved in touch.contact.through(W, by_start).pull_back(φ.reshape(-1, 3)))
    place_ = place_ + d_ @ touch.place + ŝ_ @ mean.place + κ_ @ kept.place
    velocity_ = ŝ_ @ mean.velocity + κ_ @ kept.velocity
    rows_ = touch.rows_back(d_, ŝ_, κ_) if part.residual is not None else NONE
    return place_, velocity_, further + ŝ_ @ mean.x + κ_ @ kept.x, rows_
