"""Newton's method for an equilibrium of a body whose chambers are held by their volumes or their gas.

With columns B of unit pressures z, a step solves

    [K -B; Bᵀ G] (Δv, Δz) = (r, what strokes lack),    Δv = K⁻¹ (r + B Δz)

with the consistent tangent K at these pressures, and G what gas gives way by. K loses its definiteness where a pressure
is largest, and the whole does not, as volumes are held: so a balloon is blown up beyond its limit point. Of the
directions in which K is not stable, those count that the chambers leave: its negative pivots less the negative
eigenvalues of BᵀK⁻¹B + G (Haynsworth, 1968).
"""

import math
from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.fem.finite_strain.equilibria import PATIENCE, FactoredTangent
from fenics_rom.fem.finite_strain.found_forces import FoundForces
from fenics_rom.fem.finite_strain.newton import (
    CONVERGENCE_TOLERANCE,
    MAX_ITERATIONS,
    STAGNATION_TOLERANCE,
    NewtonIterate,
    NotConvergedError,
)
from fenics_rom.fem.finite_strain.residuals import QuasiStaticResidual
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.gas import GAS_CONTROLS


def chambers_alone(
    interface: object, actuators: ActuatorForces | None, environment: ActiveEnvironment | None
) -> ActuatorForces | None:
    """Those forces that are found, where all are of chambers and nothing touches; else None."""
    if interface is not None or actuators is None or environment is None or actuators.guides:
        return None
    return None if {*environment.environment.controls.values()} - {"volume", *GAS_CONTROLS} else actuators


def solve_held(
    equation: QuasiStaticResidual,
    tangent: FactoredTangent,
    actuators: ActuatorForces,
    given: Array,
    last: Array,
    tell: Callable[[int, float], None],
) -> NewtonIterate:
    """Solves the equations, from where the body is; every rank must call it.

    Args:
        equation, tangent, tell: as in `solve_equilibrium`.
        actuators: chambers.
        given: their volumes, or what they hold, (n,).
        last: their pressures (n,) in the equilibrium before.

    Raises:
        NotConvergedError: there is none that whole steps lead to.
    """
    inner, dot, targets = equation.model.algebra.inner, equation.model.dot, equation.targets(actuators, given)
    v, z, smallest, last_better, previous = np.zeros_like(equation.start.x), last, math.inf, 0, math.inf
    for iteration in range(MAX_ITERATIONS + 1):
        with np.errstate(all="ignore"):  # a shape without an energy is refused below
            trial = equation.evaluate(v, z)
        residual = trial.residual
        if not math.isfinite(dot(residual, residual)):
            raise NotConvergedError
        columns, rates, _ = equation.strokes(v)
        answer = tangent.solve(equation, trial, residual, near=False)
        spread = np.hstack([tangent.solve(equation, trial, column[:, None], near=False) for column in columns.T])
        W = actuators.compliance(inner(columns, spread))
        free = rates + inner(columns, answer)[:, 0] - W.dot(z)
        try:
            found, _ = actuators.solve(np.empty(0), free, W, targets, z, None)
        except StepError:
            raise NotConvergedError from None
        change = found - z
        size = math.sqrt(abs(dot(residual, answer)) + abs(float(change.dot(W.dot(change)))))
        terms = equation.terms(trial)
        shapes = tangent.factor_at_hand.solve(terms) / equation.h
        scale = math.sqrt(max(abs(dot(terms[:, [k]], shape[:, None])) for k, shape in enumerate(shapes.T)))
        scale = max(scale, math.sqrt(abs(float(found.dot(W.dot(found))))))
        tell(iteration, size / scale if scale else 0.0)
        if size <= CONVERGENCE_TOLERANCE * scale or STAGNATION_TOLERANCE * scale >= size > previous / 2:
            gives = np.zeros(len(z)) if targets.gas is None else targets.gas.compliances(z)
            left = int((np.linalg.eigvalsh(W + np.diag(gives)) < 0).sum())
            tangent.negative_pivots = tangent.factor(trial).negative_pivots - left
            return NewtonIterate(trial, FoundForces(None, z), residual, answer, size, iteration)
        if size < smallest:
            smallest, last_better = size, iteration
        elif iteration - last_better >= PATIENCE:
            raise NotConvergedError
        previous, v, z = size, v + answer + spread @ change[:, None], found
    raise NotConvergedError
