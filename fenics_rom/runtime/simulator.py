"""A soft body in real time: the reduced model of the active contact mode, stepped, switched and accounted for."""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from fenics_rom.errors import StepError, unknown
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.linearity import SurfaceStrainPeak, summary
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.linearity_monitor import LinearityMonitor
from fenics_rom.runtime.rollout import (
    LONGEST,
    BlockPropagator,
    ConstantInterval,
    constant_intervals,
    doubling_blocks,
    one_step,
    repeated,
    run,
)
from fenics_rom.runtime.steppers.midpoint import checked_dt
from fenics_rom.runtime.steppers.midpoint_forms import fastest
from fenics_rom.runtime.switching import Projections, SwitchLoss

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment, SignalLike
    from fenics_rom.runtime.acting import Acting, ContactState, Form
    from fenics_rom.runtime.steppers.finite_strain import LargeDeformation
    from fenics_rom.scene.scene import Scene

Array = np.ndarray


@dataclass(frozen=True)
class Snapshot:
    """All that a simulator does not take from its ROM, exact to the bit.

    Attributes:
        contact: the active contact mode.
        dt: time step, s.
        steps: number of steps taken.
        since: time, s, and number of steps at which dt was last changed.
        state: [√γ q, r] (2m,), read-only.
        sums: of the energy account, J, and what they were rounded by; or None.
        excursion: how far the surface went.
        loss: the switch that lost most.
        rigid: displacement along the rigid motions (ρ,), read-only.
        past: where the obstacles are, and the last contact; None where nothing acts by itself.
        auxiliary: what a step of large deformation carries along besides, read-only.
    """

    contact: str
    dt: float
    steps: int
    since: tuple[float, int]
    state: Array
    sums: tuple[tuple[float, float], ...] | None
    excursion: SurfaceStrainPeak
    loss: SwitchLoss
    rigid: Array = field(default_factory=lambda: np.empty(0))
    past: "ContactState | None" = None
    auxiliary: Array = field(default_factory=lambda: np.empty(0))


