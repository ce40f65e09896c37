"""Columns that augment every contact mode's Krylov space: dashpots, and outputs where those count.

Resolvents of D = α M + β K + F Fᵀ, with few columns F, stay in the Krylov space of the proportional rest started from
[B, F].
"""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.system.columns import probe_columns
from fenics_rom.system.system import System

ROW_TOLERANCE = 1e-9  # largest relative gap of a row that obeys D = α M + β K
ROW_PAIRS = 100  # pairs of rows that α and β are read from
MAX_ROWS = 60  # with a dashpot; more are not local


@dataclass(frozen=True)
class KrylovAugmentation:
    """Columns that belong to the space of every contact mode."""

    columns: Array  # (rows here, c)
    complete: bool  # inputs and these lead to all resolvents by zero shifts alone: D is proportional but for dashpots


def find_augmentation(problem: ReductionProblem) -> KrylovAugmentation:
    """Finds the dashpots, and adds the columns of the outputs where those are what counts."""
    system = problem.system
    dashpots = low_rank_damping(system)
    columns = [np.empty((system.local_size, 0)) if dashpots is None else dashpots]
    if problem.weighting == "outputs":
        columns += system.outputs.values()
    return KrylovAugmentation(np.hstack(columns), dashpots is not None)


def low_rank_damping(system: System) -> Array | None:
    """F (rows here, columns): no columns where D is proportional, None where D is not proportional but for few rows."""
    if system.rayleigh is not None:
        return np.empty((system.local_size, 0))
    probe = probe_columns(system.algebra, 1)
    Mz, Dz, Kz = (system.algebra.gather(A @ probe)[:, 0] for A in (system.mass, system.damping, system.stiffness))
    proportional = np.stack([Mz, Kz], axis=1)
    scale = np.abs(Dz) + np.abs(Mz) * _median_ratio(Dz, Mz) + np.abs(Kz) * _median_ratio(Dz, Kz)

    def obeying(factors: Array) -> Array:
        return np.abs(Dz - proportional @ factors) <= ROW_TOLERANCE * scale

    pairs = np.random.default_rng(1).integers(system.size, size=(ROW_PAIRS, 2))
    guesses = [np.linalg.lstsq(proportional[pair], Dz[pair], rcond=None)[0] for pair in pairs]
    largest = max((obeying(guess) for guess in guesses), key=np.sum)
    factors = np.linalg.lstsq(proportional[largest], Dz[largest], rcond=None)[0]
    deviating = np.flatnonzero(~obeying(factors))
    if len(deviating) > min(MAX_ROWS, system.size // 2):
        return None
    units = (np.arange(system.size)[system.algebra.rows(), None] == deviating).astype(float)
    remainder = system.damping @ units - factors[0] * (system.mass @ units) - factors[1] * (system.stiffness @ units)
    w, E = np.linalg.eigh(system.algebra.inner(units, remainder))
    significant = np.abs(w) > ROW_TOLERANCE * np.abs(w).max()
    return units @ E[:, significant]


def _median_ratio(a: Array, b: Array) -> float:
    return float(np.median(np.abs(a)) / np.median(np.abs(b)))
