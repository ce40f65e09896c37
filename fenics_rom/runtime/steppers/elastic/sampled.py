"""Large deformation by a discrete gradient: f̂ = Aᵀ ω Ŝ(E, E⁺) with A = ∂E/∂q in the middle of the step.

Ŝ:(E⁺ - E) is what the points store more. f̂ depends on v̂, so that a step is Newton's method.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import (
    discrete_gradient_slopes,
    discrete_gradient_stress,
    energy_density,
    linear_stress,
    moduli,
)
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.runtime.steppers.elastic.law import ElasticLaw


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
        self.matrix, self._has_slope = np.zeros((m, m)), False

    @property
    def stored(self) -> float:
        """As in ElasticLaw."""
        stored = self._body.energy(self._q)
        return stored if self.branches is None else stored + self.branches.stored

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
        body = self._body
        self._q, self.velocity = q.copy(), r.copy()
        self._E = body.strains(self._q)
        self._W = energy_density(body.law, self._E, body.first_lame, body.shear)
        self._history, self._relaxation = 0.0, 0.0
        if self.branches is not None:
            self._history, self._relaxation = self.branches.pull[1].reshape(6, -1), self.branches.stiffening_time
        (self.at if self._has_slope else self.renew)(self.velocity)

    def expect(self, v: Array) -> None:
        """As in ElasticLaw."""
        self.at(v)

    def at(self, v: Array) -> None:
        """As in ElasticLaw."""
        body, h, E = self._body, self._h, self._E
        middle = self._q + h / 2 * v
        H, after = body.displacement_gradients(middle), body.strains(self._q + h * v)
        rates = (after - E) / h
        linear = body.weights * linear_stress(rates, body.first_lame, body.shear)
        S = body.weights * discrete_gradient_stress(body.law, E, after, body.first_lame, body.shear, self._W)
        S += (body.viscosity + self._relaxation) * linear + self._history
        force = body.resultant(H, S) + body.springs.dot(middle) + body.external_damping.dot(v)
        self._found = H, after, rates, linear, S
        self.pull = force - self.matrix.dot(v)

    def renew(self, v: Array) -> None:
        """As in ElasticLaw; without what makes the step's equations indefinite."""
        self.at(v)
        body, h, (H, after, _, _, S) = self._body, self._h, self._found
        force = self.pull + self.matrix.dot(v)
        A, of_end = body.strain_rates(H), body.strain_rates(body.displacement_gradients(self._q + h * v))
        steady = body.external_damping + h / 2 * body.springs
        viscous = (body.viscosity + self._relaxation) * moduli(
            "st_venant_kirchhoff", after, body.first_lame, body.shear
        )
        by_end = next(discrete_gradient_slopes(body.law, self._E, after, body.first_lame, body.shear))
        self.matrix = steady + between(A, body.weights * (h * by_end + viscous), of_end) + h / 2 * body.geometric(S)
        if not is_definite(2 / h * np.eye(len(v)) + (self.matrix + self.matrix.T) / 2):
            D = h / 2 * moduli(body.law, (self._E + after) / 2, body.first_lame, body.shear) + viscous
            self.matrix = steady + between(A, body.weights * D, A)
        self.pull, self._has_slope = force - self.matrix.dot(v), True

    def close(self, v: Array, after: Array) -> float:
        """As in ElasticLaw."""
        body, h = self._body, self._h
        _, _, rates, linear, _ = self._found
        self._q_before, self._q = self._q, after
        self.velocity = v
        heat = h * float(v.dot(body.external_damping.dot(v)))
        heat += h * float(body.viscosity.dot((linear * rates).sum(axis=0)))
        return heat if self.branches is None else heat + self.branches.step(np.stack([rates, linear]).reshape(2, -1))


def between(left: Array, D: Array, right: Array) -> Array:
    """Σ leftᵀ D right (m, m) over points, of strain rates (6, P, m) and moduli (6, 6, P)."""
    m = left.shape[-1]
    product: Array = left.reshape(-1, m).T.dot(np.einsum("cdp,dpk->cpk", D, right).reshape(-1, m))
    return product


def is_definite(matrix: Array) -> bool:
    """Whether a symmetric matrix (m, m) is positive definite."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True
