"""What is stepped with the clock while somebody pulls at it."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.visualization.viewer.actuators import Actuator

ROUND_OFF = 1e-9  # of a force


class Account(NamedTuple):
    """Where the energy is, J: stored grows by supplied - dissipated - lost in switching - numerical, to round-off."""

    stored: float
    supplied: float
    dissipated: float
    lost: float
    numerical: float


class Live(ABC):
    """Bodies that are stepped under a mouse and actuators, both of which may change before any step.

    Args:
        actuators: columns that can be set.

    Attributes:
        actuators: as given.
        values: (columns,) what they are set to.
        mouse: where the mouse is, (3,), m.
        force: what it pulls with, (3,), N.
        steps: number of steps taken since the start, whatever was reset meanwhile.
        seconds: wall clock of these steps, s.
    """

    def __init__(self, actuators: Sequence[Actuator]):
        self.actuators, self.values = actuators, np.zeros(len(actuators))
        self.force, self.mouse = np.zeros(3), np.zeros(3)
        self.steps, self.seconds = 0, 0.0

    @property
    @abstractmethod
    def dt(self) -> float:
        """Time step, s."""

    @dt.setter
    @abstractmethod
    def dt(self, dt: float) -> None:
        """Sets it from the next step on."""

    @property
    @abstractmethod
    def time(self) -> float:
        """Simulated since the last reset, s."""

    @property
    @abstractmethod
    def account(self) -> Account:
        """Of the steps since the last reset."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of what is shown."""

    @property
    @abstractmethod
    def held_at(self) -> Array | None:
        """Where the point is that the mouse holds, (3,), m; None: it holds none."""

    @property
    @abstractmethod
    def largest_force(self) -> float:
        """That the mouse may pull with, N; infinite where it holds nothing."""

    @property
    def pulls_its_most(self) -> bool:
        """Whether the mouse would pull harder if it were let."""
        return float(np.linalg.norm(self.force)) > (1 - ROUND_OFF) * self.largest_force

    @abstractmethod
    def release(self) -> None:
        """Lets go."""

    @abstractmethod
    def reset(self) -> None:
        """Back to the start, with nothing held, actuators at zero and an empty account."""

    @abstractmethod
    def _take_step(self) -> float:
        """Takes one step; what of its wall clock is the step itself, s."""

    def step(self) -> None:
        """Takes one step. Raises StepError where it could not be taken; the state is as it was."""
        self.seconds += self._take_step()
        self.steps += 1

    def take_first_steps(self) -> None:
        """Takes two steps, and goes back to the start: what they need is compiled then, and no picture waits for it."""
        with suppress(StepError):  # it is told where it is seen
            for _ in range(2):
                self._take_step()
        self.reset()

    def advance(
        self,
        duration: float,
        patience: float,
        before_last: Callable[[], object],
        clock: Callable[[], float] = perf_counter,
    ) -> float:
        """Takes the steps that begin within a duration, s, but none after a patience, s, by the wall clock.

        Before the step that reaches the end, `before_last` is called. Returns of the duration what is left: negative
        where the last step went beyond it. Raises what `step` does.
        """
        end = clock() + patience
        while duration > 0 and clock() < end:
            if duration <= self.dt:
                before_last()
            self.step()
            duration -= self.dt
        return duration
