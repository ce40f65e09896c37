"""What goes backwards through steps: the derivatives of a number J with all that they carry along."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
    from fenics_rom.mechanics.contact_pairs import Pairs, SolvedPairs
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

    ContactStep = Callable[[], tuple[Pairs | None, SolvedPairs | None]]  # as `ContactSolver.last_step`

NONE = np.empty(0)


class StateAdjoint(NamedTuple):
    """Derivatives of J with what is there between two steps; empty is none."""

    state: Array  # [e, r] (2m,)
    rigid: Array  # displacement along the rigid motions (ρ,)
    auxiliary: Array  # as `Kernel.auxiliary`
    forces: Array = NONE  # of contact in the last step (3P,)
    tangent: Array = NONE  # as `Kernel.tangent` (m, m)
    reactions: Array = NONE  # as `Kernel.reactions` (n,)
    span: Array = NONE  # of a model with further modes: its coordinates in the shared basis (k, m)
    frame: Array = NONE  # (15,): p, R by a rotation about its axes, v, of a base in these, ω in these, and the last ω̂


class Reads(NamedTuple):
    """Derivatives of J with what is read after a step."""

    q: Array  # displacement (m,) of the contact mode
    beyond: Array  # (k - rigid,) of the residual part, K-orthonormal in the shared basis
    energy: float
    place: Array = NONE  # where a frame that moves is (6,), as above


class StepSlopes(NamedTuple):
    """What a step passes back."""

    before: StateAdjoint
    inputs: Array  # (p,)
    frequencies: Array  # ω (m,)
    damping: Array  # (m,) or (m, m), as the contact model has it
    base: Array = NONE  # where the base ends, and its twist there (12,), as above


class SwitchAdjoint(Protocol):
    """A switch of contact modes, to go back through."""

    @property
    def is_kink(self) -> bool:
        """Whether there is no derivative: a further mode begins to be needed."""

    def pull_back(self, after: StateAdjoint) -> StateAdjoint:
        """Derivatives before it from those after it."""


class SameBasis:
    """A switch between contact modes that share a basis: of inputs alone."""

    is_kink = False

    def pull_back(self, after: StateAdjoint) -> StateAdjoint:
        """As in SwitchAdjoint."""
        return after


def pose_pulled_back(pose: "BaseState", frame_: Array, *, is_base: bool = False) -> dict[str, Array]:
    """Derivatives with a pose in world axes, whose rotation is by a small vector, from `StateAdjoint.frame`.

    ω = Rᵀ (angular velocity), which stays as it is in world axes where R turns; likewise v of a base.
    """
    from fenics_rom.mechanics.frame_motion import rotation_matrix  # here, as few bodies turn

    p_, φ_, v_, ω_ = frame_[:12].reshape(4, 3)
    R = rotation_matrix(pose.rotation)
    turned = φ_ - np.cross(R.T @ pose.angular_velocity, ω_)
    if is_base:
        turned, v_ = turned - np.cross(R.T @ pose.velocity, v_), R @ v_
    return {"position": p_, "rotation": R @ turned, "velocity": v_, "angular_velocity": R @ ω_}


def contact_adjoint(
    interface: "ContactInterface | None", step: "ContactStep | None" = None
) -> "tuple[ContactAdjoint | None, bool]":
    """Contact of a step, the last one unless given, to go back through, and whether that is a kink."""
    if interface is None:
        return None, False
    from fenics_rom.mechanics.contact_adjoint import ContactAdjoint, is_at_kink  # here, as few are differentiated

    considered, solved = (step or interface.solver.last_step)()
    return ContactAdjoint.of(interface.solver, solved), is_at_kink(interface.solver.law, considered, solved)


def spread(vectors: "tuple[Array, Array]", like: Array) -> Array:
    """-x yᵀ, symmetric, as damping is kept: of a diagonal one that alone."""
    x, y = vectors
    if like.ndim == 1:
        return -x * y
    both = np.outer(x, y)
    return -(both + both.T) / 2
