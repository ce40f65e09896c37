"""A soft body in real time: the reduced model of the active contact mode, stepped, switched and accounted for."""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import check_flag, mapping_in
from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.linearity import SurfaceStrainPeak
from fenics_rom.mechanics.signals import real_numbers, real_numbers_or_nan
from fenics_rom.rom.given_rom import given_rom
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.erring_body import ErringBody
from fenics_rom.runtime.linearity_monitor import LinearityMonitor
from fenics_rom.runtime.simulated_body import SimulatorState
from fenics_rom.runtime.steppers.selection import make_stepper
from fenics_rom.runtime.switching import SwitchLoss
from fenics_rom.runtime.tension_watch import TensionWatch

if TYPE_CHECKING:
    from os import PathLike

    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.base_path import BaseState
    from fenics_rom.mechanics.environment import HasEnvironment
    from fenics_rom.mechanics.signals import SignalLike
    from fenics_rom.mechanics.skin_watch import Told
    from fenics_rom.runtime.rollout import Rollout

_FLOAT = np.dtype(float)


class Simulator(ErringBody):
    """Steps a ROM from rest, beginning in its first contact mode.

    Loads and obstacles of the scene act by themselves. Where its contact switches automatically, the contact mode is
    the one that an obstacle is nearest to.

    Args:
        rom: the reduced model, or the name of its file; it is only read, and copies of a simulator share it.
        dt: time step, s; may be set anew before any step.
        ledger: whether to keep the energy account.
        scene: whose effects act, or an Environment; None: what the ROM was made for.
        signals: of loads and obstacles by name, instead of the scene's: numbers, or functions of time in s. Of
            gravity multiples of its acceleration; of a base motion m/s²; of a prescribed force N (3,); of an obstacle
            its displacement, m (3,), or, if it has a motion, a BaseState, a BasePath or a function that gives states.
        stepper: of a body with large deformation: "newton" (for large steps) or "linearly-implicit" (for small ones);
            None: the one that suits dt.
        detail: of a moving frame: "full", or "quasi-rigid", with inertia of the shape at rest; None: as the scene says.
        errors: whether to keep bound and estimate of the error; None: if the ROM was made for that.
        error_tolerance: what the estimate of any output's error is to be no larger than, m: the first time that it is,
            a ToleranceWarning says so at once, and `exceeded` keeps it; None: as the scene's run says.
        finer: a ROM of higher order of the same scene, which takes the same steps beside: the difference of both is
            the estimate of bodies that state no errors of themselves.

    Attributes:
        steps: number of steps taken.
        ledger: the energy account, or None.
        loss: the switch that lost most, where an account is kept.
        errors: what keeps bound and estimate of the error; None where they are not kept.
        environment: the loads and obstacles that act by themselves; None where there are none.

    Raises:
        SceneError: an effect that the ROM was not made with, or a load without a signal.
        StepError: dt is not a positive finite number, a signal has another width, or the body begins in an obstacle.

    Example:
        >>> body = fr.Simulator(rom, dt=1e-3)
        >>> for step in range(1000):
        ...     body.switch("tip_left" if step < 500 else "middle")
        ...     body.step([0.0, 0.0, 0.5])  # N
        >>> body.displacement("tip").shape, body.energy > 0
        ((2, 3), True)
    """

    def __init__(
        self,
        rom: "Rom | str | PathLike[str]",
        dt: float,
        *,
        ledger: bool = True,
        scene: "HasEnvironment | None" = None,
        signals: "Mapping[str, SignalLike] | None" = None,
        stepper: str | None = None,
        detail: str | None = None,
        errors: bool | None = None,
        error_tolerance: float | None = None,
        finer: "Rom | str | PathLike[str] | None" = None,
    ):
        rom, signals = given_rom("Simulator", rom), mapping_in("signals", signals, StepError)
        acting: dict[str, Any] = {"scene": scene, "signals": signals, "stepper": stepper, "detail": detail}
        told: dict[str, Any] = {"errors": errors, "error_tolerance": error_tolerance, "finer": finer}
        self._origin = rom, acting, told
        self.environment: ActiveEnvironment | None = None
        self._source = None
        if not rom.environment.is_plain or scene is not None or signals:  # others start sooner without this import
            from fenics_rom.runtime.environment_inputs import EnvironmentInputs, fit_environment

            rom, self.environment = fit_environment(rom, scene, signals)
            self._source = None if self.environment is None else EnvironmentInputs(rom, self.environment)
        self.rom, self.steps = rom, 0
        self._dt, self._since = checked_dt(dt), (0.0, 0)
        self.ledger = EnergyLedger(lambda: self._stepper.flush()) if check_flag("ledger", ledger, StepError) else None
        self.loss = SwitchLoss()
        made_for = self.environment, self.ledger, stepper
        self._stepper = make_stepper(rom, self._dt, *made_for, self._detail(detail), self._solver_of)
        self._monitor, self.tensions = LinearityMonitor(rom, self._rigid_displacement), TensionWatch(rom)
        self._output_rows: dict[tuple[str, str], Array] = {}
        self._rollout: Rollout | None = None
        self._watch_errors(**told)
        self._begin_sensing()
        self._enter()
        self._fill()
        self._watch_skin()

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        if type(dt) is float and dt == self._dt:
            return
        dt = checked_dt(dt)
        self._since, self._dt = (self.time, self.steps), dt
        self._stepper.set_time_step(dt)

    @property
    def state(self) -> tuple[Array, Array]:
        """Copies of the reduced displacement q and velocity r of the active contact mode, (m,) each."""
        return self._q, self._stepper.state[self._order :].copy()

    @state.setter
    def state(self, state: tuple[Sequence[float] | Array, Sequence[float] | Array]) -> None:
        given = [real_numbers_or_nan(part) for part in (state if isinstance(state, tuple | list | Array) else ())]
        shape = (self._order,)
        if len(given) != 2 or any(part.shape != shape or not np.isfinite(part).all() for part in given):
            raise StepError(f"state: use two finite arrays of shape {shape} (got {[p.shape for p in given]})")
        self._stepper.set_state(*given)
        self.last_step = None
        self._refill(self.gas)
        self._begin_errors()
        if self._skin is not None:
            self._skin.forget()

    def set_shape(self, displacement: Array, velocity: Array | None = None) -> dict[str, float]:
        """Puts the body where it has a shape, by projection on the basis of the active contact mode.

        Args:
            displacement: of all nodes, (N, 3), m.
            velocity: of all nodes, (N, 3), m/s; None: at rest.

        Returns:
            The share of each that the basis has not, by name, in the mass norm; more than 1 % is warned of.

        Raises:
            StepError: wrong shapes, numbers that are not finite, or a body in an obstacle; the state is as it was.
            SceneError: the basis has less than a half of one.
        """
        from fenics_rom.runtime.shape_projection import put_into_shape  # here, as not everyone sets one

        return put_into_shape(self, displacement, velocity)

    def switch(self, contact: str) -> None:
        """Makes another contact mode active; the state is projected, and never gains energy by it.

        Raises:
            StepError: no such contact mode.
        """
        start = self.contact
        if type(contact) is str and contact == start:
            return
        check_known("contact mode", contact, self.rom.contact_models, StepError)
        lost = self._stepper.switch(contact)
        self._enter()
        if self.filling is not None:
            lost -= self.filling.gained()
        if self.ledger is not None:
            self.ledger.book(lost_in_switching=lost)
            if lost > self.loss.energy:
                stored = self._stepper.energy + lost
                self.loss = SwitchLoss(lost, lost / stored, start, contact, self.time)

    def step(
        self, u: Sequence[float] | Array | Mapping[str, Any] = (), *, base: "BaseState | None" = None, **named: Any
    ) -> None:
        """Advances by dt under a constant input.

        Args:
            u: (p,) N; the contact mode's columns, then the actuators' (Pa of a pressure or a supply; of those whose
                stroke or gas is given, what it is to be at the end of the step, m or m³). The actuators' alone, where
                the scene has loads, strokes, obstacles or no inertia: then nothing pushes at the contact mode besides.
                Or a mapping by name; what it does not name is 0.
            base: that carries the body, at the end of the step; None: as the environment says, or at rest.
            named: the same as arguments, `step(flexor=1.2, tip=[0, 0, 0.5])`: of actuators, and of the contact mode.

        Raises:
            StepError: wrong length, or not finite, or no contact forces were found; the state is as it was.
        """
        if named:
            u = self._by_name(u, named)
        if base is not None or self.next_base is not None:  # of a step that failed
            self._take_base(base)
        try:
            given = u if type(u) is Array and u.dtype is _FLOAT else real_numbers(u)
            twice = self._advance(given)
        except (TypeError, ValueError):
            if isinstance(u, Mapping):  # here, as it costs a step by position nothing
                return self.step(self._by_name(u, {}), base=base)
            raise StepError(self._wrong_input(u)) from None
        if twice <= self._monitor_threshold:
            self.steps += 1
        else:
            self._step_high(given, twice)

    def step_in_block(self, inputs: Sequence[Array]) -> tuple[Array, Array, Array, Array]:
        """Takes steps, at most `midpoint.PAGES`, and tells what there is to read after each.

        Returns:
            States [√γ q, r] (n + 1, 2m) and inputs with the loads (n, p), which a later step overwrites; and what was
            supplied and dissipated (n,), J.
        """
        kernel = self._stepper.kernel
        kernel.reset_buffer()
        for u in inputs:
            self.step(u)
        return kernel.passed()

    def _advance_in_environment(self, u: Array) -> float:
        """Takes a step with what acts by itself; twice the stored energy, J."""
        source, before = self._source, None
        assert source is not None
        self.look_at_skin()
        if source.switches and (nearest := source.nearest(self._stepper)) != self.contact:
            before = self.save()
            self.switch(nearest)
        try:
            u = self._with_gas(source.full_input(u, self._width))
            inputs = self._with_base(source.environment.step_input(u, self.time, self._dt))
            start = self._moving() if self.reads_reactions else None
            energy = self._stepper.step(inputs)
            if not math.isfinite(energy):
                self._leave_finite(inputs.u)
        except BaseException:
            if before is not None:
                self.restore(before)
            raise
        source.environment.commit(inputs, self._dt)
        self.book_gas(u)
        self.tensions.note(inputs.u)
        self._note_step(inputs.u)
        if start is not None:
            self._note_last(start, inputs.u)
        if self.remembers_touch:
            self.note_touch(1)
        return 2 * energy

    def book_gas(self, blown: Array) -> None:
        """Ends a step under an input (p,) with what is blown into chambers."""
        if self.filling is not None:
            gained = self.filling.take(blown)
            if self.ledger is not None:
                self.ledger.book(supplied=gained)

    def rollout(
        self,
        inputs: Sequence[Sequence[float]] | Array | Mapping[str, Any],
        *,
        base: "Sequence[BaseState] | BaseState | None" = None,
        contact: str | Sequence[str] | None = None,
        dt: float | Sequence[float] | Array | None = None,
        every: int = 1,
        outputs: Sequence[str] | None = None,
    ) -> dict[str, Array]:
        """Takes many steps under known inputs at once, as products of matrices; the same as stepping, to round-off.

        Among obstacles blocks of steps in which all contact pairs do what they did are taken so, and the steps between
        by themselves: the same as stepping, to the tolerance of contact forces. Nothing is gained where a step is no
        such map: without inertia, with large deformation, strokes, friction of tendons, a material that relaxes, rigid
        motions, or in a moving frame. There steps are the same to the bit as `step` after `save`, taken one by one, or
        where they are compiled mostly in one loop.

        Args:
            inputs: (steps, p) of each step, as of `step`; or a mapping by name, with (steps, columns) each.
            base: that carries the body, at the end of each step, as of `step`; or one state of (steps, 3) positions and
                so on, as `BasePath.along` gives it.
            contact: contact mode to be in from the first step on, or (steps,) in each; None: the active one, or those
                that obstacles ask for. All must take p inputs.
            dt: time step from the first step on, or (steps,) of each, s; None: the one that is set.
            every: the outputs are read after every so many steps.
            outputs: names of those that are read; None: all.

        Returns:
            Displacement of each output, m: (steps // every, points, 3); without a mesh (steps // every, rows).

        Raises:
            StepError: as of `step`, or a contact mode where obstacles say which; everything is as it was.
        """
        if self._rollout is None:
            from fenics_rom.runtime.rollout import Rollout  # here, as not everyone knows all inputs

            self._rollout = Rollout(self)
        return self._rollout.take(inputs, base, contact, dt, every, outputs)

    def reset(self) -> None:
        """Back to rest in the first contact mode, at time 0, with an empty account; dt stays."""
        if self._stepper.interface is not None and self._frame is None:
            self._stepper.interface.check_start()
        self.begin_anew()

    def begin_anew(self) -> None:
        """As `reset`, also where the body begins in an obstacle."""
        if self.ledger is not None:
            self.ledger.sums = EnergyLedger().sums
        self.steps, self._since = 0, (0.0, 0)
        self._stepper.reset()
        if self.environment is not None:
            self.environment.reset()
        self._refill({})
        self._begin_errors()
        self._sense_again(())
        self._go_on(SwitchLoss(), SurfaceStrainPeak(), ())

    def save(self) -> SimulatorState:
        """The state of everything, to come back to."""
        stepper = self._stepper.snapshot()
        sums = None if self.ledger is None else self.ledger.sums
        obstacles = None if self.environment is None else self.environment.state
        told = () if self._skin is None else self._skin.watch.told
        errors = None if self.told_by is None else self.told_by.state
        when, peak, belongs = (self._dt, self.steps, self._since), self.surface_peak, self._belongs
        sensed = self._senses
        return SimulatorState(
            self.contact, *when, stepper, sums, peak, self.loss, obstacles, told, belongs, errors, *sensed, self.gas
        )

    def restore(self, state: SimulatorState) -> None:
        """Goes back to a saved state, of this simulator or of another one of the same ROM.

        Raises:
            StepError: it is no such state, of another ROM or among other obstacles, or one alone has a ledger.
        """
        self._belongs.check(state)
        self._stepper.check(state.contact, state.stepper)
        if (state.sums is None) != (self.ledger is None):
            raise StepError("the snapshot and the simulator must both keep an energy account, or neither")
        if self.ledger is not None and state.sums is not None:
            self.ledger.sums = state.sums
        self._dt, self.steps, self._since = state.dt, state.steps, state.since
        self._stepper.restore(state.contact, state.stepper, state.dt)
        if self.environment is not None and state.obstacles is not None:
            self.environment.state = state.obstacles
        self._refill(state.gas)
        self._begin_errors(state.errors)
        self._sense_again(state.sensed, state.rubbed, state.last)
        self._go_on(state.loss, state.surface_peak, state.told)

    def _go_on(self, loss: SwitchLoss, peak: SurfaceStrainPeak, told: "tuple[Told, ...]") -> None:
        """Goes on from what was told of a run."""
        self.loss = loss
        self._monitor.begin(peak)
        if self._skin is not None:
            self._skin.watch.begin(told, self.steps)
            self._skin.forget()
        if not told:
            self.tensions.least = {}
        self._enter()

    def __reduce__(self) -> tuple[Any, ...]:
        as_last_said = {} if self.environment is None else dict(self.environment.signals)
        return _revived, (*self._origin, as_last_said, self.save())

    def __deepcopy__(self, memo: object) -> "Simulator":
        return copy(self)  # the ROM is shared

    def _enter(self) -> None:
        """Follows the stepper to the contact mode that it is in."""
        model = self._stepper.model
        self._order, self._safe_frequencies = model.order, model.safe_frequencies
        self._width = model.inputs.shape[1] - sum(self.rom.loads.values())
        self._monitor_threshold = self._monitor.enter(self.contact, model)
        self._advance = self._way_to_advance()


def _revived(
    rom: Rom, acting: dict[str, Any], told: dict[str, Any], given: "Mapping[str, SignalLike]", state: SimulatorState
) -> Simulator:
    simulator = Simulator(rom, state.dt, ledger=state.sums is not None, **acting, **told)
    for name, signal in given.items():  # after the start: an obstacle may since have gone where the body was
        simulator.set_signal(name, signal)
    simulator.restore(state)
    return simulator
