"""The paper's passive reduction: eigenvectors that hold a share of a balanced basis' covariance, paper (12)-(13)."""

import numpy as np

from fenics_rom.errors import SolverError
from fenics_rom.reduction.subspace import Subspace
from fenics_rom.system import Array, System


class EigenvectorSelection:
    """Selects columns of V for each contact mode; V is computed once and grown when a mode needs more of it.

    Args:
        system: the full-order model.
        share: of the trace of the covariance that the selected eigenvectors must hold.
        known: V already computed, where there is one.
    """

    def __init__(self, system: System, share: float, known: Subspace | None = None):
        self._system = system
        self._share = share
        self._V = np.empty((0, 0)) if known is None else known.basis

    def select(self, balanced_basis: Array, σ: Array) -> Array:
        """Eigenvectors by falling covariance, (rows here, m_ξ); m_ξ >= m in general.

        Args:
            balanced_basis: T_i, (rows here, m).
            σ: (m,) Hankel singular values.

        Raises:
            SolverError: all eigenvectors together do not hold the share.
        """
        system, inner = self._system, self._system.algebra.inner
        MT = system.mass @ balanced_basis
        trace = np.sum(np.diag(inner(balanced_basis, MT)) * σ)  # of C, without its other entries
        count = max(self._V.shape[1], min(system.size, 4 * len(σ)))
        while True:
            if self._V.shape[1] < count:
                _, self._V = system.algebra.eigenpairs(system.mass, system.stiffness, count)
            covariance = inner(self._V, MT) ** 2 @ σ  # diagonal of VᵀMT Σ (VᵀMT)ᵀ
            order = np.argsort(covariance)[::-1]
            held = np.cumsum(covariance[order]) / trace
            if held[-1] >= self._share or (count == system.size and held[-1] > self._share - 1e-9):
                chosen = int(np.argmax(held >= min(self._share, held[-1]))) + 1
                return self._V[:, order[:chosen]]
            if count == system.size:
                raise SolverError(f"all {count} eigenvectors hold {held[-1]:.9f} of the trace, not {self._share:g}")
            count = min(system.size, 2 * count)
