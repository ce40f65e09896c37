"""Position blocks of the controllability and observability Gramians of M v̇ + D v + K x = B u, y = Cᵀ x.

Everything is in coordinates in which M = I and K = diag(γ), of the whole model or of a subspace of it.
The closed forms hold for D = diag(d); any other D takes a dense Lyapunov equation.
"""

import numpy as np
import scipy.linalg

from fenics_rom.errors import SolverError

Array = np.ndarray


def controllability(γ: Array, damping: Array, G: Array) -> Array:
    """Position block Wc of the controllability Gramian, (k, k).

    Args:
        γ: (k,) generalized eigenvalues, 1/s².
        damping: (k,) diagonal of D, or D itself (k, k), 1/s.
        G: (k, p) input matrix.

    Raises:
        SolverError: D leaves a motion undamped, so that the Gramian does not exist.
    """
    _refuse_undamped(damping)
    if damping.ndim == 1:
        return (G @ G.T) * _closed_form(γ, damping)
    ω = np.sqrt(γ)
    forced = np.zeros((2 * len(γ), 2 * len(γ)))
    forced[len(γ) :, len(γ) :] = G @ G.T
    return _lyapunov(_scaled_state(ω, damping), forced) / ω[:, None] / ω


def observability(γ: Array, damping: Array, weight: Array) -> Array:
    """Position block Wo of the observability Gramian, (k, k): x₀ᵀ Wo x₀ = ∫ |y|² dt, released at rest from x₀.

    For weight = I (the mass-weighted shape) it is diagonal, d/(2γ) + 1/(2d), which is
    β/2 M + α/2 M K⁻¹ M + ½ M D⁻¹ M for D = α M + β K.

    Args:
        γ: (k,) generalized eigenvalues, 1/s².
        damping: (k,) diagonal of D, or D itself (k, k), 1/s.
        weight: (k, k) C Cᵀ.

    Raises:
        SolverError: as `controllability`.
    """
    _refuse_undamped(damping)
    if damping.ndim == 1:
        d, γd = damping, γ * damping
        sums = d[:, None] + d
        return weight * _closed_form(γ, d) * (d[:, None] * d + (γd[:, None] + γd) / sums)
    ω = np.sqrt(γ)
    seen = np.zeros((2 * len(γ), 2 * len(γ)))
    seen[: len(γ), : len(γ)] = weight / ω[:, None] / ω
    return _lyapunov(_scaled_state(ω, damping).T, seen) * ω[:, None] * ω


def textbook_gramians(M: Array, D: Array, K: Array, B: Array, CCᵀ: Array) -> tuple[Array, Array]:
    """Wc and Wo of whole matrices, (n, n) each, by dense Lyapunov equations of the plain first-order form, paper (5).

    The Bartels-Stewart algorithm on the state (x, v): it uses neither V nor any closed form, so it is the independent
    check of the other routes. Its round-off is that of matrices whose norm is the largest γ; trailing directions of
    small σ are lost in it long before they are in the other routes.

    Args:
        M, D, K: (n, n).
        B: (n, p) input matrix.
        CCᵀ: (n, n) output weight.
    """
    n = len(M)
    inverse = scipy.linalg.cho_factor(M)
    zero = np.zeros((n, n))
    A = np.block([[zero, np.eye(n)], [-scipy.linalg.cho_solve(inverse, K), -scipy.linalg.cho_solve(inverse, D)]])
    accelerated = scipy.linalg.cho_solve(inverse, B)
    forced = np.block([[zero, zero], [zero, accelerated @ accelerated.T]])
    seen = np.block([[CCᵀ, zero], [zero, zero]])
    return _lyapunov(A, forced), _lyapunov(A.T, seen)


def _refuse_undamped(damping: Array) -> None:
    lowest = damping.min() if damping.ndim == 1 else np.linalg.eigvalsh(damping)[0]
    if lowest <= 0:
        raise SolverError(
            "balanced reduction needs damping of every motion: without it the Gramians are infinite; "
            "name effects.damping with alpha or beta above 0 (small will do)"
        )


def _closed_form(γ: Array, d: Array) -> Array:
    """Solution of the 2 × 2 Lyapunov equations of every pair of eigenvectors, for a unit right-hand side."""
    sums = d[:, None] + d
    cross = d[:, None] * γ
    return sums / (sums * (cross + cross.T) + (γ[:, None] - γ) ** 2)


def _scaled_state(ω: Array, D: Array) -> Array:
    """A of the state (ω q, r): skew-symmetric but for the damping, which keeps its Lyapunov equations well scaled."""
    return np.block([[np.zeros_like(D), np.diag(ω)], [-np.diag(ω), -D]])


def _lyapunov(A: Array, right: Array) -> Array:
    """Leading block of the symmetric X with A X + X Aᵀ + right = 0."""
    try:
        X = scipy.linalg.solve_continuous_lyapunov(A, -right)
    except np.linalg.LinAlgError as error:
        raise SolverError(f"dense Lyapunov equation of size {len(A)} could not be solved: {error}") from error
    half = len(A) // 2
    return (X[:half, :half] + X[:half, :half].T) / 2
