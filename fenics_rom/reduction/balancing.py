"""Second-order balanced truncation by the position Gramians, paper (5)-(8), in coordinates with M = I."""

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Balanced:
    """A balanced realization, as far as it is numerically there.

    Attributes:
        singular_values: σ (r,), Hankel singular values of the position Gramians, descending.
        transformation: T (k, r) with Tᵀ Wo T = T⁻¹ Wc T⁻ᵀ = diag(σ).
        left_inverse: (r, k), the paper's P T̄⁻¹ (7): an oblique projection.
    """

    singular_values: Array
    transformation: Array
    left_inverse: Array


def balance(Wc: Array, Wo: Array) -> Balanced:
    """Balances two position Gramians.

    With Wc = Z Zᵀ and Wo = Y Yᵀ, the singular value decomposition of Yᵀ Z gives σ without squaring them.
    Directions that are lost in round-off of either Gramian are not returned.

    Args:
        Wc, Wo: (k, k), symmetric positive semi-definite.
    """
    Z, Y = _square_root(Wc), _square_root(Wo)
    _, σ, Uᵀ = np.linalg.svd(Y.T @ Z, full_matrices=False)
    there = σ > _round_off(σ)
    σ, U = σ[there], Uᵀ[there].T
    T = Z @ U / np.sqrt(σ)
    return Balanced(σ, T, (U.T @ Z.T @ Wo) / σ[:, None] ** 1.5)


def balance_as_printed(Wc: Array, Wo: Array) -> Balanced:
    """Standard balanced truncation as paper (5) is printed: Wc = RᵀR, U Λ² Uᵀ = R Wo Rᵀ, every direction taken.

    Squaring and the missing floor fill the trailing directions with round-off. What the oblique projections of such
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


def order_of(σ: Array, order: int | None, tolerance: float) -> int:
    """The order asked for, or the smallest whose neglected σ sum to at most `tolerance` of all."""
    if order is not None:
        return order
    neglected = np.concatenate([np.cumsum(σ[::-1])[::-1][1:], [0.0]])
    return int(np.argmax(neglected <= tolerance * σ.sum())) + 1


def orthonormal_span(T: Array, order: int) -> Array:
    """Orthonormal basis of the leading columns of T, as many as are numerically independent, (k, at most order)."""
    Q, R = np.linalg.qr(T[:, :order] / np.linalg.norm(T[:, :order], axis=0))
    dependent = np.abs(np.diag(R)) < 1e-10
    kept = int(dependent.argmax()) if dependent.any() else Q.shape[1]
    return Q[:, :kept]


def _square_root(W: Array) -> Array:
    """Z with Z Zᵀ = W, without the directions that are round-off."""
    w, E = np.linalg.eigh(W)
    there = w > _round_off(w)
    return E[:, there] * np.sqrt(w[there])


def _round_off(values: Array) -> float:
    return float(values.max(initial=0.0) * len(values) * np.finfo(float).eps)
