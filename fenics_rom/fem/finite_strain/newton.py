"""Newton's method for a step: consistent tangents by a Krylov method, and contact solved in every iteration.

Residuals r are measured by √(rᵀ A⁻¹ r), with the kept factor of A: the energy norm of the correction that they ask for.
With it the line search sees bending as well as stretching (natural monotonicity: Deuflhard, 2004).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.finite_strain.gmres import Krylov
from fenics_rom.fem.finite_strain.residuals import Equation, Trial
from fenics_rom.mechanics.contact import ContactSolution

Array = np.ndarray

CONVERGED = 1e-12  # of the forces in a step
STALLED = 1e-8  # of them: what may be left where round-off lets it get no smaller
ITERATIONS = 25
SHORTEST = 1 / 32  # share of a Newton step
LEAST = 0.1  # share of what a Newton step promises that it must keep
COARSE, FINE = 0.01, 1e-6  # residuals that linear systems are solved to, at first and at most


class NotConvergedError(Exception):
    """Newton's method found no solution; a better factor or a shorter step may."""


@dataclass(frozen=True)
class Solution:
    """A step that was found.

    Attributes:
        trial: its velocity and forces.
        contact: in it; None where nothing touches.
        iterations: of Newton's method.
    """

    trial: Trial
    contact: ContactSolution | None
    iterations: int


class Touch(Protocol):
    """Obstacles in a step."""

    def resolve(self, v: Array, last: ContactSolution | None) -> ContactSolution | None:
        """Contact with a mid-step velocity (rows here, 1) that was found with the last contact."""

    def push(self, touched: ContactSolution | None) -> Array:
        """Its force (rows here, 1), N."""


def solved(
    equation: Equation,
    guesses: list[Array],
    factor: PetscFactor,
    krylov: Krylov,
    touch: Touch | None,
    dot: Callable[[Array, Array], float],
    last: ContactSolution | None,
) -> Solution:
    """Solves the equations of a step; every rank must call it.

    Args:
        equation: of the step.
        guesses: of its mid-step velocity (rows here, 1); the best is where the search begins.
        factor: of a symmetric positive definite matrix that stands for the tangent.
        krylov: what solves with the tangent itself.
        touch: the obstacles; None: there are none.
        dot: product of columns (rows here, 1).
        last: contact in the step before, whose forces are the first guess.

    Raises:
        NotConvergedError: there is none within training_radius.
    """

    def measured(v: Array, touched: ContactSolution | None) -> tuple[float, Array, Trial]:
        """Size of the residual, the residual and what it is made of; without end where there are no numbers for it."""
        with np.errstate(all="ignore"):  # a shape without an energy is refused for its size
            trial = equation.at(v)
            residual = trial.residual if touch is None else trial.residual + touch.push(touched)
            size = dot(residual, residual)
            if math.isfinite(size):
                size = math.sqrt(max(dot(residual, factor.solve(residual)), 0.0))
        return (size if math.isfinite(size) else math.inf), residual, trial

    size, residual, trial = min((measured(guess, last) for guess in guesses), key=lambda found: found[0])
    if size == math.inf:
        raise NotConvergedError
    terms = equation.terms(trial)
    scale = math.sqrt(max(dot(terms[:, [k]], part[:, None]) for k, part in enumerate(factor.solve(terms).T)))
    touched, forcing, settled = last, COARSE, touch is None
    for iteration in range(ITERATIONS):
        if settled and size <= CONVERGED * scale:
            return Solution(trial, touched, iteration)
        direction = np.zeros_like(trial.v)
        if size > 0:
            direction = krylov.solve(partial(equation.changed, trial), factor, residual, forcing)
        share, before, was = 1.0, size, trial
        while True:
            v, now = was.v + share * direction, touched
            if touch is not None:
                now = touch.resolve(v, touched)
                v = v + factor.solve(touch.push(now) - touch.push(touched))
            size, residual, trial = measured(v, now)
            if size <= (1 - LEAST * share) * before or (touch is not None and size < math.inf):
                break
            if settled and before <= STALLED * scale:
                return Solution(was, touched, iteration)
            share /= 2
            if share < SHORTEST:
                raise NotConvergedError
        touched, settled = now, True
        if STALLED * scale >= size > before / 2:
            return Solution(trial, touched, iteration + 1)
        if size > 0 and before > 0:
            forcing = min(COARSE, max(FINE, (size / before) ** 2, CONVERGED * scale / (3 * size)))
    raise NotConvergedError
