"""The steppers of reduced bodies: the step contract, around a kernel for each contact mode or one for all."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.step import StepInput, StepperState
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.kernel import Kernel
from fenics_rom.runtime.switching import Projections

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact import ContactSolution
    from fenics_rom.runtime.steppers.adjoint import StateAdjoint, SwitchAdjoint
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.equilibrium import Equilibrium
    from fenics_rom.runtime.steppers.held import HeldBody
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint


class ReducedStepper:
    """A stepper of a ROM that begins in its first contact mode; see mechanics.step.

    Args:
        rom: the reduced models.
        dt: time step, s.
        interface: the contact points; None where nothing can touch.
        rigid_displacement: along the rigid motions (ρ,), which the kernels add to.
        kind: its name.
        reason: why it is the one that steps.

    Attributes:
        kernel: what takes the step in the active contact mode; where nothing can touch, `kernel.step(u)` is all of it.
        contact_mode: the active one.
        rigid_displacement: along the rigid motions (ρ,), as far as it is booked.
    """

    def __init__(
        self,
        rom: Rom,
        dt: float,
        interface: "ContactInterface | None",
        rigid_displacement: Array,
        kind: str,
        reason: str,
    ):
        self._rom, self._dt = rom, dt
        self.interface, self.rigid_displacement, self.kind, self.reason = interface, rigid_displacement, kind, reason
        self._enter(next(iter(rom.contact_models)))

    @property
    def model(self) -> ContactModel:
        """That of the active contact mode."""
        return self._rom.contact_models[self.contact_mode]

    @property
    def state(self) -> Array:
        """[√γ q, r] (2m,) of the active contact mode; a view, which a later step overwrites."""
        state: Array = self.kernel.state
        return state

    @property
    def energy(self) -> float:
        """See Stepper."""
        return self.kernel.energy

    @property
    def contact(self) -> "ContactSolution | None":
        """See Stepper."""
        return self.kernel.contact

    @property
    def reactions(self) -> Array:
        """See Stepper."""
        return self.kernel.reactions

    def switch(self, contact: str) -> float:
        """See Stepper."""
        raise NotImplementedError

    def switch_adjoint(self, contact: str) -> "SwitchAdjoint":
        """A switch to a contact mode from here, to go back through."""
        raise NotImplementedError

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """The last step, under u (p,), to go back through, in the coordinates of `adjoint_kernel`."""
        return self.kernel.adjoint(u)

    @property
    def adjoint_kernel(self) -> Kernel:
        """In whose coordinates derivatives are passed back through steps."""
        kernel: Kernel = self.kernel
        return kernel

    @property
    def adjoint_model(self) -> ContactModel:
        """What these are of."""
        return self.model

    def start_adjoint(self, after: "StateAdjoint") -> "StateAdjoint":
        """Derivatives in the coordinates of the contact model that a run begins in, from those of `adjoint_kernel`."""
        return after

    def set_time_step(self, dt: float) -> None:
        """See Stepper."""
        self._dt = dt
        self.kernel.set_time_step(dt)

    def step(self, inputs: StepInput) -> float:
        """See Stepper."""
        if self.interface is not None:
            self._search_before = self.interface.solver.search
        try:
            return self.kernel.step(inputs.u, inputs.obstacles) / 2
        except BaseException:
            self._restore_search()
            raise

    def rollback(self) -> None:
        """See Stepper."""
        self.kernel.rollback()
        self._restore_search()

    def flush(self) -> None:
        """See Stepper; no other contact mode than the active one owes anything."""
        self.kernel.flush()

    def point_displacement(self) -> Array:
        """See Stepper."""
        return self.kernel.point_displacement()

    def set_state(self, q: Array, r: Array) -> None:
        """Puts the body at the reduced displacement q and velocity r of the active contact mode, (m,) each."""
        self.flush()
        ω = np.sqrt(self.model.eigenvalues)
        self.rigid_displacement[:] = q[: len(self.rigid_displacement)]
        self.kernel.state[:] = np.concatenate([ω * q, r])
        self.kernel.resume(np.empty(0))

    def reset(self) -> None:
        """Back to rest in the first contact mode."""
        self.flush()
        self._enter(next(iter(self._rom.contact_models)))
        self.rigid_displacement[:] = self.kernel.state[:] = 0
        self.kernel.resume(np.empty(0))
        self.kernel.contact, self.kernel.reactions = None, 0 * self.kernel.reactions
        self.kernel.notes = dict.fromkeys(self.kernel.notes, 0)
        if self.interface is not None:
            self.interface.solver.search = self.interface.solver.first_search

    def snapshot(self) -> StepperState:
        """All that is not in the ROM."""
        self.kernel.reset_buffer()
        state, rigid = _read_only(self.kernel.state), _read_only(self.rigid_displacement)
        search = None if self.interface is None else self.interface.solver.search
        carried, contact, notes = _read_only(self.kernel.auxiliary), self.kernel.contact, dict(self.kernel.notes)
        reactions = _read_only(self.kernel.reactions)
        return StepperState(state, rigid, carried, contact, search, notes, reactions)

    def check(self, contact: str, state: StepperState) -> None:
        """A StepError where a snapshot, taken in a contact mode, is of another ROM."""
        model = self._rom.contact_models.get(contact)
        own = len(self.kernel.auxiliary)
        if (
            model is None
            or 2 * model.order != len(state.state)
            or model.rigid != len(state.rigid_displacement)
            or (own and len(state.auxiliary) not in (0, own))
        ):
            raise StepError(f"the snapshot is of another ROM than {self._rom.name!r}, or of another stepper")

    def restore(self, contact: str, state: StepperState, dt: float) -> None:
        """Goes back to a snapshot that was taken in a contact mode, and on with steps of dt, s."""
        self.flush()
        self._dt = dt
        self._enter(contact)
        self.rigid_displacement[:] = state.rigid_displacement
        self.kernel.state[:] = state.state
        self.kernel.resume(state.auxiliary)
        self.kernel.contact, self.kernel.reactions = state.contact, state.reactions
        self.kernel.notes = {name: state.notes.get(name, 0) for name in self.kernel.notes}
        if self.interface is not None:
            solver = self.interface.solver
            solver.search = solver.first_search if state.search is None else state.search

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        of_contact = [] if self.interface is None else [self.interface.passing, *self.interface.solver.search.messages]
        return tuple(filter(None, [*of_contact, *self.kernel.messages]))

    def _enter(self, contact: str) -> None:
        """Makes a contact mode active, with whatever state its kernel has."""
        self.contact_mode, self.kernel = contact, self._kernel_of(contact)
        self.kernel.reset_buffer()
        if self.kernel.h != self._dt:
            self.kernel.set_time_step(self._dt)

    def _kernel_of(self, contact: str) -> Kernel:
        """What takes the step in a contact mode."""
        raise NotImplementedError

    def _restore_search(self) -> None:
        """The search for contact forces is where it was before the last step."""
        if self.interface is not None:
            self.interface.solver.search = self._search_before


class LinearStepper(ReducedStepper):
    """A kernel for each contact mode, which `make_kernel` makes, and projections that carry the state between them."""

    def __init__(
        self,
        rom: Rom,
        dt: float,
        interface: "ContactInterface | None",
        rigid_displacement: Array,
        make_kernel: Callable[[str], Kernel],
    ):
        self._make_kernel, self._projections = make_kernel, Projections(rom)
        self._kernels: dict[str, Kernel] = {}
        super().__init__(rom, dt, interface, rigid_displacement, "midpoint", "the model is linear")

    def switch(self, contact: str) -> float:
        """See Stepper; projections never add energy."""
        self.flush()
        left = self.kernel
        potential, kinetic = self._projections.between(self.contact_mode, contact)
        self._enter(contact)
        before, after, m, n = left.state, self.state, len(left.state) // 2, len(self.state) // 2
        self.kernel.contact, self.kernel.reactions = left.contact, left.reactions
        if self.kernel.residual is not None and left.residual is not None:
            rigid = self._rom.rigid
            self.kernel.residual.carry_over(after[rigid:n], left.residual, before[rigid:m])
        else:
            np.dot(potential, before[:m], out=after[:n])
        np.dot(kinetic, before[m:], out=after[n:])
        self._carry_branches(left, potential)
        return left.energy - self.kernel.energy

    def _carry_branches(self, left: Kernel, potential: Array) -> None:
        """Projects the strains of branches as displacements are."""
        here, there = self.kernel.branches, left.branches
        if here is None or there is None:
            return
        b, b_start = np.zeros_like(here.state), there.state
        if self.kernel.residual is not None and left.residual is not None:
            rigid = self._rom.rigid
            self.kernel.residual.carry_branches(b[:, 0, rigid:], left.residual, b_start[:, 0, rigid:])
        else:
            b[:] = b_start @ potential.T
        here.resume(b)
        stored, most = here.stored, there.stored
        if here.share is not None and stored > most:  # projected in the norm of all that is elastic, springs included
            here.resume(math.sqrt(most / stored) * b)

    def switch_adjoint(self, contact: str) -> "SwitchAdjoint":
        """As in ReducedStepper."""
        from fenics_rom.runtime.steppers.switch_adjoint import ProjectionAdjoint, ResidualSwitch, StrainsSwitch

        potential, kinetic = self._projections.between(self.contact_mode, contact)
        left, right, rigid, residual, branches = self.kernel, self._kernel_of(contact), self._rom.rigid, None, None
        there, here = left.branches, right.branches
        strains = np.zeros((0, len(potential.T))) if there is None else there.state[:, 0].copy()
        if left.residual is not None and right.residual is not None:
            rows = left.residual.carried.reshape(-1, len(left.residual.part.points)).copy()
            held = self.state[rigid : len(self.state) // 2].copy(), strains[:, rigid:]
            residual = ResidualSwitch(left.residual.part, right.residual.part, rows, *held)
        if there is not None and here is not None:
            projected, shares = strains @ potential.T, None
            if residual is not None:
                beside = zip(strains[:, rigid:], residual.rows[4::2], strict=True)
                projected[:, rigid:] = [residual.projected(*each) for each in beside]
                projected[:, :rigid] = 0.0
            if there.share is not None and here.share is not None:
                shares = there.share, here.share
            branches = StrainsSwitch(there.coefficients[1][:, None], strains, projected, shares)
        return ProjectionAdjoint(potential, kinetic, residual, branches)

    def _kernel_of(self, contact: str) -> Kernel:
        if contact not in self._kernels:
            self._kernels[contact] = self._make_kernel(contact)
        return self._kernels[contact]


class FiniteStrainStepper(ReducedStepper):
    """One kernel for all contact modes, which share a basis: a switch changes the inputs only, and loses nothing."""

    def __init__(
        self,
        rom: Rom,
        dt: float,
        interface: "ContactInterface | None",
        kernel: "HeldBody | Equilibrium",
        kind: str,
        reason: str,
    ):
        self._only_kernel = kernel
        super().__init__(rom, dt, interface, np.empty(0), kind, reason)

    def switch(self, contact: str) -> float:
        """See Stepper."""
        self._enter(contact)
        return 0.0

    def switch_adjoint(self, contact: str) -> "SwitchAdjoint":
        """As in ReducedStepper."""
        from fenics_rom.runtime.steppers.adjoint import SameBasis

        return SameBasis()

    def _kernel_of(self, contact: str) -> Kernel:
        self._only_kernel.enter(self._rom.contact_models[contact])
        return self._only_kernel


def _read_only(array: Array) -> Array:
    """A copy that cannot be written to."""
    copy = array.copy()
    copy.setflags(write=False)  # `flags.writeable` makes a name each time, and Python keeps thousands of them
    return copy
