"""The paper's passive reduction: eigenvectors that hold a share of a balanced basis' covariance, paper (12)-(13)."""

import numpy as np

from fenics_rom.errors import SolverError
from fenics_rom.reduction.eigenvectors import share_eigenvectors
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.system.protocols import Array

EIGENVECTORS_PER_DIRECTION = 4  # to begin with
MIN_EIGENVECTORS = 60
SHARE_ROUND_OFF = 1e-9  # by which all eigenvectors together may miss the share


class EigenvectorSelection:
    """Selects columns of V for each contact mode; V is computed once and grown when a mode needs more of it.

    Args:
        problem: what is reduced; its shared space, still empty, gets the first eigenvectors.
    """

    def __init__(self, problem: ReductionProblem):
        self._problem = problem
        orders = [problem.order_of(name) or 0 for name in problem.contacts]
        all_needed = problem.lyapunov not in ("krylov", "adi")
        first = max(MIN_EIGENVECTORS, EIGENVECTORS_PER_DIRECTION * max(orders))
        share_eigenvectors(problem, problem.system.elastic_size if all_needed else first)
        self._V = np.eye(problem.space.eigenvectors)  # coordinates

    def select(self, directions: Array, σ: Array) -> Array:
        """Coordinates of eigenvectors by falling covariance, (k, m_ξ); m_ξ >= m in general.

        Args:
            directions: (k, m) coordinates of the balanced basis T_i.
            σ: (r,) Hankel singular values, r >= m.

        Raises:
            SolverError: all eigenvectors together do not hold the share.
        """
        problem, m = self._problem, directions.shape[1]
        trace = np.sum(directions**2 @ σ[:m])  # of C, without its other entries
        while True:
            V, count = self._V, self._V.shape[1]
            k = min(len(V), len(directions))  # what came into the space later is orthogonal to the other
            covariance = (V[:k].T @ directions[:k]) ** 2 @ σ[:m]  # diagonal of VᵀMT Σ (VᵀMT)ᵀ
            order = np.argsort(covariance)[::-1]
            shares = np.cumsum(covariance[order]) / trace
            complete = count == problem.system.elastic_size
            if shares[-1] >= problem.share or (complete and shares[-1] > problem.share - SHARE_ROUND_OFF):
                m_ξ = int(np.argmax(shares >= min(problem.share, shares[-1]))) + 1
                return V[:, order[:m_ξ]]
            if complete:
                raise SolverError(f"all {count} eigenvectors hold {shares[-1]:.9f} of the trace, not {problem.share:g}")
            self._grow(min(problem.system.elastic_size, 2 * count))

    def _grow(self, count: int) -> None:
        system, space = self._problem.system, self._problem.space
        with self._problem.stages("eigenvectors"):
            _, V = system.algebra.eigenpairs(system.mass, system.stiffness, count, self._problem.factor)
            self._V = space.add(V)
