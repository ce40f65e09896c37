"""Position blocks of the controllability and observability Gramians of M v̇ + D v + K x = B u, y = Cᵀ x.

Everything is in coordinates in which M = I and K = diag(γ), of the whole model or of a subspace of it.
The closed forms hold for D = diag(d); any other D takes a dense Lyapunov equation.
"""

import numpy as np
import scipy.linalg
from numpy import ndarray as Array

from fenics_rom.errors import SolverError

ROUND_OFF = float(np.finfo(float).eps)
LEAST_DECAY = 1e-14  # share of the largest frequency that a rate of decay must exceed to be one
NO_DAMPING = (
    "balanced reduction needs damping of every motion: without it the Gramians are infinite; "
    "name effects.damping with alpha or beta above 0 (small will do), or take method = 'modal'"
)


def gramian_factors(γ: Array, damping: Array, G: Array, weight: Array) -> tuple[Array, Array]:
    """Z and Y with Wc = Z Zᵀ and Wo = Y Yᵀ, (k, at most k) each.

    Wo answers x₀ᵀ Wo x₀ = ∫ |y|² dt for a release at rest from x₀. For weight = I (the mass-weighted shape) and
    D = diag(d) it is diagonal, d/(2γ) + 1/(2d), which is β/2 M + α/2 M K⁻¹ M + ½ M D⁻¹ M for D = α M + β K.

    Args:
        γ: (k,) generalized eigenvalues, 1/s².
        damping: (k,) diagonal of D, or D itself (k, k), 1/s.
        G: (k, p) input matrix.
        weight: (k, k) C Cᵀ of the outputs y = Cᵀ x.

    Raises:
        SolverError: D leaves a motion undamped, so that the Gramians do not exist.
    """
    if damping.ndim == 2:
        return _dense_factors(np.sqrt(γ), damping, G, weight)
    if damping.min() <= 0:
        raise SolverError(NO_DAMPING)
    d, γd = damping, γ * damping
    pairs, sums = _closed_form(γ, d), d[:, None] + d
    Wc, Wo = (G @ G.T) * pairs, weight * pairs * (d[:, None] * d + (γd[:, None] + γd) / sums)
    return square_root(Wc, noise=0.0), square_root(Wo, noise=0.0)


def square_root(W: Array, noise: float = ROUND_OFF) -> Array:
    """Z (k, r) with Z Zᵀ = W, positive semi-definite, by Cholesky's algorithm with pivoting.

    Its small columns are as accurate as the entries of W that they come from, where an eigenvalue decomposition
    leaves in all of them the round-off of the largest: of closed forms, σ of 1e-8 of the largest keep nine digits.
    `noise` is the round-off in W as a share of its largest entry; none where every entry is accurate by itself.
    """
    L, pivots, rank, _ = scipy.linalg.lapack.dpstrf(W, lower=True, tol=noise * len(W) * W.diagonal().max())
    Z = np.empty((len(W), rank))
    Z[pivots - 1] = np.tril(L)[:, :rank]
    return Z


def _dense_factors(ω: Array, D: Array, G: Array, weight: Array) -> tuple[Array, Array]:
    """By one Schur form of the state (ω q, r), whose A is skew-symmetric but for the damping, and so well scaled.

    Changing the sign of r transposes A and leaves position blocks as they are, so one equation serves both Gramians.
    """
    k = len(ω)
    A = np.block([[np.zeros((k, k)), np.diag(ω)], [-np.diag(ω), -D]])
    if not np.isfinite(A).all():
        raise SolverError("stiffness or damping is too large for double precision: are its units N/m and N s/m?")
    T, U = scipy.linalg.schur(A)
    if np.diag(T).max() >= -LEAST_DECAY * ω.max():  # the real parts of its eigenvalues
        raise SolverError(NO_DAMPING)
    forced, observed = np.zeros((2 * k, 2 * k)), np.zeros((2 * k, 2 * k))
    forced[k:, k:] = G @ G.T
    observed[:k, :k] = weight / ω[:, None] / ω
    Z, Y = (square_root(_schur_lyapunov(T, U, right)[:k, :k]) for right in (forced, observed))
    return Z / ω[:, None], Y * ω[:, None]


def textbook_gramians(M: Array, D: Array, K: Array, B: Array, CCᵀ: Array) -> tuple[Array, Array]:
    """Wc and Wo of whole matrices, (n, n) each, by dense Lyapunov equations of the plain first-order form, paper (5).

    The Bartels-Stewart algorithm on the state (x, v): it uses neither V nor any closed form, so it is the independent
    check of the other routes. Its round-off is that of matrices whose norm is the largest γ; trailing directions of
    small σ are lost in it long before they are in the other routes.
    """
    n = len(M)
    inverse = scipy.linalg.cho_factor(M)
    zero = np.zeros((n, n))
    A = np.block([[zero, np.eye(n)], [-scipy.linalg.cho_solve(inverse, K), -scipy.linalg.cho_solve(inverse, D)]])
    accelerated = scipy.linalg.cho_solve(inverse, B)
    forced = np.block([[zero, zero], [zero, accelerated @ accelerated.T]])
    observed = np.block([[CCᵀ, zero], [zero, zero]])
    return _lyapunov(A, forced)[:n, :n], _lyapunov(A.T, observed)[:n, :n]


def _closed_form(γ: Array, d: Array) -> Array:
    """Solution of the 2 × 2 Lyapunov equations of every pair of eigenvectors, for a unit right-hand side."""
    sums = d[:, None] + d
    cross = d[:, None] * γ
    return sums / (sums * (cross + cross.T) + (γ[:, None] - γ) ** 2)


def _lyapunov(A: Array, right: Array) -> Array:
    """Symmetric X with A X + X Aᵀ + right = 0."""
    T, U = scipy.linalg.schur(A)
    return _schur_lyapunov(T, U, right)


def _schur_lyapunov(T: Array, U: Array, right: Array) -> Array:
    """The same for A = U T Uᵀ (Bartels & Stewart 1972)."""
    Y, scale, info = scipy.linalg.lapack.dtrsyl(T, T, -U.T @ right @ U, tranb="T")
    if info or not np.isfinite(Y).all():
        raise SolverError(f"dense Lyapunov equation of size {len(T)} could not be solved: two eigenvalues sum to zero")
    X = U @ (Y / scale) @ U.T  # LAPACK solves for `scale` times the right-hand side where numbers would overflow
    return (X + X.T) / 2
