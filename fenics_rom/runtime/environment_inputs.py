"""The inputs of a step where loads and obstacles act by themselves, and the contact mode that they ask for."""

import numpy as np

from fenics_rom.errors import StepError, unknown
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.step import StepInput
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.stepper import ReducedStepper

Array = np.ndarray


class EnvironmentInputs:
    """The source of inputs of a simulator.

    Args:
        rom: the reduced model.
        environment: what acts.

    Attributes:
        environment: what acts.
        needs_each_step: whether what happens in a step is not known before it is taken.
    """

    def __init__(self, rom: Rom, environment: ActiveEnvironment):
        self.environment = environment
        acting = environment.environment
        self.needs_each_step = not acting.has_inertia or acting.contact_law is not None
        self._switches = acting.switches_itself and len(rom.contact_models) > 1
        self._actuator_columns = sum(rom.actuators.values())

    def nearest(self, stepper: ReducedStepper) -> str:
        """The contact mode to be in."""
        interface = stepper.interface
        if not self._switches or interface is None:
            return stepper.contact_mode
        gaps = interface.solver.gaps(stepper.point_displacement(), self.environment.state.offsets)
        nearest = interface.points.nearest(gaps, stepper.contact_mode)
        if self.environment.mark is not None:
            self.environment.mark("switching")
        return nearest

    def step_input(self, u: Array, width: int, time: float, dt: float) -> StepInput:
        """All that acts in the step of dt, s, that begins at a time, s.

        Args:
            u: (width,), or the actuators' alone.
            width: number of contact columns and actuators' columns.
            time, dt: s.

        Raises:
            ValueError: u has another shape.
            StepError: a signal gave something else than finite numbers.
        """
        if u.shape != (width,):
            if u.shape != (self._actuator_columns,):
                raise ValueError
            u = np.concatenate([np.zeros(width - len(u)), u])
        return self.environment.step_input(u, time, dt)

    def contact_forces(self, stepper: ReducedStepper, obstacle: str | None) -> Array:
        """As Simulator.contact_forces."""
        interface, contact = stepper.interface, stepper.contact
        if interface is None:
            raise StepError("there are no contact forces: the scene has no contact")
        names = list(self.environment.obstacles)
        if obstacle is not None and obstacle not in names:
            raise StepError(unknown("obstacle", obstacle, names))
        if obstacle is None:
            return np.zeros(interface.points.coordinates.shape) if contact is None else contact.forces
        return np.zeros(3) if contact is None else contact.by_obstacle[names.index(obstacle)]
