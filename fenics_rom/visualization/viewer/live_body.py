"""A body that is stepped while somebody pulls at it: simulator, mouse, actuators and account. No picture."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StructureError
from fenics_rom.mechanics.environment import Environment
from fenics_rom.rom.rom import Rom
from fenics_rom.rom.truncate import truncate
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.trajectory.series import ReadingSeries, reading_series
from fenics_rom.trajectory.trajectory import Trajectory
from fenics_rom.visualization.viewer.actuators import actuators_of
from fenics_rom.visualization.viewer.live import Account, Live
from fenics_rom.visualization.viewer.mouse_spring import MouseSpring, MouseSpringStep, attach_spring, spring_step
from fenics_rom.visualization.viewer.recording import Recording

STEPS_IN_A_PERIOD = 100  # of the lowest oscillation, where the scene has no time step


class LiveBody(Live):
    """Steps a ROM under a mouse and actuators.

    The mouse pulls with a spring at a point of the surface, never stronger than what a linear model can follow. While
    it holds, the contact mode is the one that is held; else it is the last one, or what the obstacles make it.

    Args:
        rom: the reduced model.
        dt: time step, s; None: the scene's.

    Attributes:
        rom: at the order it is stepped at.

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
        super().__init__(actuators_of(rom))
        self._pull: MouseSpringStep | None = None
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
        """As in Live."""
        return self.simulator.dt

    @dt.setter
    def dt(self, dt: float) -> None:
        """As in Live; a recording, whose steps are equal, ends."""
        if dt != self.dt:
            self._recording = None
            self.simulator.dt = dt
            if self._pull is not None:
                self._hold(self._pull.spring, self._pull.nodes, self._pull.weights)

    @property
    def time(self) -> float:
        """As in Live."""
        return self.simulator.time

    @property
    def warnings(self) -> tuple[str, ...]:
        """As in Live."""
        return self.simulator.warnings

    @property
    def account(self) -> Account:
        """As in Live."""
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
        self.mouse = self._hold(spring, nodes, weights).place(self.simulator)
        return True

    def _hold(self, spring: MouseSpring, nodes: Array, weights: Array) -> MouseSpringStep:
        self._pull = pull = spring_step(self.simulator, self.rom, spring, nodes, weights)
        return pull

    def release(self) -> None:
        """As in Live."""
        self._pull, self.force = None, np.zeros(3)
        if self.simulator is not self._free:
            self._free.restore(self.simulator.save())
            self.simulator = self._free

    @property
    def spring(self) -> MouseSpring | None:
        """What the mouse pulls at; None: nothing."""
        return None if self._pull is None else self._pull.spring

    @property
    def held_at(self) -> Array | None:
        """As in Live."""
        return None if self._pull is None else self._pull.place(self.simulator)

    @property
    def largest_force(self) -> float:
        """As in Live."""
        return math.inf if self._pull is None else self._pull.spring.largest

    def _take_step(self) -> float:
        simulator, u = self.simulator, self._input()
        begin = perf_counter()
        simulator.step(u)
        took = perf_counter() - begin
        if self._recording is not None:
            self._recording.steps.append((simulator.contact, u))
            self._recording.seconds += took
        return took

    def _input(self) -> Array:
        pull = self._pull
        if pull is not None:
            others = self.values.copy()
            for name, reaction in self.simulator.reactions.items():  # in the step before: this one's is not known yet
                others[self._columns[name]] = reaction
            self.force, pushes = pull.force(self.simulator, others, self.mouse)
            return np.concatenate([pushes, self.values])
        if self.simulator.environment is not None:
            return self.values.copy()
        return np.concatenate([np.zeros(self.simulator.inputs - len(self.values)), self.values])

    def reset(self) -> None:
        """As in Live: at rest at time 0; a recording ends."""
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
