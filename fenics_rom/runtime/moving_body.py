"""A body whose frame moves with it, as its stepper has it; `Simulator` moves it."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, shown
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput
from fenics_rom.runtime.simulated_body import SimulatedBody, SimulatorState

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.mechanics.contact_solver import ContactSolver
    from fenics_rom.runtime.steppers.moving_frame import MovingFrameStepper


class BeforeStep(NamedTuple):
    """What a body was before a step that is to be taken back."""

    body: Any  # a simulator
    acted: tuple[Any, ...]
    saved: SimulatorState | None  # where the step begins with a switch

    @classmethod
    def of(cls, body: Any) -> "BeforeStep":
        """What it is now."""
        switches = body.switches_itself and body.nearest_contact != body.contact
        return cls(body, body.acted, body.save() if switches else None)

    def return_to(self) -> None:
        """Takes the step back."""
        if self.saved is None:
            self.body.take_back_step(self.acted)
        else:
            self.body.restore(self.saved)


class MovingBody(SimulatedBody):
    """What a moving frame has besides; of a fixed one there is nothing of it."""

    _monitor_threshold: float
    next_base: "BaseState | None" = None  # that was given for the step to be taken
    _solver_of: "type[ContactSolver] | None" = None  # that finds contact forces; None: ContactSolver

    @property
    def pose(self) -> "BaseState | None":
        """Where the frame is and how it moves, in world axes; None where it is fixed.

        Of a free body its position is the centre of mass; of one that a base carries the pose is the base's.
        """
        return None if self._frame is None else self._frame.pose

    @property
    def momentum(self) -> tuple[Array, Array] | None:
        """Linear (3,), kg m/s, and angular (3,), kg m²/s, in world axes; None where the frame is fixed.

        The angular one is about the centre of mass of a free body, and about the origin of a carried frame.
        """
        return None if self._frame is None else self._frame.momenta

    @property
    def base_wrench(self) -> tuple[Array, Array] | None:
        """Force (3,), N, and torque (3,) about the frame's origin, N m, of the base on the body in the last step.

        In world axes; None where no base carries the body.
        """
        return None if self._frame is None else self._frame.wrench

    def place(self, pose: "BaseState") -> None:
        """Puts a moving frame somewhere, with the shape that the body has.

        Args:
            pose: of a free body its centre of mass, attitude and how it moves; else that of the base.

        Raises:
            StepError: the frame is fixed, the pose is none, or the body would be in an obstacle; it stays where it is.
        """
        frame = self._frame
        if frame is None:
            raise StepError(f"place: use a body in a moving frame, which ROM {self.rom.name!r} is not of")
        from fenics_rom.mechanics.base_path import checked_base  # here, as few bodies move so far

        before = frame.snapshot()
        try:
            frame.place(checked_base(pose, "pose"))
            self.check_outside_obstacles()
        except StepError:
            frame.restore(self.contact, before, self._dt)
            raise
        if self._skin is not None:
            self._skin.forget()

    def displacement(self, output: str | None = None) -> Array:
        """As in SimulatedBody, in world axes: how far points are from where they were at rest."""
        field = super().displacement(output)
        if self._frame is None:
            return field
        from fenics_rom.mechanics.frame_motion import world_displacement

        return world_displacement(self._frame.pose, *self._rest(output), field)

    def velocity(self, output: str | None = None) -> Array:
        """As in SimulatedBody, in world axes."""
        field = super().velocity(output)
        if self._frame is None:
            return field
        from fenics_rom.mechanics.frame_motion import world_velocity

        return world_velocity(self._frame.pose, *self._rest(output), super().displacement(output), field)

    @property
    def through_skin(self) -> float:
        """How deep an obstacle was in the body, where contact does not keep it out, as far as it was looked at, m."""
        return 0.0 if self._skin is None else max((told.depth for told in self._skin.watch.told), default=0.0)

    def take_back_step(self, acted: tuple[Any, ...]) -> None:
        """Takes the last step back, before which `acted` was as it is now; what was told of it stays told."""
        self._stepper.rollback()
        self.steps -= 1
        if self.environment is not None:
            self.environment.state, self.environment.loads = acted

    @property
    def acted(self) -> tuple[Any, ...]:
        """Where obstacles are, and the loads of the last step; nothing where nothing acts by itself."""
        return () if self.environment is None else (self.environment.state, self.environment.loads)

    def _watch_skin(self) -> None:
        """Begins to look at what is in the body; a StepError where a moving frame begins in an obstacle."""
        interface = self._stepper.interface
        if interface is not None and interface.skin is not None:
            from fenics_rom.runtime.skin_looks import SkinLooks  # here, as few bodies have obstacles

            self._skin = SkinLooks(self, interface, interface.skin)
        if self._frame is not None:
            self.check_outside_obstacles()

    def look_at_skin(self) -> None:
        """Looks at what is in the body, if something may have gone in since the last look, or after enough steps."""
        if self._skin is not None and self.steps >= self._skin.next_check:
            self._skin.check()

    @property
    def begins_to_look(self) -> bool:
        """Whether looks at the skin begin at the end of the next step: it is to be taken by itself."""
        return self._skin is not None and self._skin.is_new

    def check_outside_obstacles(self) -> None:
        """A StepError where the body is not outside of all obstacles."""
        interface = self._stepper.interface
        if interface is not None and self.environment is not None:
            places = None if self._skin is None else self._skin.places.placement().whole()
            interface.check_outside(self._stepper.point_displacement(), places, self.environment.state.offsets)

    def _take_base(self, base: "BaseState | None") -> None:
        """Where the base is to be at the end of the step that is taken next."""
        self.next_base = None
        if base is None:
            return
        if not self.is_carried:
            raise StepError(f"step {self.steps}: base: use a body in a moving frame that a rigid base carries")
        from fenics_rom.mechanics.base_path import checked_base

        self.next_base = checked_base(base, f"step {self.steps}: base")

    def _way_to_advance(self) -> Callable[[Array], float]:
        """What takes a step under an input (p,), N, and returns twice the stored energy, J.

        Where nothing acts but inputs, it is one call, which in a fixed frame allocates nothing.
        """
        kernel: Any = self._stepper.kernel
        if self.tensions.enter(self.contact) and kernel.holds_steps:
            kernel.note_inputs = self.tensions.note_all
        if self.environment is None:
            step: Callable[[Array], float] = kernel.step
            return self._noting(step) if self.reads_reactions else step
        alone = self._frame is not None and self.environment.is_still
        return self._advance_alone if alone else self._advance_in_environment

    def _advance_alone(self, u: Array) -> float:
        """Takes a step of a moving frame in which nothing acts by itself; twice the stored energy, J."""
        assert self._source is not None
        kernel: Any = self._stepper.kernel
        kernel.base, self.next_base = self.next_base, None
        full = self._source.full_input(u, self._width)
        twice: float = kernel.step(full)
        self.tensions.note(full)
        return twice

    def _advance_in_environment(self, u: Array) -> float:
        """Takes a step with what acts by itself; twice the stored energy, J."""
        raise NotImplementedError

    def _step_high(self, u: Array, twice: float) -> None:
        """The end of a step to an energy at which the surface may have gone too far, or that is not a number.

        In a moving frame the surface is looked at only where what strains it is much.
        """
        if not math.isfinite(twice):
            self._leave_finite(u)
        self.steps += 1
        e = self._stepper.state[: self._order]
        if self._frame is None or e.dot(e) > self._monitor_threshold:
            self._monitor.look(e, self.time)

    def watch_in_loops(self, watched: Array, looked_at: Array) -> None:
        """Sets what tells loops when the surface is to be looked at: (6,), see `world.compiled.tables`, and e (m,)."""
        interval, since, radius = self._monitor.in_loops
        watched[:] = self._monitor_threshold, self._frame is None, interval, since, radius, 0.0
        if radius > 0:
            looked_at[: self._order] = self._monitor.looked_at

    def end_steps(self, u: Array, twice: float, steps: int, since: float, is_due: float) -> None:
        """Ends steps that loops took under u, of which the last one led to twice; others as of `LinearityMonitor`."""
        self.steps += steps
        if not math.isfinite(twice):
            self.steps -= 1
            self._leave_finite(u)
        self._monitor.go_on(self._stepper.state[: self._order], self.time, int(since), is_due != 0.0)

    def watch(self, e: Array, square: float, time: float, steps: int = 1) -> None:
        """Looks at a state √γ q (m,) that some steps of a rollout led to; `square` is twice its stored energy, J."""
        if square > self._monitor_threshold:
            self._monitor.look(e, time, steps)

    def _wrong_input(self, u: object) -> str:
        given = f"an array of shape {u.shape}" if isinstance(u, np.ndarray) else shown(u)
        allowed = f"input of contact mode {self.contact!r}: use {self.inputs} numbers in N"
        alone = f", or the {n} of actuators" if self._source and (n := sum(self.rom.actuators.values())) else ""
        return f"step {self.steps}: {allowed}{alone} (got {given})"

    def _leave_finite(self, u: Array) -> None:
        self._stepper.rollback()
        raise StepError(
            f"step {self.steps}: input {u.tolist()} is so large that the step overflows; the state was left as it was"
        )

    def _with_gas(self, u: Array) -> Array:
        """An input (p,) of the step to be taken, with what is then blown into chambers."""
        return u if self.filling is None else self.filling.blown(u, self.time, self._dt)

    def _with_base(self, inputs: StepInput) -> StepInput:
        """The inputs of the step to be taken, with the base that was given."""
        base, self.next_base = self.next_base, None
        return inputs if base is None else inputs._replace(base=base)

    def _detail(self, given: str | None) -> str:
        """The level of detail of a moving frame, with which the stepper is made."""
        acting = None if self.environment is None else self.environment.environment
        if acting is None or not acting.is_moving:
            if given is not None:
                raise StepError(f"detail = {shown(given)}: use a ROM of a body in a moving frame")
            return "full"
        return given or (acting.run.detail if acting.run else "full")

    @property
    def _frame(self) -> "MovingFrameStepper | None":
        return self._stepper if self._stepper.kind == MOVING_FRAME else None  # type: ignore[return-value]

    @property
    def is_carried(self) -> bool:
        """Whether a rigid base carries the body."""
        frame = self.rom.moving_frame
        return self._frame is not None and frame is not None and frame.carried

    @property
    def takes_compiled_steps(self) -> bool:
        """Whether compiled functions take steps of the body in its frame."""
        return self._frame is not None and getattr(self._frame.kernel, "is_compiled", False)

    @property
    def steps_in_loops(self) -> bool:
        """Whether compiled functions take steps of the body, which is held."""
        return self._frame is None and getattr(self._stepper.kernel, "is_compiled", False)

    def _rest(self, output: str | None) -> tuple[Array, Array]:
        """The origin of a moving frame, and points at rest: of an output, or all nodes; m."""
        frame = self.rom.moving_frame
        assert frame is not None
        return frame.origin, self.rom.nodes if output is None else np.asarray(frame.output_points[output])
