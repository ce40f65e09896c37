"""Second-order balanced truncation by the position Gramians, paper (5)-(8), in coordinates with M = I."""

from dataclasses import dataclass

import numpy as np

from fenics_rom.errors import SolverError

Array = np.ndarray
ROUND_OFF = 1e-12  # share of σ_1 below which σ is noise
DEPENDENCE_TOLERANCE = 1e-10  # share of a unit column that must be new for it to count as a direction


@dataclass(frozen=True)
class Balanced:
    """A balanced realization, as far as it stands above round-off.

    Attributes:
        singular_values: σ (r,), Hankel singular values of the position Gramians, descending.
        transformation: T (k, r) with Tᵀ Wo T = T⁻¹ Wc T⁻ᵀ = diag(σ).
        left_inverse: (r, k), the paper's P T̄⁻¹ (7): an oblique projection.
    """

    singular_values: Array
    transformation: Array
    left_inverse: Array


def balance(Z: Array, Y: Array) -> Balanced:
    """Balances Wc = Z Zᵀ and Wo = Y Yᵀ.

    The singular value decomposition of Yᵀ Z gives σ without squaring them, and with it both transformations.

    Args:
        Z, Y: (k, any).

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

    Args:
        Wc, Wo: (n, n), symmetric.
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
