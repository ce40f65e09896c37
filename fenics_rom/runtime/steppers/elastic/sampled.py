"""Large deformation by a discrete gradient: f̂ = Aᵀ ω Ŝ(E, E⁺) with A = ∂E/∂q in the middle of the step.

Ŝ:(E⁺ - E) is what the points store more. f̂ depends on v̂, so that a step is Newton's method.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.viscoelasticity import BranchesAdjoint, MaxwellBranches
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw, LawOwed


class Found(NamedTuple):
    """Of the points in a step at a velocity."""

    H: Array  # (3, 3, P) in its middle
    after: Array  # strains (6, P) at its end
    rates: Array  # of strains (6, P), 1/s
    linear: Array  # their stresses of small strains, with the weights,
    viscous: Array  # and those of viscosity, but for β
    S: Array  # (6, P) stresses with the weights


class SampledPoints(ElasticLaw):
    """As in ElasticLaw, of the points of a body.

    Args:
        body: its points.
        branches: how their material relaxes, in strains E of the points and their stresses; None: it does not.
    """

    is_exact = False

    def __init__(self, body: ReducedDeformation, branches: MaxwellBranches | None = None):
        self._body, self.branches, m = body, branches, body.order
        self.velocity = self.pull = self._q = self._q_before = np.zeros(m)
        self.matrix, self._has_slope, self.round_off = np.zeros((m, m)), False, body.round_off

    @property
    def stored(self) -> float:
        """As in ElasticLaw."""
        q = self._q
        stored = self.energy_of_points + float(q @ self._body.springs @ q) / 2
        return stored if self.branches is None else stored + self.branches.stored

    @property
    def energy_of_points(self) -> float:
        """J."""
        return self._body.elastic_energy(self._body.strains(self._q))

    @property
    def auxiliary(self) -> Array:
        """As in ElasticLaw."""
        return np.empty(0) if self.branches is None else self.branches.state.ravel()

    def set_time_step(self, h: float) -> None:
        """As in ElasticLaw."""
        self._h, self._has_slope = h, False
        if self.branches is not None:
            self.branches.set_time_step(h)

    def reset_buffer(self) -> None:
        """As in ElasticLaw: forgets the slope."""
        self._has_slope = False

    def resume(self, q: Array, r: Array, auxiliary: Array) -> None:
        """As in ElasticLaw."""
        self._q = self._q_before = q.copy()
        self.velocity, self._has_slope = r.copy(), False
        if self.branches is not None:
            self.branches.resume(auxiliary)

    def rollback(self) -> None:
        """As in ElasticLaw."""
        self._q, self._has_slope = self._q_before, False
        if self.branches is not None:
            self.branches.rollback()

    def open(self, q: Array, r: Array) -> None:
        """As in ElasticLaw."""
        self.velocity = r.copy()
        self.begin(q)
        (self.at if self._has_slope else self.renew)(self.velocity)

    @contextmanager
    def in_parts(self, parts: int) -> Iterator[None]:
        """As in ElasticLaw."""
        h, q = self._h, self._q
        self._h, self._has_slope = h / parts, self._has_slope and parts == 1
        try:
            with nullcontext() if self.branches is None else self.branches.in_parts(parts):
                yield
        except BaseException:
            self._q, self._has_slope = q, False
            raise
        finally:
            self._h, self._has_slope, self._q_before = h, self._has_slope and parts == 1, q

    def begin(self, q: Array) -> None:
        """Begins a step from q (m,), without finding anything at a velocity."""
        body, self._q = self._body, q.copy()
        self._E, self._found_at = body.strains(self._q), np.empty(0)
        self._W = body.material.energy_density(self._E)
        self._history, self._relaxation = 0.0, 0.0
        if self.branches is not None:
            self._history, self._relaxation = self.branches.pull[1].reshape(6, -1), self.branches.stiffening_time

    def force(self, v: Array) -> Array:
        """f̂ (m,) at v (m,)."""
        body, h, E = self._body, self._h, self._E
        middle = self._q + h / 2 * v
        H, after = body.displacement_gradients(middle), body.strains(self._q + h * v)
        rates = (after - E) / h
        of_rates = self._stresses_of(rates, after)
        S = body.weights * body.material.discrete_gradient_stress(E, after, self._W)
        S += self._relaxation * of_rates[0] + body.viscosity * of_rates[1] + self._history
        self._found, self._found_at = Found(H, after, rates, *of_rates, S), v.copy()
        self._force: Array = body.resultant(H, S) + body.springs.dot(middle) + body.external_damping.dot(v)
        return self._force

    def _stresses_of(self, rates: Array, after: Array) -> tuple[Array, Array]:
        """C₀Ė and what is viscous (6, P) of strain rates (6, P) that lead to strains (6, P), with the weights."""
        body = self._body
        linear = body.material.linear_stress(rates)
        viscous = body.material.viscous_stress((self._E + after) / 2, rates, linear)
        return body.weights * linear, body.weights * viscous

    def slope(self, v: Array, *, is_exact: bool) -> tuple[Array, Array]:
        """∂f̂/∂v̂ in two parts (m, m), at the v (m,) of the last `force`: of strains, and of their stresses that turn.

        The first is symmetric, definite and near it unless it is to be exact.
        """
        body, h, (H, after, rates, _, _, S) = self._body, self._h, self._found
        steady, material = body.external_damping + h / 2 * body.springs, body.material
        by_rates, by_strain = material.viscous_slopes((self._E + after) / 2, rates)
        viscous = body.viscosity * by_rates + self._relaxation * material.linear_moduli
        A = body.strain_rates(H)
        if is_exact:
            of_end = next(material.discrete_gradient_slopes(self._E, after)) + body.viscosity / 2 * by_strain
            A_end = body.strain_rates(body.displacement_gradients(self._q + h * v))
            strained = _between(A, body.weights * (h * of_end + viscous), A_end)
        else:
            mean = h / 2 * material.moduli((self._E + after) / 2)
            strained = _between(A, body.weights * (mean + viscous), A)
        return steady + strained, h / 2 * body.geometric(S)

    def at(self, v: Array) -> None:
        """As in ElasticLaw."""
        self.pull = self.force(v) - self.matrix.dot(v)

    def renew(self, v: Array) -> None:
        """As in ElasticLaw; without what makes the step's equations indefinite."""
        force = self._force if np.array_equal(v, self._found_at) else self.force(v)
        strained, turned = self.slope(v, is_exact=True)
        self.matrix = strained + turned
        if not is_definite(2 / self._h * np.eye(len(v)) + (self.matrix + self.matrix.T) / 2):
            self.matrix, _ = self.slope(v, is_exact=False)
        self.pull, self._has_slope = force - self.matrix.dot(v), True

    def close(self, v: Array, after: Array) -> float:
        """As in ElasticLaw."""
        if not np.array_equal(v, self._found_at):  # it was corrected after the last force
            strains = self._body.strains(after)
            rates = (strains - self._E) / self._h
            linear, viscous = self._stresses_of(rates, strains)
            self._found = self._found._replace(rates=rates, linear=linear, viscous=viscous)
        self._q_before, self._q = self._q, after
        self.velocity = v
        return self.heat(v)

    def heat(self, v: Array) -> float:
        """What a step with v (m,), that of the last `force`, dissipates, J; branches take it."""
        body, h, (_, _, rates, linear, viscous, _) = self._body, self._h, self._found
        heat = h * float(v.dot(body.external_damping.dot(v)))
        heat += h * float(body.viscosity.dot((viscous * rates).sum(axis=0)))
        return heat if self.branches is None else heat + self.branches.step(np.stack([rates, linear]).reshape(2, -1))

    @property
    def carried(self) -> Array:
        """What steps go on from, (m,): another array after each."""
        return self._q

    def took(self, after: Array, v: Array, relaxed: Array) -> None:
        """Takes note of a step with v (m,) to q⁺ (m,) that a compiled function took, and of branches (N, 2, 6 P)."""
        self._q_before, self._q, self.velocity, self._has_slope = self._q, after, v.copy(), False
        if self.branches is not None:
            self.branches.took(relaxed.copy())

    def adjoint(self) -> "SampledAdjoint":
        """As in ElasticLaw."""
        branches = None if self.branches is None else self.branches.adjoint()
        return SampledAdjoint.of(self._body, self._h, self._q_before, self.velocity, branches)


