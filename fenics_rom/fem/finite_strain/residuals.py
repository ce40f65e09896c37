"""The equations of a step, in its mid-step velocity v̂; the state at its end is x⁺ = x + h v̂.

Motion        r = force((x + x⁺)/2) - M (2/h)(v̂ - v) - D_c v̂ - K_s (x + x⁺)/2 - f̂ = 0,   f̂ = ∫ P : ∇δ
Equilibrium   r = force(x⁺) - K_s x⁺ - f(x⁺) = 0
"""

from dataclasses import dataclass

import numpy as np

from fenics_rom.fem.finite_strain.model import ExternalForce, FiniteStrainModel, multiply
from fenics_rom.fem.finite_strain.preconditioner import TangentCoefficients
from fenics_rom.fem.finite_strain.stresses import EquilibriumStresses, MidpointStresses, Stresses

Array = np.ndarray


@dataclass(frozen=True)
class StepStart:
    """Where a step begins: the state of the body.

    Attributes:
        x, v: displacement and velocity (rows here, 1), m and m/s.
        u: displacements of all nodes (N, 3), m.
        H, E: displacement gradients (3, 3, P here) and Green strains (6, P here).
    """

    x: Array
    v: Array
    u: Array
    H: Array
    E: Array


@dataclass(frozen=True)
class TrialStep:
    """A mid-step velocity, and what is left of the equations with it.

    Attributes:
        v: v̂ (rows here, 1), m/s.
        residual: force that nothing balances yet (rows here, 1), N.
        external_force: of what pushes (rows here, 1), N.
        internal_force: ∫ P : ∇δ (rows here, 1), N.
        stresses: of the points.
        u: displacements of all nodes (N, 3) that the external force is taken at, m.
    """

    v: Array
    residual: Array
    external_force: Array
    internal_force: Array
    stresses: Stresses
    u: Array


class MidpointResidual:
    """Of a step of motion of h, s; `coefficients` are those of the matrix that stands for its tangent."""

    def __init__(self, model: FiniteStrainModel, start: StepStart, external: ExternalForce, h: float):
        self._model, self._start, self._external, self.h = model, start, external, h
        self.coefficients = TangentCoefficients(mass=2 / h, external_damping=1.0, stiffness=h / 2, viscosity=1.0)
        self._spring_force = multiply(model.spring, start.x)  # at the start

    def evaluate(self, v: Array) -> TrialStep:
        """The equations at a mid-step velocity (rows here, 1)."""
        m, start, h = self._model, self._start, self.h
        u_end = m.nodal_field(start.x + h * v)
        u_middle = (start.u + u_end) / 2
        stresses = MidpointStresses(m.material, start.H, start.E, m.points.gradients(u_end), h)
        internal, external = m.internal_force(stresses.P), self._external.at(m, u_middle)
        resisting = internal + multiply(m.external_damping, v) + self._spring_force + h / 2 * multiply(m.spring, v)
        residual = external - resisting - 2 / h * (m.mass @ (v - start.v))
        return TrialStep(v, residual, external, internal, stresses, u_middle)

    def apply_tangent(self, trial: TrialStep, dv: Array) -> Array:
        """-∂r/∂v̂ dv (rows here, 1) at a trial: the product with the consistent tangent."""
        m, h = self._model, self.h
        du = h * m.nodal_field(dv)
        internal = m.internal_force(trial.stresses.jvp(m.points.gradients(du)))
        linear = 2 / h * (m.mass @ dv) + multiply(m.external_damping, dv) + h / 2 * multiply(m.spring, dv)
        return internal + linear - self._external.jvp(m, trial.u, du / 2)

    def terms(self, trial: TrialStep) -> Array:
        """Forces (rows here, any) that the residual is small against."""
        momentum = 2 / self.h * (self._model.mass @ self._start.v)
        return np.hstack([trial.external_force, trial.internal_force, momentum])


class QuasiStaticResidual:
    """As MidpointResidual, of a body at rest, with `missing` of the force (rows here, 1): loads put on step by step."""

    def __init__(self, model: FiniteStrainModel, start: StepStart, external: ExternalForce, h: float, missing: Array):
        self._model, self._start, self._external, self.h, self._missing = model, start, external, h, missing
        self.coefficients = TangentCoefficients(mass=0.0, external_damping=0.0, stiffness=h, viscosity=0.0)

    def evaluate(self, v: Array) -> TrialStep:
        """As in MidpointResidual."""
        m, x_end = self._model, self._start.x + self.h * v
        u_end = m.nodal_field(x_end)
        stresses = EquilibriumStresses(m.material, m.points.gradients(u_end))
        internal, external = m.internal_force(stresses.P), self._external.at(m, u_end)
        residual = external - self._missing - internal - multiply(m.spring, x_end)
        return TrialStep(v, residual, external, internal, stresses, u_end)

    def apply_tangent(self, trial: TrialStep, dv: Array) -> Array:
        """As in MidpointResidual."""
        m = self._model
        du = self.h * m.nodal_field(dv)
        internal = m.internal_force(trial.stresses.jvp(m.points.gradients(du)))
        return internal + self.h * multiply(m.spring, dv) - self._external.jvp(m, trial.u, du)

    def terms(self, trial: TrialStep) -> Array:
        """As in MidpointResidual."""
        return np.hstack([trial.external_force, trial.internal_force])


StepResidual = MidpointResidual | QuasiStaticResidual
