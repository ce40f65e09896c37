"""From a subspace to the balanced realization of an input matrix in it."""

import numpy as np

from fenics_rom.reduction.balancing import Balanced, balance, balance_as_printed
from fenics_rom.reduction.common_basis import Subspace
from fenics_rom.reduction.gramians import gramian_factors, square_root, textbook_gramians
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem
from fenics_rom.system.protocols import Array


def balanced_in(problem: ReductionProblem, space: Subspace, inputs: Array) -> Balanced:
    """Balances an input matrix (r, p) in a subspace, whose Gramians are computed exactly."""
    return balance(*gramian_factors(space.eigenvalues, space.damping, inputs, _weight(problem, space.coordinates)))


def balanced_by_textbook(problem: ReductionProblem, B: Array, *, as_printed: bool) -> RankedBasis:
    """A ranked basis by dense Lyapunov equations of the gathered matrices, in the space of all eigenvectors.

    Args:
        problem: what is reduced.
        B: (rows here, p) input matrix.
        as_printed: balance as paper (5) is printed, round-off included.
    """
    system, algebra = problem.system, problem.system.algebra
    identity = np.eye(system.size)[algebra.rows()]
    M, D, K, B, V = (
        algebra.gather(block)
        for block in (*(A @ identity for A in (system.mass, system.damping, system.stiffness)), B, problem.space.basis)
    )
    MV = M @ V  # the inverse of Vᵀ
    Wc, Wo = textbook_gramians(M, D, K, B, MV @ _weight(problem, np.eye(system.size)) @ MV.T)
    plain = balance_as_printed(Wc, Wo) if as_printed else balance(square_root(Wc), square_root(Wo))
    return RankedBasis(MV.T @ plain.transformation, plain.singular_values, True, plain.left_inverse @ V)


def ranked_basis(space: Subspace, balanced: Balanced) -> RankedBasis:
    """The balanced directions in the shared space."""
    return RankedBasis(space.coordinates @ balanced.transformation, balanced.singular_values, hankel=True)


def output_weight(problem: ReductionProblem, X: Array) -> Array:
    """XᵀC CᵀX (r, r) of the output that counts, for M-orthonormal columns X (rows here, r)."""
    inner = problem.system.algebra.inner
    if problem.weighting == "mass":
        return np.eye(X.shape[1])
    if problem.weighting == "nodal":
        return inner(X, X)
    C = inner(X, np.hstack(list(problem.system.outputs.values())))
    return C @ C.T


def _weight(problem: ReductionProblem, S: Array) -> Array:
    """The same for a subspace with coordinates S (k, r)."""
    if problem.weighting == "mass":
        return np.eye(S.shape[1])
    return S.T @ output_weight(problem, problem.space.basis) @ S
