"""Passive midpoint integration (PMI) of one reduced model at one step size.

Kim, Lee et al., IJRR, doi 10.1177/0278364917731821; the paper's (2)-(4). With M = I, K = diag(γ), ω = √γ and the state
in energy coordinates e = ω q and r, so that (eᵀe + rᵀr)/2 is the stored energy:

    v̂ = A⁻¹ (G u + 2/h r - ω e),    A = 2/h + D + h/2 γ,
    e⁺ = e + h ω v̂,    r⁺ = 2 v̂ - r,

and E⁺ - E = h (G u)ᵀ v̂ - h v̂ᵀ D v̂ exactly, whatever h is. Without input the step is a contraction.
"""

import math

import numpy as np

from fenics_rom.errors import StepError
from fenics_rom.rom import Mode

Array = np.ndarray


def checked_dt(dt: float) -> float:
    """A time step, s.

    Raises:
        StepError: it is not a positive finite number.
    """
    if not (isinstance(dt, int | float | np.number) and math.isfinite(dt) and dt > 0):
        raise StepError(f"dt = {dt!r}: allowed is a finite number > 0, in s")
    return float(dt)


def damping_root(mode: Mode) -> Array:
    """R with RᵀR = D, (m,) where the damping is diagonal, else (m, m): |R v|² is dissipated, and never negative."""
    D = mode.damping
    if D.ndim == 1:
        return np.sqrt(np.maximum(D, 0.0))
    λ, U = np.linalg.eigh(D)
    return np.sqrt(np.maximum(λ, 0.0))[:, None] * U.T


def compliance(mode: Mode, h: float) -> tuple[Array, Array]:
    """A⁻¹ and R A⁻¹: (m,) each where the damping is diagonal, else (m, m). h in s.

    With S = 2/h + h/2 γ and the singular values P σ Uᵀ of R S^(-1/2), A⁻¹ = S^(-1/2) U (1 + σ²)⁻¹ Uᵀ S^(-1/2), which
    is symmetric and positive in round-off too, and R A⁻¹ = P σ (1 + σ²)⁻¹ Uᵀ S^(-1/2): as a product of the two, what a
    strong dashpot dissipates would be lost to cancellation.
    """
    R, S = damping_root(mode), 2 / h + h / 2 * mode.eigenvalues
    if R.ndim == 1:
        a = 1 / (S + mode.damping)
        return a, R * a
    P, σ, Uᵀ = np.linalg.svd(R / np.sqrt(S))
    Uᵀ /= np.sqrt(S)
    root = Uᵀ / np.sqrt(1 + σ[:, None] ** 2)
    return root.T @ root, P @ (Uᵀ * (σ / (1 + σ**2))[:, None])


def _right_hand_side(mode: Mode, h: float) -> Array:
    """The rows of G u + 2/h r - ω e, (m, 2m + p), acting on [e, r, u]."""
    return np.hstack([-np.diag(np.sqrt(mode.eigenvalues)), 2 / h * np.eye(mode.order), mode.inputs])


def _times(rows: Array, a: Array) -> Array:
    return a[:, None] * rows if a.ndim == 1 else a @ rows


def transition(mode: Mode, h: float) -> Array:
    """[Φ Ψ], (2m, 2m + p): a step takes [e, r, u] to [e⁺, r⁺]."""
    v, m = _times(_right_hand_side(mode, h), compliance(mode, h)[0]), mode.order
    after = np.vstack([h * np.sqrt(mode.eigenvalues)[:, None] * v, 2 * v])
    after[:, : 2 * m] += np.diag(np.repeat([1.0, -1.0], m))
    return after


def account(mode: Mode, h: float) -> Array:
    """Rows of √h R v̂ and of h Gᵀ v̂, (m + p, 2m + p), acting on [e, r, u].

    The squared length of the former is dissipated in a step; u times the latter is supplied, J.
    """
    right, (a, Ra) = _right_hand_side(mode, h), compliance(mode, h)
    return np.vstack([np.sqrt(h) * _times(right, Ra), h * mode.inputs.T @ _times(right, a)])
