"""One step of passive midpoint integration as a linear map; see runtime/steppers/midpoint.py, which takes it."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, shown
from fenics_rom.rom.contact_model import ContactModel


def checked_dt(dt: float) -> float:
    """A time step, s; a StepError where it is not a positive finite number."""
    if not (is_number(dt) and dt > 0):
        raise StepError(f"dt = {shown(dt)}: use a finite number > 0, in s")
    return float(dt)


def compliance(
    mode: ContactModel, h: float, stiffening_time: float = 0.0, share: Array | None = None
) -> tuple[Array, Array]:
    """A⁻¹ and, but for a rotation, R A⁻¹: (m,) each where the damping is diagonal, else (m, m). h in s.

    `stiffening_time` (s) is that of Maxwell branches, which resist v̂ by so much times γ beside h/2 γ; or times ω P ω,
    where they have a share P (m, m) of the stiffness.

    With S = 2/h + h/2 γ and the singular values P σ Uᵀ of R S^(-1/2), A⁻¹ = S^(-1/2) U (1 + σ²)⁻¹ Uᵀ S^(-1/2), which
    is symmetric and positive in round-off too, and Pᵀ R A⁻¹ = σ (1 + σ²)⁻¹ Uᵀ S^(-1/2): as a product of the two, what a
    strong dashpot dissipates would be lost to cancellation.
    """
    if share is not None:
        return _compliance_of_share(mode, h, stiffening_time, share)
    R, S = mode.damping_root, 2 / h + (h / 2 + stiffening_time) * mode.eigenvalues
    if R.ndim == 1:
        a = 1 / (S + mode.damping)
        return a, R * a
    _, σ, Uᵀ = np.linalg.svd(R / np.sqrt(S))
    # Newton's step towards UᵀU = I, which the SVD keeps to some ten eps. However else U and σ are rounded, the account
    # is that of nearly the same D; but what U lacks of a rotation, the body gains or loses in every step anew.
    Uᵀ += (np.eye(len(σ)) - Uᵀ @ Uᵀ.T) @ Uᵀ / 2
    Uᵀ /= np.sqrt(S)
    root = Uᵀ / np.sqrt(1 + σ[:, None] ** 2)
    return root.T @ root, Uᵀ * (σ / (1 + σ**2))[:, None]


def _compliance_of_share(mode: ContactModel, h: float, stiffening_time: float, share: Array) -> tuple[Array, Array]:
    R, ω, D = mode.damping_root, np.sqrt(mode.eigenvalues), mode.damping
    A = np.diag(2 / h + h / 2 * mode.eigenvalues) + stiffening_time * ω[:, None] * share * ω
    a = np.linalg.inv(A + (np.diag(D) if D.ndim == 1 else D))
    a = (a + a.T) / 2
    return a, R[:, None] * a if R.ndim == 1 else R @ a


def matrices(mode: ContactModel, h: float) -> tuple[Array, Array]:
    """The step and its account, acting on [e, r, u].

    Returns:
        [Φ Ψ] (2m, 2m + p), which gives [e⁺, r⁺], and (m + p, 2m + p) rows: the first m give what has the squared length
        of what is dissipated, the others h Gᵀ v̂, of which u times is supplied, J.
    """
    ω, m = np.sqrt(mode.eigenvalues), mode.order
    right = np.hstack([-np.diag(ω), 2 / h * np.eye(m), mode.inputs])
    v, heat = (part[:, None] * right if part.ndim == 1 else part @ right for part in compliance(mode, h))
    after = np.vstack([h * ω[:, None] * v, 2 * v])
    after[:, : 2 * m] += np.diag(np.repeat([1.0, -1.0], m))
    return after, np.vstack([np.sqrt(h) * heat, h * mode.inputs.T @ v])
