"""Damping that is proportional but for a few degrees of freedom: D = α M + β K + F Fᵀ, dashpots and the like.

Resolvents of such a D applied to B stay in the Krylov space of the proportional rest started from [B, F].
"""

import numpy as np

from fenics_rom.system.probes import probe_columns
from fenics_rom.system.protocols import Array
from fenics_rom.system.system import System

AGREEMENT = 1e-9  # largest relative gap of a row that obeys D = α M + β K
GUESSES = 100  # pairs of rows that α and β are read from
MOST_ROWS = 60  # with a dashpot; more are not local


def low_rank_damping(system: System) -> Array | None:
    """F (rows here, columns): no columns where D is proportional, None where D is not proportional but for few rows."""
    if system.rayleigh is not None:
        return np.empty((system.local_size, 0))
    probe = probe_columns(system.algebra, 1)
    Mz, Dz, Kz = (system.algebra.gather(A @ probe)[:, 0] for A in (system.mass, system.damping, system.stiffness))
    proportional = np.stack([Mz, Kz], axis=1)
    scale = np.abs(Dz) + np.abs(Mz) * _ratio(Dz, Mz) + np.abs(Kz) * _ratio(Dz, Kz)

    def obey(factors: Array) -> Array:
        return np.abs(Dz - proportional @ factors) <= AGREEMENT * scale

    pairs = np.random.default_rng(1).integers(system.size, size=(GUESSES, 2))
    guesses = [np.linalg.lstsq(proportional[pair], Dz[pair], rcond=None)[0] for pair in pairs]
    most = max((obey(guess) for guess in guesses), key=np.sum)
    factors = np.linalg.lstsq(proportional[most], Dz[most], rcond=None)[0]
    apart = np.flatnonzero(~obey(factors))
    if len(apart) > min(MOST_ROWS, system.size // 2):
        return None
    units = (np.arange(system.size)[system.algebra.rows(), None] == apart).astype(float)
    rest = system.damping @ units - factors[0] * (system.mass @ units) - factors[1] * (system.stiffness @ units)
    w, E = np.linalg.eigh(system.algebra.inner(units, rest))
    there = np.abs(w) > AGREEMENT * np.abs(w).max()
    return units @ E[:, there]


def _ratio(a: Array, b: Array) -> float:
    return float(np.median(np.abs(a)) / np.median(np.abs(b)))