class Simulator:
    """Steps a ROM from rest, beginning in its first contact mode.

    Loads and obstacles of the scene act by themselves. Where its contact switches automatically, the contact mode is
    the one that an obstacle is nearest to.

    Args:
        rom: the reduced model; it is only read, and copies of a simulator share it.
        dt: time step, s; may be set anew before any step.
        ledger: whether to keep the energy account.
        scene: whose effects act; None: those of the scene that the ROM was made from.
        signals: of loads and obstacles by name, instead of the scene's: numbers, or functions of time in s. Of
            gravity multiples of its acceleration; of a base motion m/s²; of a prescribed force N (3,); of an obstacle
            its displacement, m (3,).
        stepper: of a body with large deformation: "newton" (for large steps) or "linearly-implicit" (for small ones);
            None: the one that suits dt.

    Attributes:
        steps: number of steps taken.
        ledger: the energy account, or None.
        loss: the switch that lost most, where an account is kept.
        stepper: how a step is taken: "midpoint", or one of the two of large deformation.
        stepping: why it is that one.

    Raises:
        SceneError: an effect that the ROM was not made with, or a load without a history.
        StepError: dt is not a positive finite number, a history has another width, or the body begins in an obstacle.

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
        rom: Rom,
        dt: float,
        *,
        ledger: bool = True,
        scene: "Scene | None" = None,
        signals: "Mapping[str, SignalLike] | None" = None,
        stepper: str | None = None,
    ):
        self._origin = rom, scene, signals, stepper
        self._acting: Acting | None = None
        if rom.surrounded or scene is not None or signals:
            from fenics_rom.runtime import acting  # here, so that bodies on which nothing acts start without it

            rom, surroundings = acting.surrounded(rom, scene, signals)
            self._acting = None if surroundings is None else acting.Acting(rom, surroundings)
        self.rom = rom
        self.steps = 0
        self.ledger = EnergyLedger(self._flush) if ledger else None
        self.loss = SwitchLoss()
        self._dt, self._since = checked_dt(dt), (0.0, 0)
        self._rigid_displacement = np.zeros(rom.rigid)  # displacement along the rigid motions, as far as it is booked
        self._monitor = LinearityMonitor(rom, self._rigid)
        self._projections = Projections(rom)
        self._form: Form
        self._forms: dict[str, Form] = {}
        self._bent: LargeDeformation | None = None
        self.stepper, self.stepping = "midpoint", "the model is linear"
        if rom.deformation is not None or stepper is not None:
            self._bent = self._deforming(stepper)
        self._readings: dict[tuple[str, str], Array] = {}
        self._doubling_blocks: dict[tuple[Any, ...], list[BlockPropagator]] = {}
        self._enter(next(iter(rom.contact_models)))

    def __repr__(self) -> str:
        model, steps = self.rom.contact_models[self._contact], f"{self.steps} step{'' if self.steps == 1 else 's'}"
        columns = {"the contact in N": self.rom.contacts[self._contact], **self.rom.actuators}
        return (
            f"Simulator of {self.rom.name!r}: contact mode {self._contact} (order {model.order}), dt = {self._dt:g} s, "
            f"{steps} taken, {self.stepper}\n"
            f"  input: {', '.join(f'{count} of {name}' for name, count in columns.items())}"
        )

    @property
    def time(self) -> float:
        """Simulated time, s."""
        start, steps = self._since
        return start + (self.steps - steps) * self._dt

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self._dt

    @dt.setter
    def dt(self, dt: float) -> None:
        if dt == self._dt:
            return
        dt = checked_dt(dt)
        self._since, self._dt = (self.time, self.steps), dt
        self._form.set_time_step(dt)

    @property
    def contact(self) -> str:
        """The active contact mode."""
        return self._contact

    @property
    def inputs(self) -> int:
        """Length of the input: the contact mode's columns, then the actuators'."""
        return self._width

    @property
    def state(self) -> tuple[Array, Array]:
        """Copies of the reduced displacement q and velocity r of the active contact mode, (m,) each."""
        return self._q, self._form.state[len(self._ω) :].copy()

    @state.setter
    def state(self, state: tuple[Sequence[float] | Array, Sequence[float] | Array]) -> None:
        given = [np.array(part, dtype=float) for part in state]
        shape = self._ω.shape
        if len(given) != 2 or any(part.shape != shape or not np.isfinite(part).all() for part in given):
            raise StepError(f"state: allowed are two finite arrays of shape {shape}, given: {[p.shape for p in given]}")
        self._rigid()[:] = given[0][: len(self._rigid_displacement)]
        self._form.state[:] = np.concatenate([self._ω * given[0], given[1]])
        if self._bent is not None:
            self._bent.resume()

    @property
    def energy(self) -> float:
        """Stored energy ½ vᵀMv + ½ xᵀKx, with large deformation ½ vᵀMv + Φ(x), J."""
        return self._form.energy

    @property
    def mismatch(self) -> float | None:
        """Of the strains that linearly implicit steps carry along and those of the shape; None where there are none."""
        return None if self._bent is None else self._bent.mismatch

    @property
    def excursion(self) -> SurfaceStrainPeak:
        """How far the surface turned and strained, where the stored energy was high enough for a look at it."""
        return self._monitor.seen

    def displacement(self, output: str | None = None) -> Array:
        """Displacement, m: of a named output (points, 3), or of every mesh node (nodes, 3).

        Without a mesh: the rows of the output, or all n displacements.

        Raises:
            StepError: no such output.
        """
        return self._field(self._q, output)

    def velocity(self, output: str | None = None) -> Array:
        """Velocity, m/s: of a named output (points, 3), or of every mesh node (nodes, 3).

        Raises:
            StepError: no such output.
        """
        return self._field(self._form.state[len(self._ω) :], output)

    def switch(self, contact: str) -> None:
        """Makes another contact mode active; the state is projected, and never gains energy by it.

        Raises:
            StepError: no such contact mode.
        """
        if contact == self._contact:
            return
        if contact not in self.rom.contact_models:
            raise StepError(unknown("contact mode", contact, self.rom.contact_models))
        self._flush()
        if self._bent is not None:  # one basis for all: only the inputs change
            self._enter(contact)
            return
        potential, kinetic = self._projections.between(self._contact, contact)
        was, left, before, m = self._contact, self._form, self._form.state, len(self._ω)
        self._enter(contact)
        if self._acting is not None:
            self._acting.hand_over(left, self._form)
        after, n = self._form.state, len(self._ω)
        np.dot(potential, before[:m], out=after[:n])
        np.dot(kinetic, before[m:], out=after[n:])
        if self.ledger is not None:
            held = float(before.dot(before)) / 2
            lost = held - float(after.dot(after)) / 2
            self.ledger.book(lost_in_switching=lost)
            if lost > self.loss.energy:
                self.loss = SwitchLoss(lost, lost / held, was, contact, self.time)

    def set_signal(self, name: str, history: "SignalLike") -> None:
        """Gives a load or an obstacle another value, or another function of time (s), from the next step on.

        Args:
            name: of gravity (multiples of its acceleration), a base motion (m/s²), a prescribed force (N) or an
                obstacle (its displacement, m).
            history: numbers, or a function that gives them.

        Raises:
            StepError: there is no such load or obstacle, or not so many numbers.
        """
        if self._acting is None:
            raise StepError(unknown("load or obstacle", name, []))
        self._acting.surroundings.set(name, history)

    @property
    def surroundings(self) -> "ActiveEnvironment | None":
        """The loads and obstacles that act by themselves; None where there are none."""
        return None if self._acting is None else self._acting.surroundings

    def contact_forces(self, obstacle: str | None = None) -> Array:
        """Forces on the body in the last step, N: of an obstacle (3,), or on every contact point (P, 3).

        Raises:
            StepError: no such obstacle, or no contact in the scene.
        """
        if self._acting is None:
            raise StepError("there are no contact forces: nothing acts but inputs")
        return self._acting.forces(self._form, obstacle)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of the run so far.

        A surface that went too far, a switch that lost much, contact that was not solved.
        """
        contact = "" if self._acting is None else self._acting.warning
        bent = () if self._bent is None else self._bent.messages
        return tuple(filter(None, [summary(self.excursion), self.loss.message, contact, *bent]))

    @property
    def contact_points(self) -> Array:
        """Nodes (P,) that obstacles can touch; none where the scene has no contact."""
        return np.empty(0, dtype=int) if self._acting is None else self._acting.points

    def step(self, u: Sequence[float] | Array = ()) -> None:
        """Advances by dt under a constant input.

        Args:
            u: (p,) N; the contact mode's columns, then the actuators' (Pa of a pressure). The actuators' alone, where
                the scene has loads, obstacles or no inertia: then nothing pushes at the contact mode besides.

        Raises:
            StepError: wrong length, or not finite, or no contact forces were found; the state is as it was.
        """
        if self._acting is not None:
            self._step_with(self._acting, u)
            return
        form = self._form
        try:
            u = np.asarray(u, dtype=float)
            twice = form.step(u)
        except (TypeError, ValueError):
            raise StepError(self._wrong_input(u)) from None
        if twice <= self._monitor_threshold:
            self.steps += 1
        else:
            self._step_high(u, twice)

    def _step_with(self, acting: "Acting", u: Sequence[float] | Array) -> None:
        """A step with what acts by itself."""
        before = None
        nearest = acting.nearest(self._contact, self._form)
        if nearest != self._contact:
            before = self.save()
            self.switch(nearest)
        try:
            try:
                u = acting.input(np.asarray(u, dtype=float), self._width, self.time, self._dt)
            except (TypeError, ValueError):
                raise StepError(self._wrong_input(u)) from None
            twice = self._form.step(u)
            if twice <= self._monitor_threshold:
                self.steps += 1
            else:
                self._step_high(u, twice)
        except BaseException:
            if before is not None:
                self.restore(before)
            raise
        acting.surroundings.arrive(self._dt)

    def _step_high(self, u: Array, twice: float) -> None:
        """The end of a step to an energy at which the surface may have gone too far, or that is not a number."""
        if not math.isfinite(twice):
            self._form.rollback()
            raise StepError(
                f"step {self.steps}: input {u.tolist()} leads out of the finite numbers; the state was left as it was"
            )
        self.steps += 1
        self._monitor.look(self._form.state[: len(self._ω)], self.time)

    def _wrong_input(self, u: object) -> str:
        given = f"an array of shape {u.shape}" if isinstance(u, np.ndarray) else repr(u)[:80]
        return (
            f"step {self.steps}: input of contact mode {self._contact!r}: allowed are {self.inputs} numbers in N, "
            f"given: {given}"
        )

    def rollout(
        self,
        inputs: Sequence[Sequence[float]] | Array,
        *,
        contact: str | Sequence[str] | None = None,
        dt: float | Sequence[float] | Array | None = None,
        every: int = 1,
        outputs: Sequence[str] | None = None,
    ) -> dict[str, Array]:
        """Takes many steps under known inputs at once, as products of matrices; the same as stepping, to round-off.

        Args:
            inputs: (steps, p) N, of each step.
            contact: contact mode to be in from the first step on, or (steps,) in each; None: the active one. All must
                take p inputs.
            dt: time step from the first step on, or (steps,) of each, s; None: the one that is set.
            every: the outputs are read after every so many steps.
            outputs: names of those that are read; None: all.

        Returns:
            Displacement of each output, m: (steps // every, points, 3); without a mesh (steps // every, rows).

        Raises:
            StepError: wrong shapes, unknown names, or numbers that are not finite; everything is as it was.
        """
        if self._bent is not None:
            raise StepError("rollout: is for linear models; with large deformation take each step by itself")
        if self._acting is not None and self._acting.step_by_step:
            raise StepError("rollout: is for known forces; among obstacles or without inertia take each step by itself")
        if not (isinstance(every, int | np.integer) and every >= 1):
            raise StepError(f"every = {every!r}: allowed is a whole number of steps, at least 1")
        u, plan = self._planned(inputs, contact, dt)
        names = tuple(self.rom.outputs if outputs is None else outputs)
        widths = [len(self._reading(name)) for name in names]
        start, read = self.save(), [np.empty((0, sum(widths)))]
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is told as a StepError
                for span in plan:
                    self.dt = span.dt
                    self.switch(span.contact)
                    self._rollout(u[span.start : span.stop], span.start, every if names else 1, names, read)
        except BaseException:
            self.restore(start)
            raise
        parts = np.split(np.concatenate(read), np.cumsum(widths)[:-1], axis=1) if names else []
        return {name: self._points(values) for name, values in zip(names, parts, strict=True)}

    def _planned(
        self,
        inputs: Sequence[Sequence[float]] | Array,
        contact: str | Sequence[str] | None,
        dt: float | Sequence[float] | Array | None,
    ) -> tuple[Array, list[ConstantInterval]]:
        """What a rollout was asked for, checked."""
        u = np.asarray(inputs, dtype=float)
        if u.ndim != 2:
            raise StepError(f"inputs: allowed are (steps, {self.inputs}) numbers in N, given: shape {u.shape}")
        bad = np.flatnonzero(~np.isfinite(u).all(axis=1))
        if len(bad):
            raise StepError(f"step {self.steps + bad[0]}: input {u[bad[0]].tolist()} is not finite")
        plan = constant_intervals(len(u), self._contact if contact is None else contact, self._dt if dt is None else dt)
        loads = sum(self.rom.loads.values())
        for span in plan:
            checked_dt(span.dt)
            if span.contact not in self.rom.contact_models:
                raise StepError(unknown("contact mode", span.contact, self.rom.contact_models))
            columns = self.rom.contact_models[span.contact].inputs.shape[1]
            if u.shape[1] != columns - loads:
                raise StepError(
                    f"step {self.steps + span.start}: inputs of contact mode {span.contact!r}: allowed are (steps, "
                    f"{columns - loads}) numbers in N, given: shape {u.shape}"
                )
        if self._acting is not None:
            around = self._acting.surroundings
            ends = self.time + np.cumsum(np.concatenate([np.full(span.stop - span.start, span.dt) for span in plan]))
            halves = np.concatenate([np.full(span.stop - span.start, span.dt / 2) for span in plan])
            u = np.hstack([u, np.array([around.loads(t) for t in ends - halves]).reshape(len(u), loads)])
        return u, plan

    def _rollout(self, u: Array, taken: int, every: int, names: tuple[str, ...], read: list[Array]) -> None:
        """Takes the steps of one span, `taken` steps after the rollout began, and adds what is read to `read`."""
        if len(self._rigid_displacement):  # outputs follow what energy coordinates do not hold
            for count, row in enumerate(u, start=taken + 1):
                self.step(row)
                if names and count % every == 0:
                    read.append(np.concatenate([self._reading(name) @ self._q for name in names])[None])
            return
        while len(u):
            due = every - taken % every  # steps until the outputs are due
            if due == every <= min(LONGEST, len(u)):
                steps = len(u) - len(u) % every
                read += self._blocks(u[:steps], every, names)
            else:
                steps = min(due, len(u))
                self._blocks(u[:steps], 1, ())
                if steps == due:
                    read.append(np.concatenate([self._reading(name) @ self._q for name in names])[None])
            u, taken = u[steps:], taken + steps

    def _blocks(self, u: Array, every: int, names: tuple[str, ...]) -> list[Array]:
        """Takes steps in the longest blocks that fit; what is read, a row for each instant."""
        key = self._contact, self._dt, every, names
        if key not in self._doubling_blocks:
            if len(self._doubling_blocks) >= 32:  # step sizes that never come back must not pile up
                self._doubling_blocks.clear()
            rows = np.concatenate([np.empty((0, len(self._ω))), *(self._reading(name) / self._ω for name in names)])
            single = one_step(self.rom.contact_models[self._contact], self._dt, rows, self.ledger is not None)
            self._doubling_blocks[key] = doubling_blocks(repeated(single, every))
        read, state = [], self._form.state
        width = len(self._doubling_blocks[key][-1].outputs)
        for block in self._doubling_blocks[key]:
            times = len(u) // block.length
            steps = times * block.length
            if times:
                outputs, starts, *work = run(block, state, u[:steps].reshape(times, -1))
                if not math.isfinite(state.dot(state)):
                    raise StepError(f"steps from {self.steps} on: the inputs lead out of the finite numbers")
                if self.ledger is not None:
                    self.ledger.book(supplied=work[0], dissipated=work[1])
                twice = np.einsum("bs,bs->b", starts, starts)
                highest = int(twice.argmax())
                if twice[highest] > self._monitor_threshold:
                    e, later = starts[highest, : len(self._ω)], highest * block.length * self._dt
                    self._monitor.look(e, self.time + later)
                self.steps += steps
                read.append(outputs.reshape(steps // every, width))
                u = u[steps:]
        return read

    def reset(self) -> None:
        """Back to rest in the first contact mode, at time 0, with an empty account; dt stays."""
        if self._acting is not None:
            self._acting.check_start()
        self._rigid()[:] = 0
        if self.ledger is not None:
            self.ledger.sums = EnergyLedger().sums
        self.loss = SwitchLoss()
        self.steps, self._since = 0, (0.0, 0)
        self._monitor.begin(SurfaceStrainPeak())
        self._enter(next(iter(self.rom.contact_models)))
        self._form.state[:] = 0
        if self._bent is not None:
            self._bent.resume()
        if self._acting is not None:
            self._acting.reset(self._form)

    def save(self) -> Snapshot:
        """The state of everything, to come back to."""
        self._form.reset_buffer()
        state = self._form.state.copy()
        rigid = self._rigid().copy()
        auxiliary = np.empty(0) if self._bent is None else self._bent.auxiliary.copy()
        state.flags.writeable = rigid.flags.writeable = auxiliary.flags.writeable = False
        sums = None if self.ledger is None else self.ledger.sums
        past = None if self._acting is None else self._acting.save(self._form)
        where = self._contact, self._dt, self.steps, self._since
        return Snapshot(*where, state, sums, self.excursion, self.loss, rigid, past, auxiliary)

    def restore(self, snapshot: Snapshot) -> None:
        """Goes back to a saved state, of this simulator or of another one of the same ROM.

        Raises:
            StepError: it is of another ROM, or has a ledger where this has none, or none where this has one.
        """
        mode = self.rom.contact_models.get(snapshot.contact)
        if mode is None or 2 * mode.order != len(snapshot.state) or mode.rigid != len(snapshot.rigid):
            raise StepError(f"the snapshot is of another ROM than {self.rom.name!r}")
        own = 0 if self._bent is None else len(self._bent.auxiliary)
        if own and len(snapshot.auxiliary) not in (0, own):
            raise StepError(f"the snapshot is of another ROM than {self.rom.name!r}")
        if (snapshot.sums is None) != (self.ledger is None):
            raise StepError("the snapshot and the simulator must both keep an energy account, or neither")
        if self.ledger is not None and snapshot.sums is not None:
            self.ledger.sums = snapshot.sums
        self._rigid()[:] = snapshot.rigid
        self._dt, self.steps, self._since = snapshot.dt, snapshot.steps, snapshot.since
        self._monitor.begin(snapshot.excursion)
        self.loss = snapshot.loss
        self._enter(snapshot.contact)
        self._form.state[:] = snapshot.state
        if self._bent is not None:
            self._bent.resume(snapshot.auxiliary)
        if self._acting is not None and snapshot.past is not None:
            self._acting.restore(self._form, snapshot.past)

    def __reduce__(self) -> tuple[Any, ...]:
        return _revived, (*self._origin, self._driven, self.save())

    def __copy__(self) -> "Simulator":
        return _revived(*self._origin, self._driven, self.save())

    def __deepcopy__(self, memo: object) -> "Simulator":
        return _revived(*self._origin, self._driven, self.save())

    @property
    def _driven(self) -> "dict[str, SignalLike]":
        """What loads and obstacles do, as it was last said."""
        return {} if self._acting is None else dict(self._acting.surroundings.signals)

    def _flush(self) -> None:
        """Books what the steps so far supplied and dissipated; no other contact mode than the active one owes any."""
        self._form.flush()

    def _deforming(self, stepper: str | None) -> "LargeDeformation":
        """How a body with large deformation is stepped."""
        from fenics_rom.runtime.steppers import finite_strain  # here, so that linear bodies start without it

        if self.rom.deformation is None:
            raise StepError(f"stepper = {stepper!r}: belongs to large deformation, which ROM {self.rom.name!r} has not")
        touch, quasi_static = (None, False) if self._acting is None else self._acting.touching
        self.stepper, self.stepping = finite_strain.chosen(self.rom, self._dt, stepper, quasi_static)
        return finite_strain.BY_NAME[self.stepper](self.rom, self.ledger, touch)

    def _enter(self, contact: str) -> None:
        mode = self.rom.contact_models[contact]
        self._contact = contact
        if self._bent is not None:
            self._form, self._monitor_threshold = (
                self._bent,
                sys.float_info.max,
            )  # there is no linear limit to look out for
            self._bent.enter(mode)
        else:
            if contact not in self._forms:
                form = fastest if self._acting is None else self._acting.form
                self._forms[contact] = form(mode, self.ledger, self._rigid_displacement)
            self._form, self._monitor_threshold = self._forms[contact], self._monitor.enter(contact)
        self._form.reset_buffer()
        if self._form.h != self._dt:
            self._form.set_time_step(self._dt)
        self._width = mode.inputs.shape[1] - sum(self.rom.loads.values())
        self._ω, self._safe_frequencies = np.sqrt(mode.eigenvalues), mode.safe_frequencies

    def _rigid(self) -> Array:
        """Displacement along the rigid motions (ρ,), up to date, to read or to change."""
        if len(self._rigid_displacement):
            self._flush()
        return self._rigid_displacement

    @property
    def _q(self) -> Array:
        q = self._form.state[: len(self._ω)] / self._safe_frequencies
        q[: len(self._rigid_displacement)] = self._rigid()
        return q

    def _reading(self, output: str) -> Array:
        """Rows of a named output, (rows, m), in the active contact mode's basis."""
        if output not in self.rom.outputs:
            raise StepError(unknown("output", output, self.rom.outputs))
        key = self._contact, output
        if key not in self._readings:
            self._readings[key] = self.rom.outputs[output] @ self.rom.contact_models[self._contact].coordinates
        return self._readings[key]

    def _points(self, rows: Array) -> Array:
        return rows.reshape(*rows.shape[:-1], rows.shape[-1] // 3, 3) if len(self.rom.nodes) else rows

    def _field(self, coordinates: Array, output: str | None) -> Array:
        if output is not None:
            return self._points(self._reading(output) @ coordinates)
        return self.rom.reconstruct(self.rom.contact_models[self._contact].coordinates @ coordinates)


def _revived(
    rom: Rom,
    scene: "Scene | None",
    signals: "Mapping[str, SignalLike] | None",
    stepper: str | None,
    driven: "Mapping[str, SignalLike]",
    snapshot: Snapshot,
) -> Simulator:
    ledger = snapshot.sums is not None
    simulator = Simulator(rom, snapshot.dt, ledger=ledger, scene=scene, signals=signals, stepper=stepper)
    for name, history in driven.items():  # after the start: an obstacle may since have gone where the body was
        simulator.set_signal(name, history)
    simulator.restore(snapshot)
    return simulator
