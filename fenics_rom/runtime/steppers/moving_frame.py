"""The stepper of a body that turns as far as it likes, free or carried by a rigid base.

**Switching.** What the next contact mode cannot hold of the shape and of its rate becomes two further modes, which the
switch after that replaces (`further_modes`): so nothing moves, and energy and both momenta stay. (Shapes that are
projected lose angular momentum, or, where that is given back, gain energy: a body in steady rotation has the least
energy of all shapes.)
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.environment import DETAILS
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput, StepperState
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.body_parts import PLAIN, parts_of
from fenics_rom.runtime.steppers.carried_base import frame_state
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame
from fenics_rom.runtime.steppers.frame_kernel import FrameKernel
from fenics_rom.runtime.steppers.frame_loads import FrameLoads
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.frame_watch import FrameWatch
from fenics_rom.runtime.steppers.free_frame import FreeFrame
from fenics_rom.runtime.steppers.further_modes import holding, whole_model
from fenics_rom.runtime.steppers.stepper import ReducedStepper

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.actuator_forces import ActuatorForces
    from fenics_rom.mechanics.contact import ContactSolution
    from fenics_rom.mechanics.viscoelasticity import PronySeries
    from fenics_rom.runtime.steppers.adjoint import StateAdjoint, SwitchAdjoint
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.on_base import CarriedEquilibrium
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion
    from fenics_rom.runtime.steppers.switch_adjoint import FieldsAdjoint

SAME_SPAN = 1e-10  # of coordinates: what contact modes differ by where they have the same shapes
FrameKernels: TypeAlias = "FreeFrame | CarriedFrame | CarriedEquilibrium"


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
        self._make_kernel, self._kernels, self._wide = make_kernel, dict[str, FrameKernels](), dict[str, FrameKernels]()
        self._wholes = dict[str, ContactModel]()  # of each contact mode in the shared basis
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

    def step(self, inputs: StepInput) -> float:
        """See Stepper."""
        self.kernel.base = inputs.base
        return super().step(inputs)

    def switch(self, contact: str) -> float:
        """See Stepper; energy stays, to round-off."""
        self.flush()
        left, fields, end = self.kernel, self._fields, self._rom.contact_models[contact]
        self._carried_along = holding(end, self._whole(contact), fields)
        self._enter(contact)
        there, carried = self.model, np.empty(0)
        held = there.coordinates.T @ fields
        if self._rom.deformation is not None:
            carried = left.auxiliary  # contact modes share a basis
        elif left.branches is not None:
            carried = (np.sqrt(there.eigenvalues)[:, None] * held[:, 2:]).T.ravel()
        self.kernel.state[:] = np.concatenate([np.sqrt(there.eigenvalues) * held[:, 0], held[:, 1]])
        self.kernel.frame, self.kernel.contact, self.kernel.notes = left.frame, left.contact, left.notes
        self.kernel.reactions = left.reactions
        self.kernel.wrench = left.wrench
        self.kernel.resume(carried)
        if self.kernel.residual is not None and left.residual is not None:
            self.kernel.residual.take_over(left.residual)
        return left.energy - self.kernel.energy

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in ReducedStepper; of a model with further modes in the shared basis, of which these are made."""
        if self._carried_along is None:
            return self.kernel.adjoint(u)
        from fenics_rom.runtime.steppers.parted_adjoint import Span

        left, P, wide = self.kernel, self.model.coordinates, self.adjoint_kernel
        lack = wide.follow(left, P, u)  # type: ignore[arg-type]
        return wide.adjoint(u)._replace(span=Span(P, left.passed_rate, lack))

    @property
    def adjoint_kernel(self) -> FrameKernels:
        """As in ReducedStepper."""
        if self._carried_along is None:
            return self.kernel
        name = self.contact_mode
        if name not in self._wide:
            self._wide[name] = self._make_kernel(name, self._whole(name))
        return self._wide[name]

    @property
    def adjoint_model(self) -> ContactModel:
        """As in ReducedStepper."""
        return self.model if self._carried_along is None else self._whole(self.contact_mode)

    def start_adjoint(self, after: "StateAdjoint") -> "StateAdjoint":
        """As in ReducedStepper."""
        if self._carried_along is None:
            return after
        return self._within((self.model, self.adjoint_model)).pull_back(after)

    def switch_adjoint(self, contact: str) -> "SwitchAdjoint":
        """As in ReducedStepper."""
        from fenics_rom.runtime.steppers.switch_adjoint import Further, ResidualKept

        start, left, fields = self.adjoint_model, self.kernel, self._fields
        end, whole = self._rom.contact_models[contact], self._whole(contact)
        model = holding(end, whole, fields)
        there = (model or end).coordinates
        further = None if model is None else Further.of(there, end.coordinates, fields)
        felt = fields.shape[1] - (not isinstance(left, FrameKernel))  # equilibria have no rate
        lacks = np.abs(self.model.coordinates - there @ (there.T @ self.model.coordinates)).max() > SAME_SPAN
        residual = None
        if left.residual is not None and self._rom.deformation is None:  # else it stays the same
            entered = self._plain_kernel(contact).residual
            assert entered is not None
            residual = ResidualKept(left.residual.part, entered.part, left.residual.carried_now)
        is_kink = bool(lacks) and there.shape[1] - end.order < felt
        return self._within((start, end if model is None else whole), further, residual, is_kink)

    def _within(self, models: tuple[ContactModel, ContactModel], *others: Any) -> "FieldsAdjoint":
        """Of fields that stay, from the coordinates of a model to those of another."""
        from fenics_rom.runtime.steppers.switch_adjoint import FieldsAdjoint

        branches, (start, end) = self.kernel.branches, models
        count = 0 if branches is None or self._rom.deformation is not None else len(branches.state)
        shapes, frequencies = (start.coordinates, end.coordinates), (start.safe_frequencies, end.safe_frequencies)
        return FieldsAdjoint(shapes, frequencies, count, *others)

    @property
    def _fields(self) -> Array:
        """Shape, rate, and strains of branches of small strains, in the shared basis (k, 2 or more)."""
        model, state, branches = self.model, self.kernel.state, self.kernel.branches
        halves = np.stack([state[: model.order] / model.safe_frequencies, state[model.order :]], axis=1)
        if branches is not None and self._rom.deformation is None:
            halves = np.hstack([halves, (branches.state[:, 0] / model.safe_frequencies).T])
        fields: Array = model.coordinates @ halves
        return fields

    def _whole(self, contact: str) -> ContactModel:
        if contact not in self._wholes:
            self._wholes[contact] = whole_model(self._rom, contact)
        return self._wholes[contact]

    def _plain_kernel(self, contact: str) -> FrameKernels:
        if contact not in self._kernels:
            self._kernels[contact] = self._make_kernel(contact, self._rom.contact_models[contact])
        return self._kernels[contact]

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
        return self._plain_kernel(contact)


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
