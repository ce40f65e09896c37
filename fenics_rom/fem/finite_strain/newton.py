"""Newton's method for a step, and forces found in every iteration.

Directions are secants: what the kept factor of A makes of the residual, combined with those before so that it would be
least if it changed as it has so far (`secants.py`). Where that does not halve the residual, the
consistent tangent is solved with, by a Krylov method. Residuals r are measured by √(rᵀ A⁻¹ r): the energy norm of the
correction that they ask for. With it the line search sees bending as well as stretching (natural monotonicity:
Deuflhard, 2004).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.found_forces import ForcesInNewton, FoundForces
from fenics_rom.fem.finite_strain.gmres import Gmres
from fenics_rom.fem.finite_strain.residuals import StepResidual, TrialStep
from fenics_rom.fem.finite_strain.secants import Secants
from fenics_rom.fem.finite_strain.turned_factor import TurnedFactor

CONVERGENCE_TOLERANCE = 1e-12  # share of the forces in a step
STAGNATION_TOLERANCE = 1e-8  # share of them that may be left where round-off lets it get no smaller
STANDING = 0.8  # of the residual before that tangents leave at round-off
ROUND_OFF = 1e-11  # share of them where secants that get it no smaller have come to round-off
NOISE = 1e-10  # share of them below which changes say nothing of the tangent
MAX_ITERATIONS = 25  # with tangents
MAX_SECANT_ITERATIONS = 50  # with secants or tangents
SOON = 24  # more iterations: two halves of a step rarely take more
TREND = 5  # last iterations that tell how many more there will be
DIVERGENCE = 10  # times the first residual under forces that were found
SLOW_SECANTS = 2  # in a row that do not halve the residual, after which tangents are tried
MIN_STEP_SHARE = 1 / 32  # of a Newton step
SUFFICIENT_DECREASE = 0.1  # share of what a Newton step promises that it must keep
MAX_FORCING, MIN_FORCING = 0.01, 1e-6  # residuals that linear systems are solved to, at first and at best


class NotConvergedError(Exception):
    """Newton's method found no solution, or not soon; a better factor or a shorter step may."""


@dataclass(frozen=True)
class NewtonIterate:
    """A mid-step velocity that Newton's method has come to.

    Attributes:
        trial: its velocity and forces.
        found: forces of contact and actuators that were found with it.
        residual: r, what they leave (rows here, 1), N.
        answer: A⁻¹ r (rows here, 1), m/s.
        size: of the residual, and of what the law of contact lacks; without end where there are no numbers for it.
        iterations: that led to it.
    """

    trial: TrialStep
    found: FoundForces
    residual: Array
    answer: Array
    size: float
    iterations: int


