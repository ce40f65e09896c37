"""The reduced model of one contact mode."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.content import ByContent


@dataclass(frozen=True, eq=False)
class ContactModel(ByContent):
    """The reduced model of one contact mode, in the basis W_i = Q C_i with W_iᵀMW_i = I, W_iᵀKW_i = diag(γ).

    Attributes:
        eigenvalues: γ (m,), ascending, 1/s²; of the rigid motions of a body that is not wholly held 0, exactly.
        damping: W_iᵀDW_i, its diagonal (m,) where D is proportional, else (m, m), 1/s.
        inputs: G = W_iᵀB_i (m, p); the contact's columns, then the actuators', then the loads', kg^-1/2 times N
            per unit of the input.
        coordinates: C_i (k, m), orthonormal columns in the shared basis Q, those of rigid motions first: unit vectors.
        directions: (m, m) orthonormal; after the rigid motions, its first k columns span the reduced model of order k.
        hankel_singular_values: σ (r,), descending, r >= m; what was left out included. Balanced modes have them.
        left_inverse: (m, k) oblique projection from the shared basis; only for switching = "oblique".
        static_error: |K⁻¹B - W_i diag(1/γ) G| / |K⁻¹B| in the mass norm; None where the full model was not at hand.
        frequencies: (f,) at which the frequency response was compared with the full model's, rad/s.
        transfer_errors: (f,) |H(iω) - H_i(iω)| / max |H| in the mass norm, by full solves, to 10 %; the maximum is
            over them.
        contact_points: (P,) nodes at which obstacles can touch it; none where the scene has no contact.
    """

    eigenvalues: Array
    damping: Array
    inputs: Array
    coordinates: Array
    directions: Array
    hankel_singular_values: Array
    left_inverse: Array | None = None
    static_error: float | None = None
    frequencies: Array = field(default_factory=lambda: np.empty(0))
    transfer_errors: Array = field(default_factory=lambda: np.empty(0))
    contact_points: Array = field(default_factory=lambda: np.empty(0, dtype=int))

    def __repr__(self) -> str:
        lowest = self.safe_frequencies[self.rigid :] / math.tau
        rigid = f" ({self.rigid} rigid)" if self.rigid else ""
        from_hertz = f", from {lowest[0]:.3g} Hz" if len(lowest) else ""
        return f"ContactModel: order {self.order}{rigid}, {self.inputs.shape[1]} input columns{from_hertz}"

    @property
    def order(self) -> int:
        """Number m of reduced displacements, rigid and elastic."""
        return len(self.eigenvalues)

    @property
    def rigid(self) -> int:
        """Number ρ of rigid motions among them, the first ones."""
        return int(np.count_nonzero(self.eigenvalues == 0))

    @cached_property
    def safe_frequencies(self) -> Array:
        """√γ (m,) to divide energy coordinates by, rad/s: infinite for rigid motions, of which these hold nothing."""
        return safe_frequencies(self.eigenvalues)

    @cached_property
    def damping_root(self) -> Array:
        """R with RᵀR = D, (m,) where the damping is diagonal, else (m, m): |R v|² is dissipated, and never negative."""
        if self.damping.ndim == 1:
            return np.sqrt(np.maximum(self.damping, 0.0))
        λ, U = np.linalg.eigh(self.damping)
        return np.sqrt(np.maximum(λ, 0.0))[:, None] * U.T


def safe_frequencies(γ: Array) -> Array:
    """√γ to divide by, infinite where γ = 0."""
    return np.where(γ == 0, np.inf, np.sqrt(γ))


def strained_coordinates(κ: Array, model: ContactModel) -> Array:
    """Y (k - rigid, m - rigid): the mode's K-orthonormal vectors in those of the shared basis, orthonormal columns."""
    return (np.sqrt(κ)[:, None] * model.coordinates / model.safe_frequencies)[model.rigid :, model.rigid :]


def neglected(mode: ContactModel) -> float | None:
    """Share of the sum of Hankel singular values that is not in the reduced model."""
    σ = mode.hankel_singular_values
    return float(σ[mode.order - mode.rigid :].sum() / σ.sum()) if len(σ) else None
