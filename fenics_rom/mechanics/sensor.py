"""What a real sensor of touch adds to what it feels: noise, steps in which it counts, a rate, and a delay.

It looks at the times k / rate, and shows a look only once a delay has passed; each number is rounded after noise of its
own was added. The noise of look k is that of a generator that is seeded by the seed, the number of the body in a batch,
and k: so the same run has the same noise, whatever was read of it, and also from a saved state on.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray as Array

SAME_TIME = 1e-9  # of a time: so much earlier it is the same


@dataclass(frozen=True)
class Sensor:
    """A real sensor; 0 is nothing of a kind. Noises are standard deviations of normal distributions."""

    rate: float = 0.0  # Hz; 0: it looks after every step
    delay: float = 0.0  # s
    pressure_noise: float = 0.0  # Pa, of taxels
    force_noise: float = 0.0  # N
    torque_noise: float = 0.0  # N m
    pressure_step: float = 0.0  # Pa, in which taxels count
    force_step: float = 0.0  # N
    torque_step: float = 0.0  # N m
    seed: int = 0

    @property
    def remembers(self) -> bool:
        """Whether it shows what was felt earlier."""
        return bool(self.rate or self.delay)

    @property
    def is_exact(self) -> bool:
        """Whether it shows what is felt as it is."""
        return not (self.remembers or self._changes)

    @property
    def _changes(self) -> bool:
        return any((*self._noises, *self._steps))

    @property
    def _noises(self) -> tuple[float, float, float]:
        return self.force_noise, self.torque_noise, self.pressure_noise

    @property
    def _steps(self) -> tuple[float, float, float]:
        return self.force_step, self.torque_step, self.pressure_step

    def look(self, values: Array, areas: Array, number: int, body: int) -> Array:
        """What it sees in a look of that number, of values (V,) with taxels of areas (K,), m², as their last."""
        if not self._changes:
            return values
        seen, K = values.copy(), len(areas)
        random = np.random.default_rng([self.seed, body, number])
        taxels = slice(len(seen) - K, len(seen))
        for part, noise, step in zip((slice(0, 3), slice(3, 6), taxels), self._noises, self._steps, strict=True):
            drawn = random.standard_normal(len(seen[part]))
            seen[part] += noise * drawn
            if step:
                seen[part] = step * np.round(seen[part] / step)
        seen[taxels][areas == 0] = 0.0
        if self.pressure_noise or self.pressure_step:
            seen[9] = areas @ seen[taxels]
        return seen


Look = tuple[float, Array]  # when, s, and what was seen


class SensorMemory:
    """The looks of a sensor that remembers, from the earliest on that may still be shown.

    Args:
        sensor: whose.
    """

    def __init__(self, sensor: Sensor):
        self._sensor = sensor
        self.looks: tuple[Look, ...] = ()

    def number_at(self, time: float, steps: int) -> int:
        """Of the last look until a time, s, to which so many steps led."""
        rate = self._sensor.rate
        return int(np.floor(time * rate + SAME_TIME * max(1.0, time * rate))) if rate else steps

    def add(self, time: float, values: Array) -> None:
        """Adds a look; those of steps that were taken back are forgotten."""
        looks = (*(look for look in self.looks if look[0] < (1 - SAME_TIME) * time), (time, values))
        self.looks = looks[max(self._shown(looks, time), 0) :]

    def shown(self, time: float) -> Array | None:
        """What it shows at a time, s; None where nothing was seen so early."""
        row = self._shown(self.looks, time)
        return self.looks[row][1] if row >= 0 else None

    def _shown(self, looks: tuple[Look, ...], time: float) -> int:
        """Which of the looks; -1: none."""
        until = time - self._sensor.delay + SAME_TIME * time
        return sum(when <= until for when, _ in looks) - 1


class SensedTouch:
    """What the sensors of a body show.

    Args:
        readings: of the body, by name; those that have no sensor are left out.
        feel: what one of them feels now, (V,).

    Attributes:
        feels: whether there is a sense of touch.
        body: number of the body in a batch, which has noise of its own.
    """

    def __init__(self, readings: Mapping[str, Any], feel: Callable[[str], Array]):
        self._feel, self.body = feel, 0
        self.feels = any(isinstance(getattr(reading, "sensor", None), Sensor) for reading in readings.values())
        self._readings = {
            name: reading
            for name, reading in readings.items()
            if isinstance(getattr(reading, "sensor", None), Sensor) and not reading.sensor.is_exact
        }
        self._memories = {
            name: SensorMemory(reading.sensor) for name, reading in self._readings.items() if reading.sensor.remembers
        }

    @property
    def remembers(self) -> bool:
        """Whether it has to be told of every step."""
        return bool(self._memories)

    @property
    def state(self) -> tuple[tuple[Look, ...], ...]:
        """What is remembered; nothing of a body at its start."""
        return tuple(memory.looks for memory in self._memories.values())

    @state.setter
    def state(self, state: tuple[tuple[Look, ...], ...]) -> None:
        for memory, looks in zip(self._memories.values(), state or ((),) * len(self._memories), strict=True):
            memory.looks = looks

    def note(self, time: float, dt: float, steps: int) -> None:
        """Takes note of the last step of dt, the last of so many, which led to a time, s."""
        for name, memory in self._memories.items():
            if (number := memory.number_at(time, steps)) > memory.number_at(time - dt, steps - 1):
                memory.add(time, self._seen(name, number))

    def shown(self, name: str, time: float, steps: int) -> Array:
        """What a reading shows at a time, s, to which so many steps led, (V,)."""
        if name not in self._readings:
            return self._feel(name)
        if name not in self._memories:
            return self._seen(name, steps)
        seen = self._memories[name].shown(time)
        untouched: Array = self._readings[name].untouched
        return untouched if seen is None else seen

    def _seen(self, name: str, number: int) -> Array:
        reading = self._readings[name]
        return reading.sensor.look(self._feel(name), reading.map.areas, number, self.body)
