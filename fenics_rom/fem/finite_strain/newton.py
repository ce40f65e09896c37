"""Newton's method for a step: consistent tangents by a Krylov method, and forces found in every iteration.

Residuals r are measured by √(rᵀ A⁻¹ r), with the kept factor of A: the energy norm of the correction that they ask for.
With it the line search sees bending as well as stretching (natural monotonicity: Deuflhard, 2004).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.finite_strain.found_forces import ForcesInNewton, FoundForces
from fenics_rom.fem.finite_strain.gmres import Gmres
from fenics_rom.fem.finite_strain.residuals import StepResidual, TrialStep

CONVERGENCE_TOLERANCE = 1e-12  # share of the forces in a step
STAGNATION_TOLERANCE = 1e-8  # share of them that may be left where round-off lets it get no smaller
MAX_ITERATIONS = 25
MIN_STEP_SHARE = 1 / 32  # of a Newton step
SUFFICIENT_DECREASE = 0.1  # share of what a Newton step promises that it must keep
MAX_FORCING, MIN_FORCING = 0.01, 1e-6  # residuals that linear systems are solved to, at first and at best


class NotConvergedError(Exception):
    """Newton's method found no solution; a better factor or a shorter step may."""


@dataclass(frozen=True)
class NewtonIterate:
    """A mid-step velocity that Newton's method has come to.

    Attributes:
        trial: its velocity and forces.
        found: forces of contact and actuators that were found with it.
        residual: what they leave (rows here, 1), N.
        size: of the residual, without end where there are no numbers for it.
        iterations: that led to it.
    """

    trial: TrialStep
    found: FoundForces
    residual: Array
    size: float
    iterations: int


def solve_step(
    equation: StepResidual,
    guesses: list[Array],
    factor: PetscFactor,
    gmres: Gmres,
    forces: ForcesInNewton | None,
    dot: Callable[[Array, Array], float],
    last: FoundForces,
) -> NewtonIterate:
    """Solves the equations of a step; every rank must call it.

    Args:
        equation: of the step.
        guesses: of its mid-step velocity (rows here, 1); the best is where the search begins.
        factor: of a symmetric positive definite matrix that stands for the tangent.
        gmres: what solves with the tangent itself.
        forces: those that are found in the step; None: there are none.
        dot: product of columns (rows here, 1).
        last: what was found in the step before, the first guess.
    """

    def iterate_at(v: Array, found: FoundForces, iterations: int) -> NewtonIterate:
        with np.errstate(all="ignore"):  # a shape without an energy is refused for its size
            trial = equation.evaluate(v, found.actuators)
            residual = trial.residual if forces is None else trial.residual + forces.contact_force(found.contact)
            size = dot(residual, residual)
            if math.isfinite(size):
                size = math.sqrt(max(dot(residual, factor.solve(residual)), 0.0))
        return NewtonIterate(trial, found, residual, size if math.isfinite(size) else math.inf, iterations)

    current = min((iterate_at(guess, last, 0) for guess in guesses), key=lambda iterate: iterate.size)
    if current.size == math.inf:
        raise NotConvergedError
    terms = equation.terms(current.trial)
    scale = math.sqrt(max(dot(terms[:, [k]], column[:, None]) for k, column in enumerate(factor.solve(terms).T)))
    forcing, forces_resolved = MAX_FORCING, forces is None
    for iteration in range(MAX_ITERATIONS):
        if forces_resolved and current.size <= CONVERGENCE_TOLERANCE * scale:
            return current
        direction = np.zeros_like(current.trial.v)
        if current.size > 0:
            tangent = partial(equation.apply_tangent, current.trial)
            direction = gmres.solve(tangent, factor, current.residual, forcing)
        share, previous = 1.0, current
        while True:
            v, found = previous.trial.v + share * direction, previous.found
            if forces is not None:
                found = forces.resolve(v, previous.found)
                v = v + factor.solve(forces.force(found) - forces.force(previous.found))
            current = iterate_at(v, found, iteration + 1)
            if forces is not None and found.act:  # of a body at rest it is the only force
                pushed = forces.force(found)
                scale = max(scale, math.sqrt(max(dot(pushed, factor.solve(pushed)), 0.0)))
            decreased = current.size <= (1 - SUFFICIENT_DECREASE * share) * previous.size
            if decreased or (forces is not None and current.size < math.inf):
                break
            if forces_resolved and previous.size <= STAGNATION_TOLERANCE * scale:
                return previous
            share /= 2
            if share < MIN_STEP_SHARE:
                raise NotConvergedError
        forces_resolved = True
        if STAGNATION_TOLERANCE * scale >= current.size > previous.size / 2:
            return current
        if current.size > 0 and previous.size > 0:  # Eisenstat & Walker, 1996
            reached = (current.size / previous.size) ** 2
            forcing = min(MAX_FORCING, max(MIN_FORCING, reached, CONVERGENCE_TOLERANCE * scale / (3 * current.size)))
    raise NotConvergedError
