"""The paper's passive reduction: eigenvectors that hold a share of a balanced basis' covariance, paper (12)-(13)."""

import numpy as np

from fenics_rom.errors import SolverError
from fenics_rom.reduction.eigenvectors import share_eigenvectors
from fenics_rom.reduction.problem import ReductionProblem
from fenics_rom.system.protocols import Array

FIRST = 4  # eigenvectors for each balanced direction, to begin with
FEWEST = 60


class EigenvectorSelection:
    """Selects columns of V for each contact mode; V is computed once and grown when a mode needs more of it.

    Args:
        problem: what is reduced; its shared space, still empty, gets the first eigenvectors.
    """

    def __init__(self, problem: ReductionProblem):
        self._problem = problem
        orders = [problem.order_of(name) or 0 for name in problem.contacts]
        all_needed = problem.lyapunov not in ("krylov", "adi")
        share_eigenvectors(problem, problem.system.elastic_size if all_needed else max(FEWEST, FIRST * max(orders)))
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
            both = min(len(V), len(directions))  # what came into the space later is orthogonal to the other
            covariance = (V[:both].T @ directions[:both]) ** 2 @ σ[:m]  # diagonal of VᵀMT Σ (VᵀMT)ᵀ
            order = np.argsort(covariance)[::-1]
            held = np.cumsum(covariance[order]) / trace
            everything = count == problem.system.elastic_size
            if held[-1] >= problem.share or (everything and held[-1] > problem.share - 1e-9):
                chosen = int(np.argmax(held >= min(problem.share, held[-1]))) + 1
                return V[:, order[:chosen]]
            if everything:
                raise SolverError(f"all {count} eigenvectors hold {held[-1]:.9f} of the trace, not {problem.share:g}")
            self._grow(min(problem.system.elastic_size, 2 * count))

    def _grow(self, count: int) -> None:
        system, space = self._problem.system, self._problem.space
        with self._problem.stages("eigenvectors"):
            _, V = system.algebra.eigenpairs(system.mass, system.stiffness, count, self._problem.factor)
            self._V = space.add(V)