class SampledAdjoint(NamedTuple):
    """A step of h s from q with v̂, to go back through."""

    body: ReducedDeformation
    h: float
    by_velocity: Array
    by_shape: Array
    q_after: Array
    rates: tuple[Array, Array]  # ∂E/∂q (6P, m) at both ends; of a material that relaxes
    middle: Array  # the same in the middle
    branches: BranchesAdjoint | None

    @staticmethod
    def of(
        body: ReducedDeformation, h: float, q: Array, v: Array, branches: BranchesAdjoint | None
    ) -> "SampledAdjoint":
        """With the slopes of f̂."""
        m, relaxation = len(q), 0.0 if branches is None else branches.stiffening_time
        H, H_start, H_end = (body.displacement_gradients(at) for at in (q + h / 2 * v, q, q + h * v))
        E, E_end, material = strain(H_start), strain(H_end), body.material
        mean, rates, β = (E + E_end) / 2, (E_end - E) / h, body.viscosity
        by_rates, by_strain = material.viscous_slopes(mean, rates)
        viscous, by_strain = (β * by_rates + relaxation * material.linear_moduli) / h, β / 2 * by_strain
        linear = material.linear_stress(rates)
        S = material.discrete_gradient_stress(E, E_end) + β * material.viscous_stress(mean, rates, linear)
        S = body.weights * (S + relaxation * linear)
        if branches is not None:
            S = S + branches.pull[1].reshape(6, -1)
        A, A_start, A_end = (body.strain_rates(at).reshape(-1, m) for at in (H, H_start, H_end))
        of_end, of_start = material.discrete_gradient_slopes(E, E_end)
        by_start, by_end = (
            A.T @ np.einsum("cdp,dpk->cpk", body.weights * slope, at.reshape(6, -1, m)).reshape(-1, m)
            for slope, at in ((of_start + by_strain - viscous, A_start), (of_end + by_strain + viscous, A_end))
        )
        turned = body.springs + body.geometric(S)
        by_velocity, kept = body.external_damping + h / 2 * turned + h * by_end, (NONE, NONE, NONE)
        if branches is not None:
            kept = A_start, A_end, A
        return SampledAdjoint(body, h, by_velocity, turned + by_start + by_end, q + h * v, kept[:2], kept[2], branches)

    def after(self, carried: Array, energy: float) -> LawOwed:
        """As in LawAdjoint."""
        end = energy * self.body.force(self.q_after) if energy else np.zeros(len(self.q_after))
        if self.branches is None:
            return LawOwed(end, 0 * end, 0 * end, NONE)
        body, (by_start, by_end) = self.body, self.rates
        w_, (of_strain, of_stress) = self.branches.after(carried, energy)
        of_stress = body.weights * body.material.linear_stress(of_stress.reshape(6, -1))
        rates_ = (of_strain + of_stress.ravel()) / self.h
        return LawOwed(end + rates_ @ by_end, -rates_ @ by_start, 0 * end, w_)

    def before(self, y: Array, owed: LawOwed) -> tuple[Array, Array, Array]:
        """As in LawAdjoint."""
        if self.branches is None:
            return NONE, np.zeros(len(y)), NONE
        pulled = self.middle @ y
        w_ = owed.kept - self.branches.pulled_back(np.stack([0 * pulled, pulled]))
        return w_.ravel(), np.zeros(len(y)), NONE

    def with_velocity(self, carried: Array, v_: Array) -> Array:
        """As in LawAdjoint: it is not carried."""
        return carried

    def by_model(self, y: Array, owed: LawOwed) -> tuple[Array, Array]:
        """As in LawAdjoint: nothing."""
        return NONE, NONE


def _between(left: Array, D: Array, right: Array) -> Array:
    """Σ leftᵀ D right (m, m) over points, of strain rates (6, P, m) and moduli (6, 6, P)."""
    m = left.shape[-1]
    product: Array = left.reshape(-1, m).T.dot(np.einsum("cdp,dpk->cpk", D, right).reshape(-1, m))
    return product
