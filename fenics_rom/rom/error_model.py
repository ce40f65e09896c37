"""What a run needs to know how far it is from the full order: a finer model, and the norm of its residual.

The finer model has some directions beside the shared basis: E, with EᵀME = I and EᵀKE = diag(γ). It takes the same
steps under the same inputs, and never switches. It is so much closer to the full order than the reduced models that its
difference to them is an estimate of their errors. How far it is from the full order itself is bounded by its residual,
which is a combination of few columns:

    ρ = (B - M E G) u - (D E - M E D_E) v̂ - (K E - M E diag(γ)) q̂ = Y (R_B u - R_D v̂ - R_K q̂),    YᵀD⁻¹Y = I,

with G = EᵀB and D_E = EᵀDE; so ρᵀD⁻¹ρ is a sum of squares of few numbers, which are known while it runs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.content import ByContent

if TYPE_CHECKING:
    from fenics_rom.mechanics.environment import Environment


@dataclass(frozen=True, eq=False)
class ErrorModel(ByContent):
    """Of a body, for all its contact modes; f directions of the finer model, s independent residuals of it.

    Attributes:
        eigenvalues: γ (f,), ascending, 1/s²; those of rigid motions come first and are 0.
        damping: D_E, (f,) where the damping is proportional, else (f, f), 1/s.
        inputs: G of each contact mode (f, p), kg^-1/2 times N per unit of the input.
        coordinates: the shared basis in E, EᵀMQ (f, k), orthonormal columns.
        outputs: of each output its rows in E (rows, f), kg^-1/2.
        residual_inputs: R_B of each contact mode (s, p), W^1/2 per unit of the input; empty of a body whose damping
            does not resist all, so that there is no bound.
        residual_damping, residual_stiffness: R_D and R_K (s, f), s^-1/2 and s^-3/2.
        output_compliances: of each output (cᵀK⁻¹c)^½ of its rows c (rows,), m/J^1/2; of a body that is not wholly held
            of loads in balance.
        point_inputs: of forces on all contact points EᵀSᵀ (f, 3P), kg^-1/2; None where nothing can touch the body.
    """

    eigenvalues: Array
    damping: Array
    inputs: Mapping[str, Array]
    coordinates: Array
    outputs: Mapping[str, Array]
    residual_inputs: Mapping[str, Array]
    residual_damping: Array
    residual_stiffness: Array
    output_compliances: Mapping[str, Array]
    point_inputs: Array | None = None

    def finer_model(self, contact: str, *, touched: bool = False) -> ContactModel:
        """The finer model under the inputs of a contact mode and, where it is touched, forces on contact points."""
        pushed = [self.inputs[contact]]
        if touched and self.point_inputs is not None:
            pushed.append(self.point_inputs)
        whole = np.eye(len(self.eigenvalues))
        return ContactModel(
            eigenvalues=self.eigenvalues,
            damping=self.damping,
            inputs=np.hstack(pushed),
            coordinates=whole,
            directions=whole,
            hankel_singular_values=np.empty(0),
        )

    @property
    def has_bound(self) -> bool:
        """Whether damping resists all, so that the residual bounds what the estimate misses."""
        return bool(self.residual_inputs)

    @property
    def couples_rigid_motions(self) -> bool:
        """Whether dampers couple rigid motions with what strains: then the former have errors, too."""
        rigid, D = int(np.count_nonzero(self.eigenvalues == 0)), self.damping
        return D.ndim == 2 and bool(np.abs(D[:rigid, rigid:]).max(initial=0.0) > COUPLED * np.abs(D).max())


COUPLED = 1e-12  # share of the largest damping that is no round-off


def untold_errors(environment: "Environment", *, deforms: bool) -> str:
    """What of a body keeps its errors from being known; empty where nothing does."""
    reasons = {
        "large deformation": deforms,
        "a moving frame": environment.is_moving,
        "no inertia": not environment.has_inertia,
        "actuators that are given strokes": len(environment.controls) > len(environment.bars),
        "surfaces that are rigid and turn far": bool(environment.bars),
        "friction of tendons": bool(environment.guides),
        "a material that relaxes": environment.viscoelasticity is not None,
    }
    return next((reason for reason, there in reasons.items() if there), "")
