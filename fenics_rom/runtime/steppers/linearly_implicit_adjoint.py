"""Back through a linearly implicit step of large deformation; see held.py, carried_strains.py, whose symbols these are.

The step is one linear system M v̂ = R around the shape that was expected; with strokes that are held M v̂ = R + B z and
Bᵀv̂ = c. With y = M⁻¹ (what J owes to v̂), J owes y to R and -y v̂ᵀ to M, contact or not. Strains are of second degree
in q: with G(z) = ∂(Aᵀz)/∂q, which is symmetric,

    w·Aᵀz owes G(z) w to q and A w to z,    z·A v owes G(z) v to q and Aᵀz to v,
    w·AᵀC₀A v owes G(C₀A v) w + G(C₀A w) v to q.

What was expected came of a tangent T that may be some steps old: what J owes to it goes back to the step that made it.
∂J/∂x is written x_.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import SHARE
from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.runtime.steppers.adjoint import NONE, Reads, StateAdjoint, StepSlopes
from fenics_rom.runtime.steppers.deformation_maps import LinearlyImplicitMaps, Slope, Taken
from fenics_rom.runtime.steppers.expected_velocity import ExpectedVelocity
from fenics_rom.runtime.steppers.residual_maps import strained_back


class LinearlyImplicitAdjoint(NamedTuple):
    """A step by StrainsCarried.

    Carried: [ε, C₀ε, v̂ before, ½ s² - c, c, tank, ½ ε:C₀ε], and the residual's rows (4, 3P).
    """

    maps: LinearlyImplicitMaps
    u: Array
    taken: Taken
    states: list[Array]  # [e, r] and what is carried before the step, and after it
    residual_after: Array | None
    contact: ContactAdjoint | None
    is_kink: bool

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """As in StepAdjoint."""
        maps, ω, size = self.maps, self.maps.ω, self.maps.strains.size
        body, strains, h, residual = maps.body, maps.strains, maps.h, maps.residual
        before, carried_before, after_state, carried_after = self.states
        (e, r), (e_after, r_after) = before.reshape(2, -1), after_state.reshape(2, -1)
        q, q_after, v = e / ω, e_after / ω, (r + r_after) / 2
        own, rows = after.auxiliary[: len(carried_after)], after.auxiliary[len(carried_after) :]
        ε_after, σ_after = carried_after[: 2 * size].reshape(2, -1)
        ε_ = own[:size] + reads.energy / 2 * σ_after
        σ_ = own[size : 2 * size] + reads.energy / 2 * ε_after
        rest_ = own[-4:-1] + np.array([reads.energy, 0.0, 0.0])
        by_e, by_r = after.state.reshape(2, -1)
        r_ = by_r + reads.energy * r_after
        v_ = own[2 * size : -4] + 2 * r_
        q_ = ω * by_e + reads.q + reads.energy * (body.springs @ q_after)
        middle = q + h / 2 * self.taken.expected.value
        around, σ, slope, b, s = strains.around(middle), carried_before[size : 2 * size], None, NONE, 0.0
        rates = around.rates(v)
        rest, c, *_ = carried_before[-4:]
        if not maps.st_venant:
            slope = Slope.at_shape(maps, middle, c)
            c, b = slope.c, slope.b
            s = math.sqrt(2 * max(rest + c, 0.0))

        # back through what was taken back of the strains, and through their step
        taken = _TakenBack.of(self, q_after, v, rates, (b, s, c))
        ε_, σ_, q_back, heat_ = taken.pull_back(ε_, σ_, rest_)
        q_ = q_ + q_back
        rates_ = h * (ε_ + strains.stressed(σ_)) + 2 * heat_ * strains.viscosity * strains.stressed(rates)
        v_ = v_ + around.pulled(rates_) + 2 * heat_ * (body.external_damping @ v) + h * q_
        middle_, b_, s_ = strains.geometric(rates_) @ v, np.zeros(len(v)), 0.0
        if slope is not None:
            grown = h * float(b @ v)
            s_ = rest_[0] * grown
            b_ = h * rest_[0] * (s + grown) * v
            v_ = v_ + h * rest_[0] * (s + grown) * b

        # back through the linear system, with the forces of contact
        r_ = -r_
        by_force = after.forces if len(after.forces) else np.zeros(maps.Sᵀ.shape[1])
        if residual is not None and self.residual_after is not None:
            rows = rows.reshape(4, -1) + reads.energy * residual.of_energy(self.residual_after)
            rows[0] += strained_back(residual.part, reads.beyond)
            rows, of_residual = residual.pull_back(rows)
            by_force = by_force + of_residual
        system = _HeldSystem.of(self, middle, after.reactions)
        if self.contact is not None:
            φ = system.solve(v_)[0] @ maps.Sᵀ + by_force
            moved = np.reshape(self.contact.pull_back(φ.reshape(-1, 3)), (3, -1))
            by_place, by_start, push = moved @ maps.Sᵀ.T
            q_, r_, v_ = q_ + by_place, r_ + by_start, v_ + push
            rows = rows if residual is None else rows + residual.of_points(moved)
        y, c_ = system.solve(v_)
        inputs, by_middle = maps.loads_back(self.u, middle, y)
        by_strokes, of_middle, by_place, by_start = system.targets_back(q, r, v, y, c_)
        inputs[maps.places] = by_strokes
        by_middle, q_, r_ = by_middle + of_middle, q_ + by_place, r_ + by_start
        scale, strained = h / 2 + strains.viscosity, around.rates(y)
        middle_ += by_middle - strains.geometric(σ + strains.stressed(scale * rates)) @ y
        middle_ -= strains.geometric(strains.stressed(scale * strained)) @ v
        if slope is not None:
            b_ = b_ - h / 2 * (y * float(b @ v) + v * float(b @ y)) - s * y
            by_s = (s_ - float(b @ y)) / s if s > 0 else 0.0
            rest_[0] += by_s
            by_middle, rest_[1] = slope.pull_back(b_, rest_[1] + by_s)
            middle_ += by_middle

        start = ExpectedVelocity(maps, self.u, self.taken.expected).pull_back(h / 2 * middle_, after.tangent)
        q_ = q_ - body.springs @ y + middle_ + start.q
        r_ = r_ + 2 / h * y + start.r
        auxiliary = np.concatenate([ε_, σ_ - strained, start.velocity, rest_, [0.0], rows.ravel()])
        state = np.concatenate([q_ / ω, r_])
        return StepSlopes(
            StateAdjoint(state, NONE, auxiliary, start.forces, start.tangent, start.reactions),
            inputs + _without(start.inputs, maps.places),
            NONE,
            NONE,
        )


class _HeldSystem(NamedTuple):
    """The linear system of a step whose strokes are held, Bᵀv̂ = c, transposed."""

    maps: LinearlyImplicitMaps
    matrix: Array  # M (m, m)
    middle: Array  # where its forces act (m,)
    reactions: Array  # z (k,) of all strokes
    held: Array  # (n,)
    columns: Array  # B (m, n) of those that are held
    z_: Array  # (n,)

    @staticmethod
    def of(step: "LinearlyImplicitAdjoint", middle: Array, reactions_: Array) -> "_HeldSystem":
        """Of a step, and of what later ones owe to its reactions (k,)."""
        maps, taken = step.maps, step.taken
        z_ = reactions_[taken.held] if len(reactions_) else np.zeros(len(taken.held))
        columns = np.array([maps.strokes[stroke].force(middle) for stroke in taken.held])
        columns = columns.reshape(-1, len(middle)).T
        return _HeldSystem(maps, taken.matrix, middle, taken.reactions, taken.held, columns, z_)

    def solve(self, v_: Array) -> tuple[Array, Array]:
        """What is owed to R (m,), and to c (n,)."""
        y = np.linalg.solve(self.matrix, v_)
        if not len(self.held):
            return y, self.z_
        spread = np.linalg.solve(self.matrix, self.columns)
        c_ = np.linalg.solve(self.columns.T @ spread, self.columns.T @ y + self.z_)
        return y - spread @ c_, c_

    def targets_back(self, q: Array, r: Array, v: Array, y: Array, c_: Array) -> tuple[Array, Array, Array, Array]:
        """What is owed to strokes (k,), and to the middle, q and r, (m,) each, of B z and of Bᵀv̂ = c."""
        h, (by_strokes, of_middle, q_, r_) = self.maps.h, (np.zeros(len(self.reactions)), *np.zeros((3, len(q))))
        for place, owed in zip(self.held, c_, strict=True):
            stroke = self.maps.strokes[place]
            by_strokes[place] = SHARE / h * owed
            of_middle += stroke.pull_back(self.middle, self.reactions[place] * y - owed * v)
            q_ += (1 - SHARE) * owed * stroke.pull_back(q, r) - SHARE / h * owed * stroke.stroke_slope(q)
            r_ += (1 - SHARE) * owed * stroke.force(q)
        return by_strokes, of_middle, q_, r_


def _without(values: Array, places: Array) -> Array:
    """The same with 0 at some places."""
    values[places] = 0.0
    return values


class _TakenBack(NamedTuple):
    """How strains and s are moved towards those of the shape, at the end of a step."""

    maps: LinearlyImplicitMaps
    q: Array  # after the step
    ε: Array  # before they are moved
    gap: Array
    stressed: Array  # C₀ times it
    ε_shape: Array
    σ_shape: Array
    s: float  # before it is moved
    s_shape: float
    slope_left: Array  # ∂Ψ/∂q (m,)
    square: float
    slope: float
    budget: float  # J
    share: float

    @staticmethod
    def of(
        step: LinearlyImplicitAdjoint, q: Array, v: Array, rates: Array, around: tuple[Array, float, float]
    ) -> "_TakenBack":
        """Of a step to q with v̂ (m,) and strain rates A v̂; `around`: b, s and c in it."""
        maps, (b, s, c), carried = step.maps, around, step.states[1]
        strains, h, size = maps.strains, maps.h, maps.strains.size
        stress_rates = strains.stressed(rates)
        ε, σ = carried[:size] + h * rates, carried[size : 2 * size] + h * stress_rates
        drawn = float(v @ maps.body.external_damping @ v + (strains.viscosity * stress_rates) @ rates)
        ε_shape = strains.at(q)
        σ_shape = strains.stressed(ε_shape)
        gap, stressed, s_shape, slope_left = ε_shape - ε, σ_shape - σ, 0.0, np.zeros(len(q))
        if not maps.st_venant:
            grown = h * float(b @ v)
            s = math.sqrt(2 * max(carried[-4] + grown * (s + grown / 2) + c, 0.0))
            left, slope_left, _ = maps.left(q)
            s_shape = math.sqrt(2 * max(left + c, 0.0))
        square = float(stressed @ gap) + (s_shape - s) ** 2
        slope = float(stressed @ ε) + (s_shape - s) * s
        budget, share = float(carried[-2]) + h * drawn, 1.0
        if slope + square / 2 > budget and square > 0:
            root = math.sqrt(max(slope**2 + 2 * square * budget, 0.0))
            share = min(2 * budget / (slope + root) if slope > 0 else (root - slope) / square, 1.0)
        return _TakenBack(
            maps, q, ε, gap, stressed, ε_shape, σ_shape, s, s_shape, slope_left, square, slope, budget, share
        )

    def pull_back(self, ε_: Array, σ_: Array, rest_: Array) -> tuple[Array, Array, Array, float]:
        """Those of ε and C₀ε before, of q (m,), and of what is dissipated; rest_ becomes that before."""
        share, gap_s = self.share, self.s_shape - self.s
        added = share * self.slope + share**2 * self.square / 2
        share_ = float(ε_ @ self.gap + σ_ @ self.stressed) + rest_[0] * gap_s * (self.s + share * gap_s)
        gap_s_ = rest_[0] * share * (self.s + share * gap_s)
        s_ = rest_[0] * share * gap_s
        gap_, stressed_ = share * ε_, share * σ_
        strained = float(self.σ_shape @ self.ε_shape)
        is_full, is_empty = self.budget - added > strained, self.budget - added < 0
        strained_ = rest_[2] if is_full else 0.0
        budget_ = 0.0 if is_full or is_empty else rest_[2]
        share_ -= budget_ * (self.slope + share * self.square)
        slope_, square_ = -budget_ * share, -budget_ * share**2 / 2
        if share < 1:  # as far as the budget goes: share slope + share² square/2 is the budget
            steep = self.slope + share * self.square
            by_budget = share_ / steep if steep else 0.0
            budget_, slope_, square_ = (
                budget_ + by_budget, slope_ - share * by_budget, square_ - share**2 / 2 * by_budget
            )  # fmt: skip
        stressed_ = stressed_ + square_ * self.gap + slope_ * self.ε
        gap_ = gap_ + square_ * self.stressed
        gap_s_ += 2 * square_ * gap_s + slope_ * self.s
        s_ += slope_ * gap_s - gap_s_
        y = gap_ + strained_ * self.σ_shape + self.maps.strains.stressed(stressed_ + strained_ * self.ε_shape)
        q_ = self.maps.strains.around(self.q).pulled(y)
        if self.s_shape > 0:
            rest_[1] += gap_s_ / self.s_shape
            q_ = q_ + gap_s_ / self.s_shape * self.slope_left
        if self.s > 0:
            rest_[0] += s_ / self.s
            rest_[1] += s_ / self.s
        rest_[2] = budget_
        return ε_ + slope_ * self.stressed - gap_, σ_ - stressed_, q_, self.maps.h * budget_


def start_pulled_back(maps: LinearlyImplicitMaps, q: Array, after: StateAdjoint) -> tuple[Array, Array]:
    """Derivatives with q and r of a state that is put in, as StrainsCarried.resume goes on from it."""
    size, own = maps.strains.size, after.auxiliary
    ε_, σ_ = own[: 2 * size].reshape(2, -1)
    by_e, by_r = after.state.reshape(2, -1)
    by_q = maps.ω * by_e + maps.strains.around(q).pulled(ε_ + maps.strains.stressed(σ_))
    if not maps.st_venant:
        left, slope_left, _ = maps.left(q)
        left_, c_, _ = own[2 * size + len(q) :][:3]
        grows = 1e-4 * maps.most + 4 * abs(left) < maps.most
        by_q = by_q + (left_ + (math.copysign(4.0, left) * c_ if grows else 0.0)) * slope_left
    return by_q, by_r + own[2 * size : 2 * size + len(q)]
