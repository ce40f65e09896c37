"""Proportional damping D = α M + β K: whether it was asked for, and whether a given D is one."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import StructureError, shown
from fenics_rom.system.columns import probe_columns
from fenics_rom.system.protocols import Algebra, Operator

PROPORTIONALITY_TOLERANCE = 1e-12  # share of D that may be neither M nor K where it counts as α M + β K


def check_damping_choice(damping: Any, rayleigh: tuple[float, float] | None) -> None:
    """Refuses both or none of a damping matrix and (α, β), and an (α, β) that could drive.

    Raises:
        StructureError: what was given, and what is allowed.
    """
    if (damping is None) == (rayleigh is None):
        raise StructureError(
            f"{'neither' if damping is None else 'both'} damping {'nor' if damping is None else 'and'} rayleigh given; "
            "use one of them"
        )
    pair = rayleigh if isinstance(rayleigh, tuple | list) else ()
    if rayleigh is not None and not (len(pair) == 2 and all(is_number(c) and c >= 0 for c in pair)):
        allowed = "two finite numbers (α, β) from 0, in 1/s and s"
        raise StructureError(f"rayleigh = {shown(rayleigh)}: use {allowed}")


def fitted_rayleigh(M: Operator, D: Operator, K: Operator, algebra: Algebra) -> tuple[float, float] | None:
    """(α, β) of D = α M + β K, or None where D is anything else; from products with a few vectors."""
    probes = probe_columns(algebra, 4)

    def dot(left: Array, right: Array) -> float:
        return float(np.trace(algebra.inner(left, right)))

    Mz, Dz, Kz = (A @ probes for A in (M, D, K))
    μ, κ = np.sqrt(dot(Mz, Mz)), np.sqrt(dot(Kz, Kz))
    cosine = dot(Mz, Kz) / (μ * κ)
    weights, remainder = np.zeros(2), Dz
    for _ in range(2):  # once more for what the normal equations lose to round-off
        projections = [dot(Mz, remainder) / μ, dot(Kz, remainder) / κ]
        weights += np.linalg.lstsq([[1.0, cosine], [cosine, 1.0]], projections, rcond=None)[0]
        remainder = Dz - weights[0] / μ * Mz - weights[1] / κ * Kz
    if dot(remainder, remainder) > PROPORTIONALITY_TOLERANCE**2 * dot(Dz, Dz):
        return None
    return float(weights[0] / μ), float(weights[1] / κ)
