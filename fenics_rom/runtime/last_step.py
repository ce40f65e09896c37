"""What a body did in its last step, where reactions of supports are read of it."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.runtime.contact_readings import ContactReadings


class NotesLastStep(ContactReadings):
    """A body that takes note of each step, if something asks for it; others are as fast as they were."""

    _order: int

    @property
    def contact(self) -> str:
        """The active contact mode."""
        raise NotImplementedError

    @property
    def shape_coordinates(self) -> Array:
        """The displacement in the shared basis, (k,)."""
        raise NotImplementedError

    @cached_property
    def reads_reactions(self) -> bool:
        """Whether a reading is of the last step."""
        return any(reading.quantity == "reaction" for reading in self.rom.readings.values())

    def _acting_on(self, name: str) -> dict[str, Any]:
        """What a reading is told: the last step, and temperatures; a StepError where a world has taken a step of it."""
        if self.read_touch is not None and self.rom.readings[name].quantity == "reaction":
            raise StepError(f"reading {name!r}: in a world no reactions are read; use a Simulator or a Batch")
        environment, time = self.environment, self.time
        amplitudes = None if environment is None else lambda: environment.amplitudes_at(time)
        return {"last": self.last_step, "amplitudes": amplitudes}

    def _moving(self) -> tuple[Array, Array]:
        """Displacement and velocity in the shared basis, (k,) each."""
        return self.shape_coordinates, self._stepper.model.coordinates @ self._stepper.state[self._order :]

    def _noting(self, advance: Callable[[Array], float]) -> Callable[[Array], float]:
        """What takes a step of a body on which nothing acts but inputs, and takes note of it."""

        def noted(u: Array) -> float:
            start = self._moving()
            twice = advance(u)
            self._note_last(start, u)
            return twice

        return noted

    @cached_property
    def _found_columns(self) -> Array:
        """Of forces that steps find, among inputs (p,): counted from their end, which all contact modes share."""
        if self.environment is None or not len(self._stepper.reactions):
            return np.empty(0, dtype=int)
        from fenics_rom.mechanics.actuator_forces import ActuatorForces

        acting, widths = self.environment.environment, {**self.rom.actuators, **self.rom.loads}
        return ActuatorForces(acting.controls, acting.guides, widths, acting.gases).columns

    def _note_last(self, start: tuple[Array, Array], u: Array) -> None:
        """Takes note of a step under inputs (p,), from what moved before it."""
        from fenics_rom.mechanics.readable_body import LastStep  # here, as below: few bodies need it

        acting, u = None if self.environment is None else self.environment.environment, np.array(u)
        u[self._found_columns] = self._stepper.reactions
        h = self._dt if acting is None or acting.has_inertia else 0.0
        self.last_step = LastStep(h, start, self._moving(), self.contact, u)
