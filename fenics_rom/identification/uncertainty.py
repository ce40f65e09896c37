"""How well data know the parameters, and which combinations of them data cannot tell at all.

Intervals and correlations are those of linearized least squares (Seber & Wild 2003, ch. 5): the noise of all values is
taken for independent and alike; s² = |r|² / (N - p) estimates its variance, s² (JᵀJ)⁻¹ is the covariance of q, and the
intervals are Student's. What data cannot tell are combinations with small singular values of the Jacobian J.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats
from numpy import ndarray as Array

from fenics_rom.identification.parameters import ALPHA, BETA, DENSITY, FIRST_CLOCK, POISSON, TILTS, YOUNG, Parameter

CONFIDENCE = 0.95
ROUND_OFF_SHARE = 1e-7  # share of the largest singular value below which data do not depend on a combination at all
VAGUE_HALF_WIDTHS = {POISSON: 2.0}  # half-width of a 95 % interval of q that says nothing; 1 of others: a factor of e
NAMED_SHARE = 0.1  # of the largest, that a parameter must have in a combination to be named
EQUALITY_TOLERANCE = 0.02  # relative difference of weights that count as equal
# among parameters that weigh alike in a combination
FIXING_ORDER = (FIRST_CLOCK, *TILTS, DENSITY, POISSON, ALPHA, BETA, YOUNG)


def noise_deviation(residual: Array, parameters: int) -> float:
    """s, m: standard deviation of a single value, from residuals (N,) of a fit."""
    return float(np.sqrt(np.sum(residual**2) / (len(residual) - parameters)))


def t_quantile(freedom: int) -> float:
    """How many standard errors half an interval is."""
    return float(scipy.stats.t.ppf((1 + CONFIDENCE) / 2, freedom))


def interval_half_widths(residual: Array, jacobian: Array) -> Array:
    """Half the intervals of q, (p,)."""
    count, p = jacobian.shape
    errors = noise_deviation(residual, p) * np.sqrt(np.diag(_unit_covariance(jacobian)))
    return t_quantile(count - p) * errors


def correlations(jacobian: Array) -> Array:
    """Of the errors of q, (p, p)."""
    covariance = _unit_covariance(jacobian)
    sizes = np.sqrt(np.diag(covariance))
    return covariance / sizes[:, None] / sizes


def _unit_covariance(jacobian: Array) -> Array:
    """(JᵀJ)⁻¹ (p, p)."""
    inverse = np.linalg.pinv(np.linalg.qr(jacobian, mode="r"))
    return inverse @ inverse.T


@dataclass(frozen=True)
class Unidentifiable:
    """A combination that data cannot tell."""

    fixed: Parameter  # the parameter that is left at its start value for it
    reason: str  # why, as a sentence


def find_unidentifiable(parameters: Sequence[Parameter], jacobian: Array, uncertainty: float) -> Unidentifiable | None:
    """The combination that data tell least, if they cannot tell it.

    Args:
        parameters: p of them.
        jacobian: of what is measured, (N, p), with respect to their q.
        uncertainty: half-width of the 95 % interval of a combination to which what is measured has slope 1; 0: only
            what round-off forbids to tell.
    """
    spans = np.array([VAGUE_HALF_WIDTHS.get(parameter.column, 1.0) for parameter in parameters])
    _, σ, Vᵀ = np.linalg.svd(jacobian * spans, full_matrices=False)
    blind = bool(σ[-1] <= ROUND_OFF_SHARE * σ[0])
    if not blind and σ[-1] >= uncertainty:
        return None
    weights = np.abs(Vᵀ[-1])
    named = np.flatnonzero(weights >= NAMED_SHARE * weights.max())
    alike = np.flatnonzero(weights >= (1 - EQUALITY_TOLERANCE) * weights.max())
    fixed = min(
        (parameters[k] for k in alike), key=lambda parameter: FIXING_ORDER.index(min(parameter.column, FIRST_CLOCK))
    )
    direction = Vᵀ[-1] * spans * np.sign(Vᵀ[-1][named[0]])
    reason = _describe([parameters[k] for k in named], direction[named], blind)
    if not blind or len(named) > 1:
        reason += (
            f"; {fixed.name} was left at {fixed.start:g} {fixed.unit}, and the intervals of the others rest on that"
        )
    return Unidentifiable(fixed, reason)


def _describe(parameters: Sequence[Parameter], direction: Array, blind: bool) -> str:
    names = _listed([parameter.name for parameter in parameters])
    if len(parameters) == 1:
        return f"the data {'do not depend' if blind else 'hardly depend'} on {names}"
    equal = np.abs(direction).min() >= (1 - EQUALITY_TOLERANCE) * np.abs(direction).max()
    if equal and all(parameter.proportional for parameter in parameters):
        if (direction > 0).all() or (direction < 0).all():
            return f"{names} appear only as their ratio: nothing in the data, such as a force in N, sets the scale"
        if len(parameters) == 2:
            return f"{names} appear only as their product"
    up, down = ([p.name for p, d in zip(parameters, direction, strict=True) if s * d > 0] for s in (1, -1))
    more = f"{_listed(up)} and less of {_listed(down)} gives" if up and down else f"{names} together gives"
    return f"more of {more} {'' if blind else 'nearly '}the same data"


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
