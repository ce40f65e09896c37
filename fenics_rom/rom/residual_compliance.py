"""What contact points yield at rest beyond a reduced basis: residual compliance (MacNeal's and Rubin's flexibility).

With S the rows of the contact points and P_i the K-orthogonal projection onto the basis W_i of a contact mode,

    R_i = S K⁻¹ Sᵀ - S W_i diag(1/γ_i) W_iᵀ Sᵀ = S (I - P_i) K⁻¹ Sᵀ ⪰ 0.

The shared basis Q lacks R_Q = L Lᵀ + ε, which is all that has to be kept: what a contact mode lacks of Q is known from
its coordinates; see residual_part. Of many points S K⁻¹ Sᵀ itself is kept, by blocks, which take less room: far from
some points it is smooth, while the shapes of Q that R_Q lacks go up and down all over the body.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from numpy import ndarray as Array

from fenics_rom.rom.block_matrix import BlockMatrix
from fenics_rom.rom.content import ByContent


@dataclass(frozen=True, eq=False)
class ResidualCompliance(ByContent):
    """Of all contact points of a body.

    Attributes:
        factor: L (3P, r), (m/N)^1/2, of K-orthogonal shapes, in the order of `ContactPoints`. Of 300 points at most
            they are M-orthogonal, too. None where `static` is there.
        time_constants: τ (r,), s, of these shapes; τ² is the ratio of their inertia to their stiffness.
        floor: ε, m/N, in every direction, in place of the eigenvalues of R_Q that are smaller; with `static` also for
            what its blocks leave out, so that no contact mode's residual compliance is less than it is.
        damping: β, s, ratio of damping to stiffness.
        dt: s, at which the errors are; 0 where they were not measured.
        errors: by contact mode, of the Delassus operator against that of the full model, relative in the Frobenius
            norm, without and with the residual compliance; of some columns.
        static: S K⁻¹ Sᵀ (3P, 3P), m/N, but for ε, in place of L.
    """

    factor: Array | None
    time_constants: Array
    floor: float
    damping: float
    dt: float = 0.0
    errors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    static: BlockMatrix | None = None
