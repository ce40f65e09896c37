"""Which combinations of parameters data cannot tell, by the singular values of the Jacobian, and what to call them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_rom.identification.parameters import ALPHA, DENSITY, POISSON, YOUNG, Parameter

Array = np.ndarray

ROUND_OFF_SHARE = 1e-7  # share of the largest singular value below which data do not depend on a combination at all
VAGUE_HALF_WIDTHS = {POISSON: 2.0}  # half-width of a 95 % interval of q that says nothing; 1 of others: a factor of e
NAMED_SHARE = 0.1  # of the largest, that a parameter must have in a combination to be named
EQUALITY_TOLERANCE = 0.02  # relative difference of weights that count as equal
FIXING_ORDER = (DENSITY, POISSON, ALPHA, ALPHA + 1, YOUNG)  # among parameters that weigh alike in a combination


@dataclass(frozen=True)
class Unidentifiable:
    """A combination that data cannot tell.

    Attributes:
        fixed: the parameter that is left at its start value for it.
        reason: why, as a sentence.
    """

    fixed: Parameter
    reason: str


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
    if σ[-1] > ROUND_OFF_SHARE * σ[0] and σ[-1] >= uncertainty:
        return None
    named = np.flatnonzero(np.abs(Vᵀ[-1]) >= NAMED_SHARE * np.abs(Vᵀ[-1]).max())
    direction = Vᵀ[-1] * spans * np.sign(Vᵀ[-1][named[0]])
    largest = np.abs(Vᵀ[-1]).max()
    alike = [k for k in named if abs(Vᵀ[-1][k]) >= (1 - EQUALITY_TOLERANCE) * largest]
    fixed = parameters[min(alike, key=lambda k: FIXING_ORDER.index(parameters[k].column))]
    blind = σ[-1] <= ROUND_OFF_SHARE * σ[0]
    reason = _describe([parameters[k] for k in named], direction[named], blind)
    if blind and len(named) == 1:
        return Unidentifiable(fixed, reason)
    consequence = f"{fixed.name} was left at {fixed.start:g} {fixed.unit}, and the intervals of the others rest on that"
    return Unidentifiable(fixed, f"{reason}; {consequence}")


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
    if not up or not down:
        return f"more of {names} together gives {'' if blind else 'nearly '}the same data"
    return f"more of {_listed(up)} and less of {_listed(down)} gives {'' if blind else 'nearly '}the same data"


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
