"""A body that is stepped while somebody pulls at it: simulator, mouse, actuators and account. No picture."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StructureError
from fenics_rom.io.units import UNITS
from fenics_rom.mechanics.environment import Environment
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.truncate import truncate
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.trajectory.series import ReadingSeries, reading_series
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.viewer.mouse_spring import (
    MouseSpring,
    MouseSpringStep,
    MovingMouseSpringStep,
    attach_spring,
    largest_input,
)
from fenics_rom.visualization.viewer.recording import Recording

SHOWN_STROKES = {"m": "mm", "m3": "ml"}  # units of sliders by those of strokes
STEPS_IN_A_PERIOD = 100  # of the lowest oscillation, where the scene has no time step


class Actuator(NamedTuple):
    """One column of an input that all contact modes share, its unit, and the range of its slider.

    The range is what the surface at rest can follow (see `largest_input`), and all that the scene applies; of a given
    stroke what the scene applies alone, if it does.
    """

    name: str
    unit: str
    least: float
    largest: float
    scale: float = 1.0  # of the input, per unit of the slider


class Account(NamedTuple):
    """Where the energy is, J: stored = supplied - dissipated - lost in switching - numerical, but for round-off."""

    stored: float
    supplied: float
    dissipated: float
    lost: float
    numerical: float


class LiveBody:
    """Steps a ROM under a mouse and actuators that may change before any step.

    The mouse pulls with a spring at a point of the surface, never stronger than what a linear model can follow. While
    it holds, the contact mode is the one that is held; else it is the last one, or what the obstacles make it.

    Args:
        rom: the reduced model.
        dt: time step, s; None: the scene's.

    Attributes:
        rom: at the order it is stepped at.
        dt: time step, s.
        actuators: columns that can be set.
        values: (columns,) what they are set to.
        mouse: where the mouse is, (3,), m.
        force: what it pulls with, (3,), N.
        steps: number of steps taken since the start, whatever was reset meanwhile.
        seconds: wall clock of these steps, s.

    Raises:
        SceneError: a ROM without a surface, or a load of its scene without a history.
        StepError: dt is not a positive finite number, or the body begins in an obstacle.
    """

    def __init__(self, rom: Rom, dt: float | None = None):
        if not len(rom.nodes) or not len(rom.triangles):
            raise SceneError(
                f"ROM {rom.name!r} has no surface triangles, as it was made from matrices and not from a mesh: "
                "there is nothing to draw; step it with fr.Simulator"
            )
        self._whole = self.rom = rom
        self._columns = dict(zip(rom.actuators, np.cumsum([0, *rom.actuators.values()]).tolist(), strict=False))
        self.actuators = _actuators(rom)
        self.values = np.zeros(len(self.actuators))
        self._spring_step: MouseSpringStep | MovingMouseSpringStep | None = None
        self.force, self.mouse = np.zeros(3), np.zeros(3)
        self.steps, self.seconds = 0, 0.0
        self._recording: Recording | None = None
        self._begin(_time_step(rom) if dt is None else dt)

    def _begin(self, dt: float) -> None:
        self._free = Simulator(self.rom, dt)
        # No obstacle may switch a mode that is held: a second simulator takes over, which does not switch.
        self._alone = not (self.rom.environment.switches_itself and len(self.rom.contact_models) > 1)
        self._held = self._free if self._alone else Simulator(self.rom, dt, scene=_unswitched(self.rom))
        self.simulator = self._free

    @property
    def order(self) -> int:
        """Displacements that strain, of the contact mode that has most."""
        return max(mode.order - mode.rigid for mode in self.rom.contact_models.values())

    @order.setter
    def order(self, order: int) -> None:
        """Truncates, which begins anew: states of two orders are not of one basis."""
        dt = self.dt
        self.rom = truncate(self._whole, order)
        self.release()
        self._recording = None
        self._begin(dt)

    @property
    def largest_order(self) -> int | None:
        """Of the ROM as it was read; None where it cannot be truncated."""
        most = max(mode.order - mode.rigid for mode in self._whole.contact_models.values())
        try:
            truncate(self._whole, most)
        except StructureError:
            return None
        return most

    @property
    def dt(self) -> float:
        """Time step, s."""
        return self.simulator.dt

    @dt.setter
    def dt(self, dt: float) -> None:
        """Sets it from the next step on; a recording, whose steps are equal, ends."""
        if dt != self.dt:
            self._recording = None
            self.simulator.dt = dt
            if self._spring_step is not None:
                self._spring_step = self._pull_by(self._spring_step.spring)

    @property
    def account(self) -> Account:
        """Of the steps since the last reset."""
        ledger = self.simulator.ledger
        assert ledger is not None
        return Account(self.simulator.energy, *(total for total, _ in ledger.sums[:4]))

    def reading(self, name: str) -> ReadingSeries:
        """A reading, of this instant alone."""
        return reading_series(self.rom.readings[name], self.simulator.reading(name)[None])

    @property
    def damping_ratio(self) -> tuple[float, float]:
        """Of the lowest oscillation of the active contact mode: damping as a share of critical, and frequency, Hz."""
        mode = self.rom.contact_models[self.simulator.contact]
        first = mode.rigid
        D = mode.damping if mode.damping.ndim == 1 else np.diag(mode.damping)
        ω = math.sqrt(mode.eigenvalues[first])
        return float(D[first]) / (2 * ω), ω / math.tau

    def grab(self, contact: str, nodes: Array, weights: Array) -> bool:
        """Takes hold of a point of a contact surface, whatever was held before; False where nothing would come of it.

        The point is the mean of nodes (c,) of the mesh with weights (c,), in sum 1.
        """
        spring = attach_spring(self.rom, contact, nodes, weights)
        if spring is None:
            return False
        if self.simulator is not self._held:
            self._held.restore(self.simulator.save())
            self.simulator = self._held
        self.simulator.switch(contact)
        self._grip = nodes, weights
        self._spring_step = self._pull_by(spring)
        self.mouse = self.held_at
        return True

    def _pull_by(self, spring: MouseSpring) -> MouseSpringStep | MovingMouseSpringStep:
        if self.rom.environment.is_moving:
            return MovingMouseSpringStep(self.simulator, self.rom, spring, *self._grip)
        return MouseSpringStep(self.rom, spring, self.dt)

    def release(self) -> None:
        """Lets go."""
        self._spring_step, self.force = None, np.zeros(3)
        if self.simulator is not self._free:
            self._free.restore(self.simulator.save())
            self.simulator = self._free

    @property
    def spring(self) -> MouseSpring | None:
        """What the mouse pulls at; None: nothing."""
        return None if self._spring_step is None else self._spring_step.spring

    @property
    def held_at(self) -> Array:
        """Where the point is that is held, (3,), m."""
        pull = self._spring_step
        assert pull is not None
        if isinstance(pull, MovingMouseSpringStep):
            return pull.place(self.simulator)
        return pull.spring.moved(self.simulator.state[0])

    def step(self) -> None:
        """Takes one step. Raises StepError where it could not be taken; the state is as it was."""
        simulator, u = self.simulator, self._input()
        begin = time.perf_counter()
        simulator.step(u)
        took = time.perf_counter() - begin
        self.steps += 1
        self.seconds += took
        if self._recording is not None:
            self._recording.steps.append((simulator.contact, u))
            self._recording.seconds += took

    def _input(self) -> Array:
        around, pull = self.simulator.environment, self._spring_step
        if pull is not None:
            others = self.values.copy()
            for name, reaction in self.simulator.reactions.items():  # in the step before: this one's is not known yet
                others[self._columns[name]] = reaction
            if isinstance(pull, MovingMouseSpringStep):
                self.force, turned = pull.force(self.simulator, others, self.mouse)
                return np.concatenate([pull.spring.spread @ turned, self.values])
            loads = np.empty(0) if around is None else around.loads_at(self.simulator.time + self.dt / 2)
            self.force = pull.force(*self.simulator.state, np.concatenate([others, loads]), self.mouse)
            return np.concatenate([pull.spring.spread @ self.force, self.values])
        if around is not None:
            return self.values.copy()
        return np.concatenate([np.zeros(self.simulator.inputs - len(self.values)), self.values])

    def advance(self, duration: float, patience: float, clock: Callable[[], float] = time.perf_counter) -> float:
        """Takes the steps that begin within a duration, s, but none after a patience, s, by the wall clock.

        Returns of the duration what is left: negative where the last step went beyond it. Raises what `step` does.
        """
        end = clock() + patience
        while duration > 0 and clock() < end:
            self.step()
            duration -= self.dt
        return duration

    def reset(self) -> None:
        """Back to rest at time 0, with nothing held, actuators at zero and an empty account; a recording ends."""
        self.release()
        self._recording = None
        self.values[:] = 0
        self._free.reset()

    @property
    def records(self) -> bool:
        """Whether steps are being recorded."""
        return self._recording is not None

    def record(self) -> None:
        """Begins to record, from the next step on."""
        self._recording = Recording(self.simulator.save())

    def finish(self) -> Callable[[], Trajectory] | None:
        """Ends the recording; what is returned makes the run, in any thread, and None means that no step was taken."""
        recording, self._recording = self._recording, None
        if recording is None or not recording.steps:
            return None
        rom = self.rom
        environment = rom.environment if self._alone else _unswitched(rom)
        return lambda: recording.run(rom, Simulator(rom, recording.start.dt, scene=environment))


def free_name(folder: Path, stem: str) -> Path:
    """A file STEM-view-1.h5, -2, ... that does not exist yet."""
    number = 1
    while (file := folder / f"{stem}-view-{number}.h5").exists():
        number += 1
    return file


def _time_step(rom: Rom) -> float:
    if rom.environment.run is not None:
        return rom.environment.run.dt
    lowest = min(mode.eigenvalues[mode.rigid] for mode in rom.contact_models.values())
    return math.tau / math.sqrt(lowest) / STEPS_IN_A_PERIOD


def _unswitched(rom: Rom) -> Environment:
    """What acts, but the contact mode does not follow the obstacles."""
    return replace(rom.environment, contact_switching="scene")


def _actuators(rom: Rom) -> list[Actuator]:
    """Every column of every actuator."""
    first = next(iter(rom.contact_models))
    column = rom.contacts[first]
    found = []
    for name, width in rom.actuators.items():
        is_tendon, unit = name in rom.environment.details("effects.tendon"), rom.environment.input_units.get(name, "N")
        shown = SHOWN_STROKES.get(unit, unit)
        scale = UNITS[unit][shown] if shown != unit else 1.0
        applied, by_stroke = _applied(rom, name, width) / scale, name in rom.environment.controls
        for k in range(width):
            limit = largest_input(rom, first, column)
            if by_stroke:
                mode = rom.contact_models[first]
                limit *= float(np.square(mode.inputs[:, column] / mode.safe_frequencies).sum()) / scale
            limit = 0.0 if by_stroke and applied.any() else float(f"{limit:.2g}")
            least, largest = 0.0 if is_tendon else -limit, limit  # a cable only pulls
            axis = f" {'xyz'[k]}" if width == 3 else f" {k + 1}" if width > 1 else ""
            span = min(least, *applied[:, k]), max(largest, *applied[:, k])
            found.append(Actuator(name + axis, shown, *span, scale))
            column += 1
    return found


def _applied(rom: Rom, actuator: str, width: int) -> Array:
    """What the scene's load history applies to an actuator, (any, width), in the actuator's unit; 0 first."""
    loads = () if rom.environment.run is None else rom.environment.run.loads
    of_it = [np.atleast_2d(load.signal.values) for load in loads if load.actuator == actuator]
    return np.concatenate([np.zeros((1, width)), *of_it])
