"""The equations of a step, in its mid-step velocity v̂; the state at its end is x⁺ = x + h v̂.

Motion        r = force((x + x⁺)/2) - M (2/h)(v̂ - v) - D_c v̂ - K_s (x + x⁺)/2 - f̂ = 0,   f̂ = ∫ P : ∇δ
Equilibrium   r = force(x⁺) - K_s x⁺ - f(x⁺) = 0

Strokes s that are given as s* are to move at the rates c, Bᵀv̂ = c in motion, with B of the middle of the step, and
(s(x⁺) - s(x))/h = (s* - s(x))/h towards an equilibrium; see mechanics.actuator_forces.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.carried_terms import CarriedTerms
from fenics_rom.fem.finite_strain.model import ExternalForce, FiniteStrainModel, multiply
from fenics_rom.fem.finite_strain.stresses import EquilibriumStresses, MidpointStresses, Stresses
from fenics_rom.fem.finite_strain.tangent_matrix import TangentCoefficients, TangentMatrix
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.gas import Targets
from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.system.protocols import Algebra

NONE_FOUND = np.empty(0)


@dataclass(frozen=True)
class StepStart:
    """Where a step begins: the state of the body.

    Attributes:
        x, v: displacement and velocity (rows here, 1), m and m/s.
        u: displacements of all nodes (N, 3), m.
        H, E: displacement gradients (3, 3, P here) and Green strains (6, P here).
        W: stored energy density (P here,), J/m³.
    """

    x: Array
    v: Array
    u: Array
    H: Array
    E: Array
    W: Array

    @classmethod
    def at(cls, model: FiniteStrainModel, x: Array, v: Array, H: Array | None = None) -> "StepStart":
        """Where x and v (rows here, 1) are, of which H may be known; every rank must call it."""
        u = model.nodal_field(x)
        H = model.points.gradients(u) if H is None else H
        E = strain(H)
        return cls(x, v, u, H, E, model.material.energy_density(E))


@dataclass(frozen=True)
class TrialStep:
    """A mid-step velocity, and what is left of the equations with it.

    Attributes:
        v: v̂ (rows here, 1), m/s.
        residual: force that nothing balances yet (rows here, 1), N.
        external: what pushes.
        external_force: of it (rows here, 1), N.
        internal_force: ∫ P : ∇δ (rows here, 1), N.
        stresses: of the points.
        u: displacements of all nodes (N, 3) that the external force is taken at, m.
    """

    v: Array
    residual: Array
    external: ExternalForce
    external_force: Array
    internal_force: Array
    stresses: Stresses
    u: Array


class InnerDrag:
    """External damping of a body that nothing holds: of how it moves in its frame alone.

    With the rigid motions T of the moved body, and G that tells how much of each is in a velocity, GᵀT = 1, it is

        (1 - G Tᵀ) D_c (1 - T Gᵀ) v

    so that it takes nothing of the momenta.

    Args:
        damping: D_c.
        motions: T (rows here, 6) at displacements (rows here, 1).
        shares: (rows here, 6) that span G.
        algebra: of the rows.
    """

    def __init__(self, damping: PetscMatrix, motions: Callable[[Array], Array], shares: Array, algebra: Algebra):
        self._D, self._motions, self._shares, self._inner = damping, motions, shares, algebra.inner

    def force(self, x: Array, v: Array) -> Array:
        """(rows here, 1), N, at displacements and velocities (rows here, 1)."""
        T, inner = self._motions(x), self._inner
        G = self._shares @ np.linalg.inv(inner(T, self._shares))
        drag = self._D @ (v - T @ inner(G, v))
        force: Array = drag - G @ inner(T, drag)
        return force


class InFrame(NamedTuple):
    """What a moving frame changes of the equations of a step."""

    drag: InnerDrag | None = None  # in the place of D_c
    carried: CarriedTerms | None = None  # what comes on top


class MidpointResidual:
    """Of a step of motion of h, s; `coefficients` are those of the matrix that stands for its tangent.

    Branches of a material that relaxes know the length of the step, and are as they are before it.

    `matrix` has what of it is linear, 2/h M + D_c + h/2 K_s, beside what a frame that moves makes of it.
    """

    is_quasi_static = False

    def __init__(
        self,
        model: FiniteStrainModel,
        start: StepStart,
        external: ExternalForce,
        h: float,
        matrix: TangentMatrix,
        branches: MaxwellBranches | None = None,
        in_frame: "InFrame | None" = None,
    ):
        self.model, self.start, self.external, self.h, self._branches = model, start, external, h, branches
        self._drag, self._carried = in_frame or InFrame()
        relaxation = 0.0 if branches is None else branches.stiffening_time
        self.coefficients = TangentCoefficients(2 / h, 1.0, stiffness=h / 2, viscosity=1.0, relaxation=relaxation)
        self._linear = matrix.linear_part(self.coefficients)
        self._momentum = 2 / h * (model.mass @ start.v)
        self._at_start = self._momentum - multiply(model.spring, start.x)
        if self._carried is not None:
            self._at_start = self._at_start - self._carried.constant

    def evaluate(self, v: Array, found: Array = NONE_FOUND) -> TrialStep:
        """The equations at a mid-step velocity (rows here, 1), with forces (n,) of actuators that are found."""
        m, start, h, pushes = self.model, self.start, self.h, self.external.with_found(found)
        u_end = m.nodal_field(start.x + h * v)
        u_middle = (start.u + u_end) / 2
        stresses = MidpointStresses(m.material, start.H, start.E, start.W, m.points.gradients(u_end), h, self._branches)
        internal, external = m.internal_force(stresses.P), pushes.at(m, u_middle)
        residual = external + self._at_start - internal - self._resisted(v, v)
        return TrialStep(v, residual, pushes, external, internal, stresses, u_middle)

    def dragged(self, v: Array) -> Array:
        """Force of external damping (rows here, 1), N, at velocities (rows here, 1); but for ties of a carried body."""
        if self._carried is not None:
            return multiply(self.model.inner_damping, v)
        drag = multiply(self.model.external_damping, v)
        if self._drag is None:
            return drag
        return drag - multiply(self.model.inner_damping, v) + self._drag.force(self.start.x + self.h / 2 * v, v)

    def _resisted(self, v: Array, change: Array) -> Array:
        """What resists a change (rows here, 1) of the mid-step velocity v (rows here, 1), but for stresses, N."""
        linear = self._linear @ change
        if self._carried is not None:
            linear = linear + self._carried.force(change)
        if self._drag is None:
            return linear
        inner = self._drag.force(self.start.x + self.h / 2 * v, change)
        return linear + inner - multiply(self.model.inner_damping, change)

    def apply_tangent(self, trial: TrialStep, dv: Array) -> Array:
        """-∂r/∂v̂ dv (rows here, 1) at a trial: the product with the consistent tangent."""
        m, h = self.model, self.h
        du = h * m.nodal_field(dv)
        internal = m.internal_force(trial.stresses.jvp(m.points.gradients(du)))
        return internal + self._resisted(trial.v, dv) - trial.external.jvp(m, trial.u, du / 2)

    def strokes(self, v: Array) -> tuple[Array, Array, Array]:
        """Of what is found, at a mid-step velocity (rows here, 1).

        Columns B (rows here, n), rates (n,) of strokes, and angles (n,) by which tendons turn at guides, rad.
        """
        end, external = self.model.nodal_field(self.start.x + self.h * v), self.external
        middle = (self.start.u + end) / 2
        columns = external.columns(self.model, middle)
        return columns, self.model.algebra.inner(columns, v)[:, 0], external.angles(middle)

    def targets(self, actuators: ActuatorForces, given: Array) -> Targets:
        """What strokes are to do where some (n,) are given."""
        columns, strokes = self.external.columns(self.model, self.start.u), self.external.strokes(self.start.u)
        return actuators.targets(given, strokes, self.model.algebra.inner(columns, self.start.v)[:, 0], self.h)

    def terms(self, trial: TrialStep) -> Array:
        """Forces (rows here, any) that the residual is small against."""
        return np.hstack([trial.external_force, trial.internal_force, self._momentum])


class QuasiStaticResidual:
    """As MidpointResidual, of a body at rest, with `missing` of the force (rows here, 1): loads put on step by step."""

    is_quasi_static = True

    def __init__(self, model: FiniteStrainModel, start: StepStart, external: ExternalForce, h: float, missing: Array):
        self.model, self.start, self.external, self.h, self._missing = model, start, external, h, missing
        self.coefficients = TangentCoefficients(mass=0.0, external_damping=0.0, stiffness=h, viscosity=0.0)

    def evaluate(self, v: Array, found: Array = NONE_FOUND) -> TrialStep:
        """As in MidpointResidual."""
        m, x_end, pushes = self.model, self.start.x + self.h * v, self.external.with_found(found)
        u_end = m.nodal_field(x_end)
        stresses = EquilibriumStresses(m.material, m.points.gradients(u_end))
        internal, external = m.internal_force(stresses.P), pushes.at(m, u_end)
        residual = external - self._missing - internal - multiply(m.spring, x_end)
        return TrialStep(v, residual, pushes, external, internal, stresses, u_end)

    def elastic_force(self, trial: TrialStep) -> Array:
        """Of the body and its springs, at a trial (rows here, 1), N."""
        return trial.internal_force + multiply(self.model.spring, self.start.x + self.h * trial.v)

    def apply_tangent(self, trial: TrialStep, dv: Array) -> Array:
        """As in MidpointResidual."""
        m = self.model
        du = self.h * m.nodal_field(dv)
        internal = m.internal_force(trial.stresses.jvp(m.points.gradients(du)))
        return internal + self.h * multiply(m.spring, dv) - trial.external.jvp(m, trial.u, du)

    def strokes(self, v: Array) -> tuple[Array, Array, Array]:
        """As in MidpointResidual; of guides rates are those that friction does work along."""
        end, external = self.model.nodal_field(self.start.x + self.h * v), self.external
        columns, angles = external.columns(self.model, end), external.angles(end)
        rates, given = self.model.algebra.inner(columns, v)[:, 0], slice(len(external.found) - external.guides)
        rates[given] = (external.strokes(end) - external.strokes(self.start.u))[given] / self.h
        return columns, rates, angles

    def targets(self, actuators: ActuatorForces, given: Array) -> Targets:
        """As in MidpointResidual."""
        return actuators.resting_targets(given, self.external.strokes(self.start.u), self.h)

    def terms(self, trial: TrialStep) -> Array:
        """As in MidpointResidual."""
        return np.hstack([trial.external_force, trial.internal_force])


StepResidual = MidpointResidual | QuasiStaticResidual
