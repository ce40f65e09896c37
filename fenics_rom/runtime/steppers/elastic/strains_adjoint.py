"""Back through a step whose strains are carried along; see carried_strains.py, whose symbols these are.

The step is one linear system around the shape that was expected. Strains are of second degree in q: with
G(z) = ∂(Aᵀz)/∂q, which is symmetric,

    w·Aᵀz owes G(z) w to q and A w to z,    z·A v owes G(z) v to q and Aᵀz to v,
    w·AᵀC₀A v owes G(C₀A v) w + G(C₀A w) v to q.

∂J/∂x is written x_. Carried: [ε, C₀ε, v̂ before, ½ s² - c, c, tank, ½ ε:C₀ε], and the branches of the material.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.viscoelasticity import BranchesAdjoint
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.deformation_maps import Slope, StrainsMaps
from fenics_rom.runtime.steppers.elastic.law import LawOwed


class _Kept(NamedTuple):
    """What is owed after a step to what it began with, as far as that was gone back through."""

    ε_: Array
    σ_: Array
    rest_: Array  # those of ½ s² - c, c and the tank
    b_: Array
    s_: float
    middle_: Array
    w_: Array  # of branches before


class StrainsAdjoint(NamedTuple):
    """A step of StrainsCarried, to go back through; see LawAdjoint."""

    maps: StrainsMaps
    q: Array  # at the start (m,)
    q_after: Array
    v: Array
    expected: Array  # v̂
    carried: Array  # before the step, but for branches
    carried_after: Array
    by_velocity: Array  # of f̂ (m, m)
    branches: BranchesAdjoint | None

    @property
    def by_shape(self) -> Array:
        """As in LawAdjoint: where the middle stays, to which `before` has what is owed."""
        return self.maps.body.springs

    @property
    def velocity_before(self) -> Array:
        """v̂ (m,) of the step before."""
        size = self.maps.strains.size
        return self.carried[2 * size : -4]

    @property
    def _middle(self) -> Array:
        return self.q + self.maps.h / 2 * self.expected

    def _slope(self) -> tuple[Slope | None, Array, float, float]:
        """That of s in the middle, if there is s: b, s, and c."""
        rest, c = self.carried[-4:-2].tolist()
        if self.maps.st_venant:
            return None, np.zeros(len(self.q)), 0.0, c
        slope = Slope.at_shape(self.maps, self._middle, c)
        return slope, slope.b, math.sqrt(2 * max(rest + slope.c, 0.0)), slope.c

    def after(self, carried: Array, energy: float) -> LawOwed:
        """As in LawAdjoint."""
        maps, v, size, own = self.maps, self.v, self.maps.strains.size, len(self.carried)
        strains, body, h = maps.strains, maps.body, maps.h
        ε_after, σ_after = self.carried_after[: 2 * size].reshape(2, -1)
        ε_, σ_ = carried[: 2 * size].reshape(2, -1) + energy / 2 * np.stack([σ_after, ε_after])
        rest_ = carried[own - 4 : own - 1] + np.array([energy, 0.0, 0.0])
        v_, w_ = carried[2 * size : own - 4].copy(), NONE
        slope, b, s, c = self._slope()
        around = strains.around(self._middle)
        rates = around.rates(v)
        if self.branches is not None:
            w_ = self.branches.owed(carried[own:], energy)
        taken = _TakenBack.of(self, rates, (b, s, c))
        ε_, σ_, q_back, heat_, w_ = taken.pull_back(ε_, σ_, rest_, w_)
        strained_ = h * (ε_ + strains.stressed(σ_)) + 2 * heat_ * strains.viscosity * strains.stressed(rates)
        if self.branches is not None:
            w_, (of_rate, of_stress) = self.branches.back(w_, heat_ / h, taken.rates)
            strained_ = strained_ + of_rate + strains.stressed(of_stress)
        v_ = v_ + around.pulled(strained_) + 2 * heat_ * (body.external_damping @ v)
        middle_, b_, s_ = strains.geometric(strained_) @ v, np.zeros(len(v)), 0.0
        if maps.volumes is not None:
            volumes = maps.volumes.around(self._middle)
            v_ = v_ + 2 * heat_ * volumes.force(v)
            middle_ = middle_ + heat_ * volumes.form_back(v, v)
        if slope is not None:
            grown = h * float(b @ v)
            s_ = rest_[0] * grown
            b_ = h * rest_[0] * (s + grown) * v
            v_ = v_ + h * rest_[0] * (s + grown) * b
        end = energy * (body.springs @ self.q_after) + q_back
        return LawOwed(end, 0 * end, v_, _Kept(ε_, σ_, rest_, b_, s_, middle_, w_))

    def before(self, y: Array, owed: LawOwed) -> tuple[Array, Array, Array]:
        """As in LawAdjoint."""
        maps, v, size, (ε_, σ_, rest_, b_, s_, middle_, w_) = self.maps, self.v, self.maps.strains.size, owed.kept
        strains, h, around = maps.strains, maps.h, maps.strains.around(self._middle)
        slope, b, s, _ = self._slope()
        scale, strained = h / 2 + strains.viscosity + maps.stiffening_time, around.rates(y)
        σ = self.carried[size : 2 * size]
        if self.branches is not None:
            σ = σ + self.branches.pull[1]
            w_ = w_ - self.branches.pulled_back(np.stack([0 * strained, strained]))
        middle_ = middle_ - strains.geometric(σ + strains.stressed(scale * around.rates(v))) @ y
        middle_ -= strains.geometric(strains.stressed(scale * strained)) @ v
        if maps.volumes is not None:
            middle_ -= maps.volumes.around(self._middle).form_back(y, v)
        if slope is not None:
            b_ = b_ - h / 2 * (y * float(b @ v) + v * float(b @ y)) - s * y
            by_s = (s_ - float(b @ y)) / s if s > 0 else 0.0
            rest_[0] += by_s
            by_middle, rest_[1] = slope.pull_back(b_, rest_[1] + by_s)
            middle_ = middle_ + by_middle
        own = np.concatenate([ε_, σ_ - strained, np.zeros(len(v)), rest_, [0.0], w_.ravel()])
        return own, middle_, h / 2 * middle_

    def with_velocity(self, carried: Array, v_: Array) -> Array:
        """As in LawAdjoint."""
        size = self.maps.strains.size
        carried = carried.copy()
        carried[2 * size : 2 * size + len(v_)] += v_
        return carried

    def by_model(self, y: Array, owed: LawOwed) -> tuple[Array, Array]:
        """As in LawAdjoint: nothing."""
        return NONE, NONE

    def expected_back(self, w: Array, v_: Array, tangent_: Array, *, made_tangent: bool) -> tuple[Array, Array, Array]:
        """What the force and the tangent that were found ahead of the step owe to what is carried, to q, and to T.

        Args:
            w: that f̂ at v̂ of the step before is owed (m,).
            v_: that this v̂ is owed besides (m,).
            tangent_: that the tangent is owed, by this step and later ones (m, m).
            made_tangent: whether it was made in this step; else it is of an earlier one, and owed on.
        """
        maps, size = self.maps, self.maps.strains.size
        strains, body, h, time = maps.strains, maps.body, maps.h, maps.stiffening_time
        v = self.velocity_before
        middle = self.q + h / 2 * v
        around, at = strains.around(middle), None if maps.st_venant else maps.material(middle)
        σ = strains.stressed(around.damped(v, time, maps.st_venant))
        pull = 0.0 if self.branches is None else self.branches.pull[1]
        σ_ = around.rates(w)
        pull_, middle_ = σ_, strains.geometric(σ + pull) @ w
        if maps.volumes is not None:
            volumes = maps.volumes.around(middle)
            v_, middle_ = v_ + volumes.force(w), middle_ + volumes.form_back(w, v)
        if made_tangent:
            of_σ, of_middle, of_v = self._tangent_back(tangent_, middle, σ + pull)
            σ_, pull_, middle_, v_, tangent_ = σ_ + of_σ, pull_ + of_σ, middle_ + of_middle, v_ + of_v, NONE
        if at is not None:
            middle_ = middle_ + maps.stiffened(at, w)
        ε_ = strains.stressed(σ_)
        rates_ = (strains.viscosity + time) * ε_
        middle_ = middle_ + strains.geometric(rates_) @ v
        if maps.st_venant:
            middle_ = middle_ + around.pulled(ε_)
        v_ = v_ + maps.steady @ w + around.pulled(rates_) + h / 2 * middle_
        own = np.concatenate([np.zeros(2 * size), v_, np.zeros(4)])
        if self.branches is not None:
            own = np.concatenate([own, self.branches.pulled_back(np.stack([0 * pull_, pull_])).ravel()])
        return own, middle_ + body.springs @ w, tangent_

    def _tangent_back(self, N: Array, middle: Array, σ: Array) -> tuple[Array, Array, Array]:
        """What the tangent, which is owed N, owes to σ, and to the middle and v̂ of the step before (m,)."""
        maps, m = self.maps, len(middle)
        body, strains, h, N = maps.body, maps.strains, maps.h, (N + N.T) / 2
        at, around = None if maps.st_venant else maps.material(middle), strains.around(middle)
        A = np.stack([around.rates(unit) for unit in np.eye(m)], axis=1)
        strained = ((h / 2 + strains.viscosity + maps.stiffening_time) * A.T).T @ N
        rows = [strains.geometric(strains.stressed(column))[k] for k, column in enumerate(strained.T)]
        middle_ = 2 * np.sum(rows, axis=0)
        geometric, v_ = strains.geometric(σ) + (0.0 if at is None else body.geometric(at.S)), np.zeros(m)
        stiff = maps.steady + around.stiffness(h / 2 + maps.stiffening_time)
        volumes = None if maps.volumes is None else maps.volumes.around(middle)
        if volumes is not None:
            stiff, middle_ = stiff + volumes.matrix, middle_ + volumes.matrix_back(N)
            geometric = geometric + body.geometric(volumes.stress(self.velocity_before))
        if not is_definite(2 / h * np.eye(m) + stiff + h / 2 * geometric):
            return np.zeros(strains.size), middle_, v_
        if volumes is not None:
            of_middle, v_ = volumes.stress_back(h / 2 * body.geometric_back(N), self.velocity_before)
            middle_ = middle_ + of_middle
        if at is not None:
            of_strains = h / 2 * body.geometric_back(N)
            dS = body.material.stress_change(at.E, of_strains)  # D is symmetric
            middle_ = middle_ + body.resultant(at.H, body.weights * dS)
        return h / 2 * strains.geometric_back(N), middle_, v_


def start_back(maps: StrainsMaps, q: Array, own: Array) -> tuple[Array, Array]:
    """What is owed to q and r (m,) where a state is put in, by what is carried along then."""
    size, m = maps.strains.size, len(q)
    ε_, σ_ = own[: 2 * size].reshape(2, -1)
    by_q = maps.strains.around(q).pulled(ε_ + maps.strains.stressed(σ_))
    if not maps.st_venant:
        left, slope_left, _ = maps.left(q)
        left_, c_, _ = own[2 * size + m :][:3]
        grows = 1e-4 * maps.most + 4 * abs(left) < maps.most
        by_q = by_q + (left_ + (math.copysign(4.0, left) * c_ if grows else 0.0)) * slope_left
    return by_q, own[2 * size : 2 * size + m]


class _TakenBack(NamedTuple):
    """How strains and s are moved towards those of the shape, at the end of a step."""

    maps: StrainsMaps
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
    rates: Array  # A v̂, and C₀ times it
    ratios: Array  # g (N,) of branches
    branches: Array  # (N, 2, size), before they are moved

    @staticmethod
    def of(step: StrainsAdjoint, rates: Array, around: tuple[Array, float, float]) -> "_TakenBack":
        """Of a step with strain rates A v̂; `around`: b, s and c in it."""
        maps, (b, s, c), carried, q, v = step.maps, around, step.carried, step.q_after, step.v
        strains, h, size = maps.strains, maps.h, maps.strains.size
        stress_rates = strains.stressed(rates)
        ε, σ = carried[:size] + h * rates, carried[size : 2 * size] + h * stress_rates
        drawn = h * float(v @ maps.body.external_damping @ v + (strains.viscosity * stress_rates) @ rates)
        if maps.volumes is not None:
            drawn += h * float(v @ maps.volumes.around(step._middle).force(v))
        both, ratios, branches = np.stack([rates, stress_rates]), np.empty(0), np.empty((0, 2, size))
        if step.branches is not None:
            ratios, (branches, of_branches) = step.branches.ratios, step.branches.stepped(both)
            drawn += of_branches
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
        slope += float((ratios[:, None] * branches[:, 1] * gap).sum())
        square += float(ratios.sum() * (stressed @ gap))
        budget, share = float(carried[-2]) + drawn, 1.0
        if slope + square / 2 > budget and square > 0:
            root = math.sqrt(max(slope**2 + 2 * square * budget, 0.0))
            share = min(2 * budget / (slope + root) if slope > 0 else (root - slope) / square, 1.0)
        return _TakenBack(
            maps,
            q,
            ε,
            gap,
            stressed,
            ε_shape,
            σ_shape,
            s,
            s_shape,
            slope_left,
            square,
            slope,
            budget,
            share,
            both,
            ratios,
            branches,
        )

    def pull_back(self, ε_: Array, σ_: Array, rest_: Array, w_: Array) -> tuple[Array, Array, Array, float, Array]:
        """Those of ε and C₀ε before, of q (m,), of what is dissipated, and of branches; rest_ becomes that before."""
        share, gap_s = self.share, self.s_shape - self.s
        added = share * self.slope + share**2 * self.square / 2
        share_ = float(ε_ @ self.gap + σ_ @ self.stressed) + rest_[0] * gap_s * (self.s + share * gap_s)
        gap_s_ = rest_[0] * share * (self.s + share * gap_s)
        s_ = rest_[0] * share * gap_s
        gap_, stressed_ = share * ε_, share * σ_
        if len(self.ratios):
            moved_ = w_.sum(axis=0)
            share_ += float(moved_[0] @ self.gap + moved_[1] @ self.stressed)
            gap_, stressed_ = gap_ + share * moved_[0], stressed_ + share * moved_[1]
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
        all_of = 1.0 + float(self.ratios.sum())
        stressed_ = stressed_ + all_of * square_ * self.gap + slope_ * self.ε
        gap_ = gap_ + all_of * square_ * self.stressed
        if len(self.ratios):
            gap_ = gap_ + slope_ * (self.ratios[:, None] * self.branches[:, 1]).sum(axis=0)
            w_ = w_.copy()
            w_[:, 1] += slope_ * self.ratios[:, None] * self.gap
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
        return ε_ + slope_ * self.stressed - gap_, σ_ - stressed_, q_, self.maps.h * budget_, w_
