"""The equations of a step, in its mid-step velocity v̂; the state at its end is x⁺ = x + h v̂.

Midpoint      M (2/h)(v̂ - v) + D_c v̂ + K_s (x + x⁺)/2 + f̂ = force((x + x⁺)/2),   f̂ = ∫ P : ∇δ
Equilibrium   K_s x⁺ + f(x⁺) = force(x⁺)
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fenics_rom.fem.finite_strain.model import Load, Model, times
from fenics_rom.fem.finite_strain.preconditioner import Weights
from fenics_rom.fem.finite_strain.stresses import Stresses, StressesAtRest, StressesInStep

Array = np.ndarray


@dataclass(frozen=True)
class Start:
    """Where a step begins.

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
class Trial:
    """A mid-step velocity, and what is left of the equations with it.

    Attributes:
        v: v̂ (rows here, 1), m/s.
        residual: force that nothing balances yet (rows here, 1), N.
        force: of the load (rows here, 1), N.
        elastic: ∫ P : ∇δ (rows here, 1), N.
        stresses: of the points.
        u: displacements of all nodes (N, 3) that the load is taken at, m.
    """

    v: Array
    residual: Array
    force: Array
    elastic: Array
    stresses: Stresses
    u: Array


class Equation(Protocol):
    """What a step has to solve."""

    h: float
    weights: Weights

    def at(self, v: Array) -> Trial:
        """The equations at a mid-step velocity (rows here, 1)."""

    def changed(self, trial: Trial, dv: Array) -> Array:
        """Minus the change (rows here, 1) of a trial's residual with that of its velocity: the consistent tangent."""

    def terms(self, trial: Trial) -> Array:
        """Forces (rows here, any) that the residual is small against."""


class Midpoint:
    """A step of motion. Arguments: what the body consists of, where it begins, what pushes, and the step h, s."""

    def __init__(self, model: Model, start: Start, load: Load, h: float):
        self._model, self._start, self._load, self.h = model, start, load, h
        self.weights = Weights(mass=2 / h, external_damping=1.0, stiffness=h / 2, viscosity=1.0)
        self._fixed = times(model.spring, start.x)

    def at(self, v: Array) -> Trial:
        """As in Equation."""
        model, start, h = self._model, self._start, self.h
        after = model.everywhere(start.x + h * v)
        middle = (start.u + after) / 2
        stresses = StressesInStep(model.material, start.H, start.E, model.points.gradients(after), h)
        elastic = model.here(model.points.forces(stresses.first))
        force = self._load.force(model, middle)
        resisted = elastic + times(model.external_damping, v) + self._fixed + h / 2 * times(model.spring, v)
        residual = force - resisted - 2 / h * (model.mass @ (v - start.v))
        return Trial(v, residual, force, elastic, stresses, middle)

    def changed(self, trial: Trial, dv: Array) -> Array:
        """As in Equation."""
        model, h = self._model, self.h
        du = h * model.everywhere(dv)
        elastic = model.here(model.points.forces(trial.stresses.changed(model.points.gradients(du))))
        constant = 2 / h * (model.mass @ dv) + times(model.external_damping, dv) + h / 2 * times(model.spring, dv)
        return elastic + constant - self._load.changed(model, trial.u, du / 2)

    def terms(self, trial: Trial) -> Array:
        """As in Equation."""
        return np.hstack([trial.force, trial.elastic, 2 / self.h * (self._model.mass @ self._start.v)])


class Equilibrium:
    """A body at rest under a load, of which a part may be left out: a load that is put on step by step.

    Args:
        model: what the body consists of.
        start: where it is before.
        load: what pushes.
        h: s, in which it moves.
        missing: of the force (rows here, 1), N.
    """

    def __init__(self, model: Model, start: Start, load: Load, h: float, missing: Array):
        self._model, self._start, self._load, self.h, self._missing = model, start, load, h, missing
        self.weights = Weights(mass=0.0, external_damping=0.0, stiffness=h, viscosity=0.0)

    def at(self, v: Array) -> Trial:
        """As in Equation."""
        model, x = self._model, self._start.x + self.h * v
        after = model.everywhere(x)
        stresses = StressesAtRest(model.material, model.points.gradients(after))
        elastic = model.here(model.points.forces(stresses.first))
        force = self._load.force(model, after)
        residual = force - self._missing - elastic - times(model.spring, x)
        return Trial(v, residual, force, elastic, stresses, after)

    def changed(self, trial: Trial, dv: Array) -> Array:
        """As in Equation."""
        model = self._model
        du = self.h * model.everywhere(dv)
        elastic = model.here(model.points.forces(trial.stresses.changed(model.points.gradients(du))))
        return elastic + self.h * times(model.spring, dv) - self._load.changed(model, trial.u, du)

    def terms(self, trial: Trial) -> Array:
        """As in Equation."""
        return np.hstack([trial.force, trial.elastic])
