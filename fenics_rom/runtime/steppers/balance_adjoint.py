"""Back through steps that balance forces, found by iteration or at once: the implicit function theorem.

A step, or a part of one, comes to a mid-step velocity v̂ with ρ(v̂, q, r, u) = Sᵀ f + B z, where contact forces f follow
by their law from what the points do, and forces z of strokes that are held by χ(v̂, q, r, u) = 0. However v̂ was found,

    [J -B; X 0] (δv̂, δz) = Sᵀ δf - (∂ρ, ∂χ),    J = ∂ρ/∂v̂,    X = ∂χ/∂v̂,

so that forces f move the points by W = S [J -B; X 0]⁻¹ Sᵀ, whatever the iteration took W for. What J owes to v̂ goes to
the rest by the transposed matrix. ∂J/∂x is written x_.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.runtime.steppers.adjoint import NONE, Reads, StateAdjoint, StepSlopes
from fenics_rom.runtime.steppers.residual_motion import ResidualMaps, strained_back


class HeldStrokes(NamedTuple):
    """Strokes (n,) that are given and held in a part of a step: forces z, and χ = X v̂ + ... = 0."""

    columns: Array  # B (m, n)
    by_velocity: Array  # X (n, m)
    by_shape: Array  # ∂χ/∂q (n, m)
    by_rate: Array  # ∂χ/∂r (n, m)
    by_goal: float  # ∂χ/∂(the stroke at the end of the part), 1/s or 1


class BalancedPart(NamedTuple):
    """A step, or a part of one, as the linear map that it is nearby."""

    h: float  # s; q⁺ = q + h v̂
    inertia: float  # 2/h: r⁺ = 2 v̂ - r, and ρ has 2/h (v̂ - r); 0 of equilibria, where r stays 0
    by_velocity: Array  # J (m, m)
    by_shape: Array  # ∂ρ/∂q (m, m)
    by_input: Array  # -∂ρ/∂u (m, p), of forces
    strokes: HeldStrokes
    Sᵀ: Array  # (m, 3P)
    contact: ContactAdjoint | None
    residual: ResidualMaps | None

    def pull_back(self, q_: Array, r_: Array, rows_: Array) -> tuple[Array, ...]:
        """Those of q, r and the residual's rows (4, 3P) before; of inputs, and of the strokes' goals; and y (m,)."""
        held, Sᵀ = self.strokes, self.Sᵀ
        m, n = held.columns.shape
        whole = np.block([[self.by_velocity, -held.columns], [held.by_velocity, np.zeros((n, n))]])
        right = np.concatenate([self.h * q_, np.zeros(n)])
        if self.inertia:
            right[:m] += 2 * r_
        by_force, to_q, to_r = np.zeros(Sᵀ.shape[1]), np.zeros(m), np.zeros(m)
        if self.residual is not None:
            rows_, by_force = self.residual.pull_back(rows_)
        if self.contact is not None:
            spread = np.linalg.solve(whole, np.vstack([Sᵀ, np.zeros((n, Sᵀ.shape[1]))]))
            W = Sᵀ.T @ spread[:m] + (0.0 if self.residual is None else self.residual.delassus)
            φ = right @ spread + by_force
            moved = np.reshape(self.contact.through(W).pull_back(φ.reshape(-1, 3)), (3, -1))
            to_q, to_r, push = moved @ Sᵀ.T
            right[:m] += push
            rows_ = rows_ if self.residual is None else rows_ + self.residual.of_points(moved)
        y, η = np.split(np.linalg.solve(whole.T, right), [m])
        q_ = q_ + to_q - self.by_shape.T @ y - held.by_shape.T @ η
        r_ = self.inertia * y - r_ + to_r - held.by_rate.T @ η if self.inertia else r_
        return q_, r_, rows_, self.by_input.T @ y, -held.by_goal * η, y


class StrokesGiven(NamedTuple):
    """What the strokes (k,) of a step were asked to become."""

    places: Array  # of those that are given, in the input (k,)
    at_start: Array  # ∂stroke/∂q (m, k) at the start of the step, from where parts of it go on


class BalanceAdjoint(NamedTuple):
    """A step of forces in balance, in one or more parts, the last one first.

    Carried: the residual's rows [g, y, ġ, ẏ] (4, 3P).
    """

    parts: list[BalancedPart]
    held: list[Array]  # which of the strokes each part held
    given: StrokesGiven
    ω: Array  # (m,)
    stored_slope: Array  # ∂Φ/∂q (m,) at the end
    q: Array  # (m,) at the start
    q_after: Array
    r_after: Array
    residual_after: Array | None
    is_kink: bool
    is_linear: bool  # whether Φ = ½ qᵀω²q, of which ∂J/∂ω is found

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """As in StepAdjoint."""
        ω, by_start = self.ω, np.zeros(self.given.at_start.shape[1])
        by_inputs = np.zeros(self.parts[0].by_input.shape[1])
        by_e, by_r = after.state.reshape(2, -1)
        q_ = ω * by_e + reads.q + reads.energy * self.stored_slope
        r_ = by_r + reads.energy * self.r_after
        rows_ = after.auxiliary.reshape(4, -1)
        if self.residual_after is not None and (residual := self.parts[0].residual) is not None:
            rows_ = rows_ + reads.energy * residual.of_energy(self.residual_after)
            rows_[0] += strained_back(residual.part, reads.beyond)
        for number, (part, held) in enumerate(zip(self.parts, self.held, strict=True)):
            q_, r_, rows_, of_part, by_goal, y = part.pull_back(q_, r_, rows_)
            share = 1 - number / len(self.parts)  # of the way to what is given, at the end of the part
            of_part[self.given.places] = 0.0  # their inputs are no forces
            by_inputs = by_inputs + of_part
            by_inputs[self.given.places[held]] += share * by_goal
            by_start[held] += (1 - share) * by_goal
        q_ = q_ + self.given.at_start @ by_start
        before = StateAdjoint(np.concatenate([q_ / ω, r_]), NONE, rows_.ravel())
        if not self.is_linear:
            return StepSlopes(before, by_inputs, NONE, NONE)
        along_ω = (by_e + reads.energy * ω * self.q_after) * self.q_after - 2 * ω * self.q_after * y - q_ * self.q / ω
        return StepSlopes(before, by_inputs, along_ω, np.zeros_like(ω))
