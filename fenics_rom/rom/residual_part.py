"""What one contact mode lacks at the contact points, from what the shared basis lacks; see residual_compliance.

In K-orthonormal coordinates of the shared basis, and then of what that lacks, the points have the rows
H = [S Q diag(κ)^-½, L], a contact mode spans orthonormal columns Y_i, and R_i = H (I - Y_i Y_iᵀ) Hᵀ + ε.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.kept_rows import RowsOperator
from fenics_rom.rom.block_rows import BlockRows
from fenics_rom.rom.contact_model import ContactModel, strained_coordinates
from fenics_rom.rom.residual_compliance import ResidualCompliance

COLUMNS_AT_ONCE = 1200  # of products: fewer than thousands of points have
LARGEST_WHOLE = 256  # rows of a triangular matrix that is inverted as any other


@dataclass(frozen=True, eq=False)
class ResidualPart:
    """What one contact mode lacks.

    Attributes:
        points: H (3P, k - rigid) within the shared basis, (m/N)^1/2; the same of all contact modes.
        basis: Y (k - rigid, m - rigid), orthonormal columns: the mode's in the shared basis, both K-orthonormal.
        basis_points: H Y (3P, m - rigid).
        operator: R = C Cᵀ (3P, 3P), m/N.
        time_constant: τ, s; τ² is the mean ratio of inertia to stiffness of orthogonal shapes that count alike.
        root: C⁻¹, where it was made already.
    """

    points: Array
    basis: Array
    basis_points: Array
    operator: Array | RowsOperator[BlockRows]
    time_constant: float
    root: Array | None = None

    @cached_property
    def compliance(self) -> Array:
        """R (3P, 3P) as a whole, m/N."""
        return self.operator if isinstance(self.operator, np.ndarray) else self.operator.whole()

    @cached_property
    def inverse_root(self) -> Array:
        """C⁻¹ (3P, 3P), (N/m)^1/2, for switches: of thousands of points it takes seconds, and as much room as R."""
        return _inverse_root_of(self.compliance) if self.root is None else self.root

    def strained(self, g: Array) -> Array:
        """What of it lies in the shared basis under forces g (..., 3P), N, in K-orthonormal coordinates, J^1/2."""
        within: Array = g @ self.points - g @ self.basis_points @ self.basis.T
        return within


def strained_points(κ: Array, rows: Array) -> Array:
    """H (3P, k - rigid) within the shared basis, from the rows S Q (3P, k) of the contact points in it."""
    rigid = int(np.count_nonzero(κ == 0))
    strained: Array = rows[:, rigid:] / np.sqrt(κ[rigid:])
    return strained


def residual_part(κ: Array, model: ContactModel, H: Array, residual: ResidualCompliance) -> ResidualPart:
    """What a contact mode lacks of the static displacements; κ (k,), 1/s², of the shared basis."""
    Y = strained_coordinates(κ, model)
    HY = H @ Y
    τ2_within, τ2_beyond = 1 / κ[model.rigid :], residual.time_constants**2
    # Inertia that shapes within Q share with those beyond is neglected. Each shape counts alike, however much it
    # yields: the few that yield most are slow, but what yields between neighbours, on which friction depends, is not.
    if residual.static is not None:  # of many points about as many shapes are lacking
        R = RowsOperator(BlockRows(residual.static, residual.floor, HY))
        shares = 1 - np.square(Y).sum(axis=1)
        τ2 = (shares @ τ2_within + τ2_beyond.sum()) / (shares.sum() + len(τ2_beyond))
        return ResidualPart(H, Y, HY, R, float(np.sqrt(τ2)))
    assert residual.factor is not None
    lacking = np.hstack([H - HY @ Y.T, residual.factor])
    R = lacking @ lacking.T
    R.ravel()[:: len(R) + 1] += residual.floor
    root = _inverse_root_of(R)
    some = (slice(first, first + COLUMNS_AT_ONCE) for first in range(0, lacking.shape[1], COLUMNS_AT_ONCE))
    shares = np.concatenate([np.square(root @ lacking[:, columns]).sum(axis=0) for columns in some])
    τ2 = shares @ np.concatenate([τ2_within, τ2_beyond]) / len(R)
    return ResidualPart(H, Y, HY, R, float(np.sqrt(τ2)), root)


def _inverse_root_of(R: Array) -> Array:
    """C⁻¹ of R = C Cᵀ."""
    return inverse_of_lower(np.linalg.cholesky(R))


def inverse_of_lower(L: Array) -> Array:
    """L⁻¹ of a lower triangular matrix, by halves: of thousands of rows a sixth of the arithmetic of any inverse."""
    if len(L) <= LARGEST_WHOLE:
        return np.linalg.inv(L)
    half, inverse = len(L) // 2, np.zeros_like(L)
    first, last = inverse[:half, :half], inverse[half:, half:]
    first[:], last[:] = inverse_of_lower(L[:half, :half]), inverse_of_lower(L[half:, half:])
    inverse[half:, :half] = -last @ (L[half:, :half] @ first)
    return inverse