def solve_step(
    equation: StepResidual,
    guesses: list[Array],
    factor: TurnedFactor,
    secants: Secants,
    gmres: Gmres,
    forces: ForcesInNewton | None,
    dot: Callable[[Array, Array], float],
    last: FoundForces,
    by_secants: bool = True,
    is_patient: bool = True,
) -> NewtonIterate:
    """Solves the equations of a step; every rank must call it.

    Args:
        equation: of the step.
        guesses: of its mid-step velocity (rows here, 1); the best is where the search begins.
        factor: of a symmetric positive definite matrix that stands for the tangent.
        secants: of this factor.
        gmres: what solves with the tangent itself.
        forces: those that are found in the step; None: there are none.
        dot: product of columns (rows here, 1).
        last: what was found in the step before, the first guess.
        by_secants: whether they may be tried, which for few steps lead astray.
        is_patient: whether to go on where it will take long under forces that are found, as convergence is linear then.
    """

    def iterate_at(v: Array, found: FoundForces, iterations: int, lag: float = 0.0) -> NewtonIterate:
        with np.errstate(all="ignore"):  # a shape without an energy is refused for its size
            trial = equation.evaluate(v, found.actuators)
            residual = trial.residual if forces is None else trial.residual + forces.contact_force(found.contact)
            size, answer = dot(residual, residual), residual
            if math.isfinite(size):
                answer = factor.solve(residual)
                size = math.hypot(math.sqrt(max(dot(residual, answer), 0.0)), lag)
        size = size if math.isfinite(size) else math.inf
        return NewtonIterate(trial, found, residual, answer, size, iterations)

    current = min((iterate_at(guess, last, 0) for guess in guesses), key=lambda iterate: iterate.size)
    if current.size == math.inf:
        raise NotConvergedError
    terms = equation.terms(current.trial)
    largest = terms[:, [np.diag(equation.model.algebra.inner(terms, terms)).argmax()]]
    scale = math.sqrt(max(dot(largest, factor.solve(largest)), 0.0))
    forcing, forces_resolved, tangents, may_use_secants = MAX_FORCING, forces is None, 0, by_secants
    slow, unpushed = 0, forces is not None
    secants.begin()
    spread = np.zeros_like(current.answer)  # of forces since the start
    previous, first, sizes = current, 0.0, [current.size]
    for iteration in range(MAX_SECANT_ITERATIONS):
        if forces_resolved and current.size <= CONVERGENCE_TOLERANCE * scale:
            return current
        if previous.size > NOISE * scale:
            secants.note(current.trial.v, current.answer - spread)
        share, previous, spread_before = 1.0, current, spread
        direction = secants.direction(current.answer)
        while True:
            if not by_secants and share == 1.0 and previous.size > 0:
                tangents += 1
                if tangents > MAX_ITERATIONS:
                    raise NotConvergedError
                tangent = partial(equation.apply_tangent, previous.trial)
                direction = gmres.solve(tangent, factor, previous.residual, forcing)
            v, found, lag = previous.trial.v + share * direction, previous.found, 0.0
            if forces is not None:
                found = forces.resolve(v, previous.found)
                change = forces.spread(found, previous.found)
                v, spread, lag = v + change, spread_before + change, forces.lag(found, previous.found)
            current = iterate_at(v, found, iteration + 1, lag)
            if unpushed and forces is not None and found.act:  # of a body at rest it is the only force
                pushed, unpushed = forces.force(found), False
                scale = max(scale, math.sqrt(max(dot(pushed, factor.solve(pushed)), 0.0)))
            decreased = current.size <= (1 - SUFFICIENT_DECREASE * share) * previous.size
            if decreased or (forces is not None and current.size < math.inf):
                break
            if by_secants:
                by_secants = False
                secants.forget()
                continue
            if forces_resolved and previous.size <= STAGNATION_TOLERANCE * scale:
                return previous
            share /= 2
            if share < MIN_STEP_SHARE:
                raise NotConvergedError
        halved = current.size <= previous.size / 2
        slow = 0 if halved else slow + 1
        sizes.append(current.size)
        if by_secants and slow >= SLOW_SECANTS:  # tangents do not make them better
            may_use_secants, sizes = False, sizes[-1:]
        if not is_patient and current.found.act:
            if not first:  # where contact begins residuals grow, those without its forces tell nothing
                first, sizes = max(previous.size, current.size), [current.size]
            if takes_long(sizes, first, scale):
                raise NotConvergedError
        stands = current.size > (0.5 if by_secants else STANDING) * previous.size  # contact may halve no residual
        if stands and current.size <= (ROUND_OFF if by_secants else STAGNATION_TOLERANCE) * scale:
            return current
        forces_resolved = True
        by_secants = (halved or (by_secants and slow < SLOW_SECANTS)) and may_use_secants
        if current.size > 0 and previous.size > 0:  # Eisenstat & Walker, 1996
            reached = (current.size / previous.size) ** 2
            forcing = min(MAX_FORCING, max(MIN_FORCING, reached, CONVERGENCE_TOLERANCE * scale / (3 * current.size)))
    raise NotConvergedError


def takes_long(sizes: list[float], first: float, scale: float) -> bool:
    """Whether it diverges, or will not be solved within SOON iterations.

    Args:
        sizes: of residuals so far, since forces acted and directions were last sought in another way.
        first: size of the first residual under forces that were found.
        scale: of the forces.
    """
    last, goal = sizes[-1], ROUND_OFF * scale
    if last <= goal:
        return False
    if last > DIVERGENCE * max(first, NOISE * scale):
        return True
    if len(sizes) <= TREND:
        return False
    trend = math.log(sizes[-1 - TREND] / last)
    return trend <= 0 or TREND * math.log(last / goal) / trend > SOON
