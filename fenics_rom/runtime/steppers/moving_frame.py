"""The stepper of a body that turns as far as it likes, free or carried by a rigid base.

**Switching.** What the next contact mode cannot hold of the shape and of its rate becomes two further modes, which the
switch after that replaces: so nothing moves, and energy and both momenta stay. (Shapes that are projected lose angular
momentum, or, where that is given back, gain energy: a body in steady rotation has the least energy of all shapes.) The
further modes feel contact, gravity, actuators and loads, but not the input of the contact mode.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, StructureError, check_known
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.environment import DETAILS
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput, StepperState, StepResult
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom, diagonalized_span
from fenics_rom.runtime.steppers.body_parts import PLAIN, parts_of
from fenics_rom.runtime.steppers.carried_base import frame_state
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame
from fenics_rom.runtime.steppers.frame_kernel import FrameKernel
from fenics_rom.runtime.steppers.frame_loads import FrameLoads
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.frame_watch import FrameWatch
from fenics_rom.runtime.steppers.free_frame import FreeFrame
from fenics_rom.runtime.steppers.stepper import ReducedStepper

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.actuator_forces import ActuatorForces
    from fenics_rom.mechanics.contact import ContactSolution
    from fenics_rom.mechanics.viscoelasticity import PronySeries
    from fenics_rom.runtime.steppers.adjoint import SwitchAdjoint
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.on_base import CarriedEquilibrium
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

FrameKernels: TypeAlias = "FreeFrame | CarriedFrame | CarriedEquilibrium"
SAME_SPAN = 1e-10  # of coordinates, and of compliances: what contact modes differ by where they have the same shapes
NOTHING_LEFT = 1e-14  # of a shape: what the next contact mode need not be given


class FrameSnapshot(NamedTuple):
    """What a stepper of a moving frame has besides."""

    frame: FrameState
    model: ContactModel | None  # with the modes that the last switch carried along; None where it is the ROM's
    wrench: tuple[tuple[float, float, float], tuple[float, float, float]]


class MovingFrameStepper(ReducedStepper):
    """Arguments and attributes as in ReducedStepper, of a ROM of displacements that strain.

    Args:
        make_kernel: of a contact mode by its name, with its model.
        base_at_start: of the base at time 0; of None where nothing says where that is.
    """

    kernel: FrameKernels

    def __init__(
        self,
        rom: Rom,
        dt: float,
        interface: "ContactInterface | None",
        make_kernel: Callable[[str, ContactModel], FrameKernels],
        reason: str,
        base_at_start: Callable[[], BaseState | None],
    ):
        self._base_at_start = base_at_start
        self._make_kernel, self._kernels = make_kernel, dict[str, FrameKernels]()
        self._carried_along: ContactModel | None = None
        super().__init__(rom, dt, interface, np.empty(0), MOVING_FRAME, reason)
        self._begin()

    @property
    def model(self) -> ContactModel:
        """See ReducedStepper; with the modes that the last switch carried along."""
        return self.kernel.model

    @property
    def contact(self) -> "ContactSolution | None":
        """See Stepper."""
        return self.kernel.contact if isinstance(self.kernel, FrameKernel) else self.kernel.seen_contact

    @property
    def pose(self) -> BaseState:
        """Where the frame is and how it moves, in world axes."""
        position, rotation, velocity, turning = map(np.array, self.kernel.frame)
        if isinstance(self.kernel, FreeFrame):
            turning = self.kernel.world_angular_velocity
        return BaseState(position, rotation, velocity, turning)

    @property
    def momenta(self) -> tuple[Array, Array]:
        """Linear and angular, in world axes: about the centre of mass of a free body, the origin of a carried frame."""
        linear, angular = self.kernel.momenta
        return np.array(linear), np.array(angular)

    @property
    def wrench(self) -> tuple[Array, Array] | None:
        """Force and torque of the base on the body in the last step, in world axes; None of a free body."""
        if isinstance(self.kernel, FreeFrame):
            return None
        force, torque = self.kernel.wrench
        return np.array(force), np.array(torque)

    def place(self, pose: BaseState) -> None:
        """Puts the frame, with the shape that the body has."""
        self.flush()
        self.kernel.place(frame_state(pose))

    def step(self, inputs: StepInput) -> StepResult:
        """See Stepper."""
        self.kernel.base = inputs.base
        return super().step(inputs)

    def switch(self, contact: str) -> float:
        """See Stepper; energy stays, to round-off."""
        self.flush()
        left, model, state = self.kernel, self.model, self.kernel.state.copy()
        halves = np.stack([state[: model.order] / model.safe_frequencies, state[model.order :]], axis=1)
        shared = sum(self._rom.actuators.values()) + sum(self._rom.loads.values())
        relaxing = left.elastic if left.elastic is not None and self._rom.deformation is None else None
        if relaxing is not None and relaxing.branches is not None:  # their strains are held, too
            halves = np.hstack([halves, (relaxing.branches.state[:, 0] / model.safe_frequencies).T])
        self._carried_along = _holding(self._rom.contact_models[contact], model, halves, shared, self._rom.stiffness)
        self._enter(contact)
        there, carried = self.model, np.empty(0)
        held = there.coordinates.T @ (model.coordinates @ halves)
        if self._rom.deformation is not None:
            carried = left.auxiliary  # contact modes share a basis
        elif relaxing is not None:
            carried = (np.sqrt(there.eigenvalues)[:, None] * held[:, 2:]).T.ravel()
        self.kernel.state[:] = np.concatenate([np.sqrt(there.eigenvalues) * held[:, 0], held[:, 1]])
        self.kernel.frame, self.kernel.contact, self.kernel.notes = left.frame, left.contact, left.notes
        self.kernel.reactions = left.reactions
        self.kernel.wrench = left.wrench
        self.kernel.resume(carried)
        if self.kernel.residual is not None and left.residual is not None:
            self.kernel.residual.take_over(left.residual)
        return left.energy - self.kernel.energy

    def switch_adjoint(self, contact: str) -> "SwitchAdjoint":
        """As in ReducedStepper, to a contact mode of the same span; else further modes are made of the state."""
        from fenics_rom.runtime.steppers.switch_adjoint import SpanAdjoint

        left, end, start = self.kernel, self._rom.contact_models[contact], self.model
        M = end.coordinates.T @ start.coordinates
        spans = np.abs(end.coordinates @ M - start.coordinates).max() <= SAME_SPAN
        if not (spans and self._yields_alike(left, contact)):
            raise StructureError(
                f"moving-frame: a switch to contact mode {contact!r}, whose shapes are others, is not differentiated"
            )
        small = self._rom.deformation is None and left.branches is not None
        count = len(left.branches.state) if small and left.branches is not None else 0
        return SpanAdjoint(M, start.safe_frequencies, end.safe_frequencies, count)

    def _yields_alike(self, left: FrameKernels, contact: str) -> bool:
        """Whether contact points yield beyond the basis in a contact mode as they do now."""
        if contact not in self._kernels:
            self._kernels[contact] = self._make_kernel(contact, self._rom.contact_models[contact])
        here, there = left.residual, self._kernels[contact].residual
        if here is None or there is None:
            return here is there
        R = here.part.compliance
        return bool(np.abs(there.part.compliance - R).max() <= SAME_SPAN * np.abs(R).max())

    def set_state(self, q: Array, r: Array) -> None:
        """As in ReducedStepper; the frame stays and turns as fast as before."""
        pose = self.pose
        super().set_state(q, r)
        self.place(pose)

    def reset(self) -> None:
        """As in ReducedStepper, with the frame where it is at rest."""
        self._carried_along = None
        super().reset()
        self._begin()

    def _begin(self) -> None:
        self.kernel.begin()
        base = None if isinstance(self.kernel, FreeFrame) else self._base_at_start()
        if base is not None:
            self.place(base)

    def snapshot(self) -> StepperState:
        """As in ReducedStepper."""
        frame = FrameSnapshot(self.kernel.frame, self._carried_along, self.kernel.wrench)
        return super().snapshot()._replace(frame=frame)

    def check(self, contact: str, state: StepperState) -> None:
        """As in ReducedStepper."""
        if not isinstance(state.frame, FrameSnapshot):
            raise StepError(f"the snapshot is of another ROM than {self._rom.name!r}, or of a body in a fixed frame")
        own = len(self.kernel.auxiliary)
        model = state.frame.model or self._rom.contact_models.get(contact)
        if model is None or 2 * model.order != len(state.state) or (own and len(state.auxiliary) not in (0, own)):
            raise StepError(f"the snapshot is of another ROM than {self._rom.name!r}")

    def restore(self, contact: str, state: StepperState, dt: float) -> None:
        """As in ReducedStepper."""
        self.flush()
        assert isinstance(state.frame, FrameSnapshot)
        self._carried_along = state.frame.model
        self._dt = dt
        self._enter(contact)
        self.kernel.frame = state.frame.frame
        super().restore(contact, state, dt)
        self.kernel.wrench = state.frame.wrench

    def _kernel_of(self, contact: str) -> FrameKernels:
        if self._carried_along is not None:
            current = getattr(self, "kernel", None)
            if current is not None and current.model is self._carried_along:
                return current
            return self._make_kernel(contact, self._carried_along)
        if contact not in self._kernels:
            self._kernels[contact] = self._make_kernel(contact, self._rom.contact_models[contact])
        return self._kernels[contact]


def moving_frame_stepper(
    rom: Rom,
    dt: float,
    environment: "ActiveEnvironment",
    interface: "ContactInterface | None",
    ledger: EnergyLedger | None,
    residual_of: "Callable[[str], ResidualMotion | None]",
    detail: str,
    actuators: "ActuatorForces | None" = None,
    series: "PronySeries | None" = None,
    law: str = "linear",
    why: str = "",
) -> MovingFrameStepper:
    """The stepper of a ROM of displacements that strain; arguments as in `make_stepper`.

    Args:
        actuators: those whose forces are found, if there are any.
        series: how the material relaxes, if it does.
        law: by which large deformation is stepped, or "linear".
        why: it is that one.

    Raises:
        StepError: there is no such level of detail, or the body begins in an obstacle.
    """
    check_known("detail", detail, DETAILS, StepError)
    frame = rom.moving_frame
    assert frame is not None
    whole = frame if detail == "full" else quasi_rigid(frame)
    kernel_of = CarriedFrame if frame.carried else FreeFrame
    has_inertia = environment.environment.has_inertia

    def make_kernel(contact: str, model: ContactModel) -> FrameKernels:
        if not has_inertia:
            from fenics_rom.runtime.steppers.on_base import CarriedEquilibrium  # here, as few bodies have none

            parts = parts_of(rom, contact, model, law, actuators, series, interface)
            acting = contact, model, environment, ledger, interface
            return CarriedEquilibrium(rom, *acting, residual_of(contact), parts)
        is_plain = rom.deformation is None and actuators is None and series is None
        parts = PLAIN if is_plain else parts_of(rom, contact, model, law, actuators, series, interface)
        following = ([], []) if parts.following is None else parts.following.places
        loads = FrameLoads(rom, contact, model, whole, environment.environment, following)
        watch = FrameWatch(rom, model, detail)
        of_mode = whole.of_mode(model.coordinates)
        return kernel_of(model, of_mode, loads, watch, ledger, interface, residual_of(contact), parts)

    reason = "a rigid base carries the body" if frame.carried else "nothing holds the body"
    if not has_inertia:
        reason += ", which has no inertia"
    elif why:
        reason += f", which deforms largely ({law}: {why})"
    return MovingFrameStepper(rom, dt, interface, make_kernel, reason, lambda: environment.base_at(0.0))


def quasi_rigid(frame: MovingFrame) -> MovingFrame:
    """The same without what a change of shape does to inertia."""
    nothing = {name: 0 * getattr(frame, name) for name in ("inertia1", "inertia2", "coupling")}
    return replace(frame, stiffening=None, **nothing)


def _holding(end: ContactModel, start: ContactModel, halves: Array, shared: int, κ: Array) -> ContactModel | None:
    """The model of a contact mode that holds shape and rate (m, 2) of another one, too; None where it does by itself.

    Args:
        end, start: of both contact modes.
        halves: q and r in `start`.
        shared: number of input columns, the last ones, that both have.
        κ: of the shared basis.
    """
    C, p = end.coordinates, end.inputs.shape[1]
    wanted, felt = start.coordinates @ halves, start.inputs[:, start.inputs.shape[1] - shared :].T @ halves
    further, inputs = np.empty((len(C), 0)), np.empty((shared, 0))
    for column, push in zip(wanted.T, felt.T, strict=True):
        size = float(np.linalg.norm(column))
        if size == 0:
            continue
        column, push = column / size, push / size
        left = 1.0
        for _ in range(3):  # what a Gram-Schmidt step rounds, the next one takes away
            share, share_further = C.T @ column, further.T @ column
            column = column - C @ share - further @ share_further
            push = push - end.inputs[:, p - shared :].T @ share - inputs @ share_further
            size = float(np.linalg.norm(column))
            left *= size
            if not left > NOTHING_LEFT:
                break
            column, push = column / size, push / size
        if left > NOTHING_LEFT:
            further, inputs = np.hstack([further, column[:, None]]), np.hstack([inputs, push[:, None]])
    if not further.shape[1]:
        return None
    span = np.hstack([C, further])
    γ, coordinates = diagonalized_span(κ, span)
    within = span.T @ coordinates
    pushed = np.zeros((further.shape[1], p))
    pushed[:, p - shared :] = inputs.T
    return replace(
        end,
        eigenvalues=γ,
        damping=_damping(end, start, further, κ, within, γ),
        inputs=within.T @ np.vstack([end.inputs, pushed]),
        coordinates=coordinates,
        directions=np.eye(len(γ)),
        left_inverse=None,
    )


def _damping(end: ContactModel, start: ContactModel, further: Array, κ: Array, within: Array, γ: Array) -> Array:
    """Of a model with further modes, whose damping is α + β γ as nearly as that of both models is."""
    known_γ, known = (
        np.concatenate([m.eigenvalues for m in (end, start)]),
        np.concatenate([m.damping if m.damping.ndim == 1 else np.diag(m.damping) for m in (end, start)]),
    )
    rates = np.stack([np.ones_like(known_γ), known_γ], axis=1) / known_γ[:, None]
    α, β = np.maximum(np.linalg.lstsq(rates, known / known_γ, rcond=None)[0], 0.0)
    if end.damping.ndim == 1 and np.allclose(known, α + β * known_γ, rtol=1e-9, atol=0.0):
        damping: Array = α + β * γ
        return damping
    D = np.zeros((len(γ), len(γ)))
    m = end.order
    D[:m, :m] = np.diag(end.damping) if end.damping.ndim == 1 else end.damping
    D[np.arange(m, len(γ)), np.arange(m, len(γ))] = α + β * κ @ further**2
    dense = within.T @ D @ within
    return (dense + dense.T) / 2
