"""Generalized eigenvectors in the shared space: computed once for all contact modes, and selected for each.

The selection is the paper's passive reduction: eigenvectors that hold a share of a balanced basis' covariance, paper
(12)-(13).
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, SolverError
from fenics_rom.reduction.common_basis import orthonormalize_against
from fenics_rom.reduction.problem import ReductionProblem

EIGENVECTORS_PER_DIRECTION = 4  # to begin with
MIN_EIGENVECTORS = 60
SHARE_ROUND_OFF = 1e-9  # by which all eigenvectors together may miss the share


def share_eigenvectors(problem: ReductionProblem, count: int) -> None:
    """Makes the lowest eigenvectors the first columns of the shared space, which is empty or holds some and no more."""
    system, space = problem.system, problem.space
    count = min(count, system.elastic_size)
    if space.eigenvectors >= count:
        return
    if space.size > space.eigenvectors:
        raise SceneError(f"{count} eigenvectors were asked for after other directions; ask for them first")
    problem.stages.report("eigenvectors", 0, count)
    with problem.stages("eigenvectors"):
        _, V = system.algebra.eigenpairs(system.mass, system.stiffness, count, problem.factor)
        if space.size:  # those of equal eigenvalues may have come out otherwise than before
            V, *_ = orthonormalize_against(system, V, space.basis)
            V = V @ np.linalg.eigh(system.algebra.inner(V, system.stiffness @ V))[1]
        space.append(V)
    space.eigenvectors = space.size
    problem.stages.report("eigenvectors", count, count)


class EigenvectorSelection:
    """Selects columns of V for each contact mode; V is computed once and grown when a mode needs more of it.

    The first eigenvectors go into the problem's shared space, which is still empty.
    """

    def __init__(self, problem: ReductionProblem):
        self._problem = problem
        orders = [problem.order_of(name) or 0 for name in problem.contacts]
        all_needed = problem.lyapunov not in ("krylov", "adi")
        first = max(MIN_EIGENVECTORS, EIGENVECTORS_PER_DIRECTION * max(orders))
        share_eigenvectors(problem, problem.system.elastic_size if all_needed else first)
        self._V = np.eye(problem.space.eigenvectors)  # coordinates

    def select(self, directions: Array, σ: Array) -> Array:
        """Coordinates (k, m_ξ) of eigenvectors, by falling covariance with a balanced basis T_i (k, m); often m_ξ >= m.

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
            with problem.stages("eigenvectors"):
                system, wanted = problem.system, min(problem.system.elastic_size, 2 * count)
                _, more = system.algebra.eigenpairs(system.mass, system.stiffness, wanted, problem.factor)
                self._V = problem.space.add(more)
