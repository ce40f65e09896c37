"""Second-order balanced truncation by the position Gramians, paper (5)-(8)."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SolverError
from fenics_rom.reduction.common_basis import Subspace
from fenics_rom.reduction.gramians import gramian_factors, square_root, textbook_gramians
from fenics_rom.reduction.problem import RankedBasis, ReductionProblem

ROUND_OFF = 1e-12  # share of σ_1 below which σ is noise
DEPENDENCE_TOLERANCE = 1e-10  # share of a unit column that must be new for it to count as a direction


@dataclass(frozen=True)
class Balanced:
    """A balanced realization, as far as it stands above round-off."""

    singular_values: Array  # σ (r,), Hankel singular values of the position Gramians, descending
    transformation: Array  # T (k, r) with Tᵀ Wo T = T⁻¹ Wc T⁻ᵀ = diag(σ)
    left_inverse: Array  # (r, k), the paper's P T̄⁻¹ (7): an oblique projection


def balance(Z: Array, Y: Array) -> Balanced:
    """Balances Wc = Z Zᵀ and Wo = Y Yᵀ, of which Yᵀ Z gives σ without squaring them, and both transformations.

    Raises:
        SolverError: there is nothing to balance.
    """
    V, σ, Uᵀ = np.linalg.svd(Y.T @ Z, full_matrices=False)
    if not σ.any():
        raise SolverError("the Gramians vanish: inputs move the body by less than numbers can hold")
    significant = σ > ROUND_OFF * σ[0]
    V, σ, U = V[:, significant], σ[significant], Uᵀ[significant].T
    return Balanced(σ, Z @ U / np.sqrt(σ), V.T @ Y.T / np.sqrt(σ)[:, None])


def balance_as_printed(Wc: Array, Wo: Array) -> Balanced:
    """Standard balanced truncation as paper (5) is printed: Wc = RᵀR, U Λ² Uᵀ = R Wo Rᵀ, every direction taken.

    Squaring, without a threshold, fills the trailing directions with round-off. What the oblique projections of such
    models do to the energy is the paper's Fig. 2; this is here to show it, and for nothing else.
    """
    w, E = np.linalg.eigh(Wc)
    Z = E[:, w > 0] * np.sqrt(w[w > 0])
    σ2, U = np.linalg.eigh(Z.T @ Wo @ Z)
    σ2, U = σ2[σ2 > 0][::-1], U[:, σ2 > 0][:, ::-1]
    σ = np.sqrt(σ2)
    return Balanced(σ, Z @ U / np.sqrt(σ), (U.T @ Z.T @ Wo) / σ[:, None] ** 1.5)


def choose_order(σ: Array, order: int | None, tolerance: float) -> int:
    """The order asked for, or the smallest whose neglected σ sum to at most `tolerance` of all."""
    if order is not None:
        return order
    neglected = np.concatenate([np.cumsum(σ[::-1])[::-1][1:], [0.0]])
    return int(np.argmax(neglected <= tolerance * σ.sum())) + 1


def orthonormal_span(T: Array, order: int) -> Array:
    """Orthonormal basis of the leading columns of T, as many as are numerically independent, (k, at most order)."""
    Q, R = np.linalg.qr(T[:, :order] / np.linalg.norm(T[:, :order], axis=0))
    dependent = np.abs(np.diag(R)) < DEPENDENCE_TOLERANCE
    rank = int(dependent.argmax()) if dependent.any() else Q.shape[1]
    return Q[:, :rank]


def balanced_in(problem: ReductionProblem, space: Subspace, inputs: Array) -> Balanced:
    """Balances an input matrix (r, p) in a subspace, whose Gramians are computed exactly."""
    return balance(*gramian_factors(space.eigenvalues, space.damping, inputs, _weight(problem, space.coordinates)))


def balanced_by_textbook(problem: ReductionProblem, B: Array, *, as_printed: bool) -> RankedBasis:
    """A ranked basis by dense Lyapunov equations of the gathered matrices, in the space of all eigenvectors.

    Balanced `as_printed` in paper (5), round-off is included.
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
