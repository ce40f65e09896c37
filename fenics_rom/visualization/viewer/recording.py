"""What was done to a live body, step by step, and the run that it makes.

A step costs the live body one entry of a list. The run is made afterwards, by taking the same steps again from where
the body was: a simulator's steps are the same to the bit.
"""

from dataclasses import dataclass, field

from numpy import ndarray as Array

from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulated_body import SimulatorState
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.trajectory.trajectory import Trajectory, TrajectoryRecorder

PER_SECOND = 30  # whole shapes kept
MOST_NUMBERS = 3e7  # in all shapes together, 240 MB


@dataclass
class Recording:
    """The steps of a live body from a state on: contact mode and input of each, and their wall clock, s."""

    start: SimulatorState
    steps: list[tuple[str, Array]] = field(default_factory=list)
    seconds: float = 0.0

    def run(self, rom: Rom, simulator: Simulator) -> Trajectory:
        """The run, whose account begins anew, by a simulator whose contact mode does not switch by itself."""
        simulator.restore(self.start)
        assert simulator.ledger is not None
        simulator.ledger.sums = EnergyLedger().sums
        shapes = min(round(len(self.steps) * self.start.dt * PER_SECOND), int(MOST_NUMBERS / rom.nodes.size))
        recorder = TrajectoryRecorder(rom, rom.environment, len(self.steps), self.start.dt, snapshots=max(shapes, 1))

        recorder.sample(0, simulator)
        for step, (contact, u) in enumerate(self.steps, start=1):
            simulator.switch(contact)
            simulator.step(u)
            recorder.sample(step, simulator, u)
        return recorder.record(
            name=rom.name,
            model="reduced",
            settings=simulator.settings | {"seconds": self.seconds},
            tendons=rom.environment.tendons,
            warnings=(*rom.warnings, *simulator.warnings),
        )
