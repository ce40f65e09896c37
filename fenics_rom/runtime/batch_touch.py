"""What bodies of a batch feel that compiled loops step: what friction did, and what sensors add.

Loops keep the forces of pairs alone. What friction did is found when someone reads it, from where a body was before the
step and is after it: normals are those at its start, velocities of contact points the mean of both.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit
from fenics_rom.mechanics.compiled import shapes as obstacle_shapes
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.rubbing import PairPlaces, Rubbing, rubbing_at
from fenics_rom.mechanics.sensor import SensedTouch
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.compiled.linear_step import PARTS, State

measure = jit(obstacle_shapes.measure)


class BatchTouch:
    """Senses of touch of many bodies.

    Args:
        rom: whose readings they are.
        size: number of bodies.
        obstacles: O.
        feel: what a reading of a body is without a sensor.

    Attributes:
        start, end: of the obstacles in each body's last step, (size, O, 3), m.
        mode: number of the contact mode in it, (size,).
        dt: of it, (size,), s.
    """

    def __init__(self, rom: Rom, size: int, obstacles: int, feel: Callable[[int, str], Array]):
        self._sensed = [SensedTouch(rom.readings, partial(feel, body)) for body in range(size)]
        for body, sensed in enumerate(self._sensed):
            sensed.body = body
        self._steps = np.zeros(size, int)  # since a body's start, which number what sensors see
        self.start, self.end = np.zeros((2, size, obstacles, 3))
        self.mode, self.dt = np.zeros(size, int), np.ones(size)

    def take(self, taken: Array, obstacles: Moving, mode: Array, dt: float) -> None:
        """Some of the bodies (size,) have taken a step of dt, s, in contact modes (size,)."""
        self._steps[taken] += 1
        self.start[taken], self.end[taken] = obstacles.start[taken], obstacles.end[taken]
        self.mode[taken], self.dt[taken] = mode[taken], dt

    def look(self, taken: Array, times: Array) -> None:
        """Has sensors that remember look at the ends of these steps, at times (size,), s."""
        if not self._sensed[0].remembers:
            return
        for body in taken.nonzero()[0].tolist():
            self._sensed[body].note(float(times[body]), float(self.dt[body]), int(self._steps[body]))

    def begin(self, bodies: Array) -> None:
        """Bodies (n,) begin anew."""
        self._steps[bodies] = 0
        for body in bodies.tolist():
            self._sensed[body].state = ()

    def shown(self, name: str, times: Array) -> Array:
        """A reading of all bodies at their times (size,), s."""
        instants = zip(times.tolist(), self._steps.tolist(), strict=True)
        return np.array([sensed.shown(name, *now) for sensed, now in zip(self._sensed, instants, strict=True)])

    def rubbing(
        self, body: int, touched: Any, inverse_ω: Array, states: State, shapes: Array, forces: Array, μ: float
    ) -> Rubbing:
        """What friction did in the last step of a body.

        Args:
            body: which.
            touched: where it can be touched (`touching.Touched`), in the contact mode of that step.
            inverse_ω: (m,), s.
            states: of the body, after that step and before it.
            shapes: of the obstacles, (O, 17).
            forces: of the pairs in that step, (O P, 3), N.
            μ: of friction.
        """
        rates, before = states.halves[1], State(*states[PARTS:], *states[PARTS:])
        q = before.halves[0] * inverse_ω
        q[: len(before.rigid)] = before.rigid
        moved, velocities = (row @ touched.points for row in (q, (rates + before.halves[1]) / 2))
        if len(touched.R):
            moved += before.beyond[1]
            velocities += (states.beyond[3] + before.beyond[3]) / 2
        normals = np.empty(forces.shape)
        measure(shapes, self.start[body], touched.places + moved.reshape(-1, 3), np.empty(len(forces)), normals)
        pushed = forces.any(axis=1).nonzero()[0]
        obstacle, point = np.divmod(pushed, len(touched.places))
        slipping = velocities.reshape(-1, 3)[point] - ((self.end[body] - self.start[body]) / self.dt[body])[obstacle]
        where = PairPlaces(point[:, None], np.ones((len(point), 1)), 1.0)
        return rubbing_at(len(touched.places), [where], normals[pushed], forces[pushed], slipping, μ)
