"""Least squares on reduced models that are refreshed as the parameters move.

Each fit stays where its basis is good. It begins with the first instants of a motion, and then takes twice as many
again and again: after many periods, a frequency that is some per cent off has lost count of them, and a fit that saw
all of them at once would end anywhere.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.optimize
from numpy import ndarray as Array

from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.identification.experiment import Experiments
from fenics_rom.identification.parameters import ALPHA, BETA, Parameter, directions_at, values_at
from fenics_rom.identification.recording import JointModel
from fenics_rom.identification.uncertainty import interval_half_widths

TRUST_RADIUS = 0.7  # of q, that a basis is trusted for: a factor of 2 of E and ρ
MAX_BASES = 15
FIRST_INSTANTS = 2  # instants that a fit begins with, or up to twice as many
SPAN_TOLERANCE = 1e-4  # of q, before all of it is looked at
PRIOR_WEIGHT = 0.01  # share of what is measured that a factor of e is worth, before all of it is looked at
CONVERGENCE_TOLERANCE = 0.02  # share of the 95 % interval by which a new basis may move a parameter
MIN_MOVE = 1e-8  # of q, where the interval is shorter than that
NEAR = 0.03  # of q, that models are followed to where the full order has the last steps
MAX_FULL_ORDER_STEPS = 8


@dataclass(frozen=True)
class Fit:
    """Where a fit ended."""

    q: Array  # coordinates of the parameters, (p,)
    model: JointModel  # on a basis made there, or next to it
    predicted: Array  # what it says, (N,), m
    jacobian: Array  # of that with respect to q, (N, p)
    bases: int  # how many were made
    converged: bool  # whether another one would change nothing; else they were too many


@dataclass(frozen=True)
class FitProblem:
    """What is sought, and from where."""

    start: Array  # θ
    parameters: Sequence[Parameter]  # p of them
    experiment: Experiments  # all that was measured
    model_at: Callable[[Array], JointModel]  # makes the model whose basis is best at θ
    comm: Any  # of the ranks, of which the first searches, so that all decide alike
    # The full order's derivatives where a model was made; None: the model's own are those.
    derivatives_at: Callable[[JointModel, Array, Sequence[Array]], Array] | None = None

    def values(self, q: Array) -> Array:
        """θ at q."""
        return values_at(self.start, self.parameters, q)

    def directions(self, q: Array) -> list[Array]:
        """dθ/dq of each parameter."""
        return directions_at(self.start, self.parameters, q)

    def step(self, q: Array, predicted: Array, jacobian: Array) -> tuple[Array, float]:
        """The step of Gauss and Newton from q, (p,), and how many times what is negligible it is."""

        def search() -> Array:
            newton = np.linalg.lstsq(jacobian, self.experiment.measured - predicted, rcond=None)[0]
            lowest = [parameter.lowest for parameter in self.parameters]
            return np.maximum(q + np.clip(newton, -TRUST_RADIUS, TRUST_RADIUS), lowest) - q

        step = run_on_rank_0(self.comm, search)
        return step, float(np.max(np.abs(step) / self.negligible(predicted, jacobian)))

    def negligible(self, predicted: Array, jacobian: Array) -> Array:
        """Moves of q (p,) that nobody would care for."""
        widths = interval_half_widths(self.experiment.measured - predicted, jacobian)
        return np.maximum(CONVERGENCE_TOLERANCE * widths, MIN_MOVE)

    def linearize(self, model: JointModel, experiment: Experiments, q: Array) -> tuple[Array, Array]:
        """What a model says of an experiment, and its Jacobian."""
        return model.linearize(experiment, self.values(q), self.directions(q))


def fit_parameters(problem: FitProblem, q: Array, model: JointModel, report: Callable[[int, int], None]) -> Fit:
    """The fit from q (p,) on, with a model on a basis made there; told is which time span is fitted, of how many."""
    spans = time_spans(problem.experiment)
    centre, bases = q, 1
    for number, span in enumerate(spans):
        report(number, len(spans))
        last = number == len(spans) - 1
        part = problem.experiment if last else problem.experiment.until(span)
        while True:
            search = partial(
                _least_squares, problem, model, part, q, centre, tolerance=model.precision if last else SPAN_TOLERANCE
            )
            q = run_on_rank_0(problem.comm, search)
            predicted, jacobian = problem.linearize(model, part, q)
            moved = np.abs(q - centre)
            if last:
                near = 0.0 if problem.derivatives_at is None else NEAR
                converged = bool((moved <= np.maximum(problem.negligible(predicted, jacobian), near)).all())
                if converged or bases >= MAX_BASES:
                    report(len(spans), len(spans))
                    return Fit(q, model, predicted, jacobian, bases, converged)
            elif (moved < TRUST_RADIUS / 2).all():
                break
            model, centre, bases = problem.model_at(problem.values(q)), q, bases + 1
    raise AssertionError("unreachable")


def finish_at_full_order(
    problem: FitProblem, fit: Fit, derivatives_at: Callable[[JointModel, Array, Sequence[Array]], Array]
) -> Fit:
    """Gauss and Newton's steps at full order, from where models have brought a fit whose derivatives are but near.

    Where a model was made it says what the full order says. Derivatives are kept while steps shrink by half each time.
    """
    q, jacobian, before = fit.q, None, np.inf
    for bases in range(fit.bases + 1, fit.bases + MAX_FULL_ORDER_STEPS + 1):
        θ = problem.values(q)
        model = problem.model_at(θ)
        predicted = model.predict(problem.experiment, θ)
        if jacobian is not None:
            step, size = problem.step(q, predicted, jacobian)
        if jacobian is None or size > before / 2:
            jacobian = derivatives_at(model, θ, problem.directions(q))
            step, size = problem.step(q, predicted, jacobian)
        fit = Fit(q, model, predicted, jacobian, bases, converged=size <= 1)
        if fit.converged:
            break
        q, before = q + step, size
    return fit


def time_spans(experiment: Experiments) -> list[float]:
    """Ends of the spans that are looked at one after the other, s; the last one is everything."""
    instants = np.unique(experiment.times)
    counts = [len(instants)]
    while counts[0] > 2 * FIRST_INSTANTS:
        counts.insert(0, counts[0] // 2)
    return [*(float(instants[count - 1]) for count in counts[:-1]), np.inf]


def _least_squares(
    problem: FitProblem, model: JointModel, part: Experiments, q: Array, centre: Array, *, tolerance: float
) -> Array:
    """The best q within reach of a basis; with a prior where only a part is looked at."""
    scale = np.sqrt(np.mean(problem.experiment.measured**2)) or 1.0
    weight = 0.0 if part is problem.experiment else PRIOR_WEIGHT * np.sqrt(len(part.measured))
    damping = np.array([parameter.column in (ALPHA, BETA) for parameter in problem.parameters])
    low = np.where(damping, [parameter.lowest for parameter in problem.parameters], centre - TRUST_RADIUS)
    high = np.where(damping, np.inf, centre + TRUST_RADIUS)

    def residual(q: Array) -> Array:
        return np.concatenate([(model.predict(part, problem.values(q)) - part.measured) / scale, weight * q])

    def jacobian(q: Array) -> Array:
        return np.vstack([problem.linearize(model, part, q)[1] / scale, weight * np.eye(len(q))])

    bounds, x0 = (low, high), np.clip(q, low, high)
    tolerances = {"xtol": tolerance, "ftol": tolerance, "gtol": tolerance}
    best: Array = scipy.optimize.least_squares(residual, x0, jacobian, bounds=bounds, max_nfev=100, **tolerances).x
    return best
