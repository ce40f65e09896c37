"""Where obstacles will be in the steps of a rollout, for loops that take these in a row."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.obstacle_poses import mean_velocities

Simulator = Any  # fenics_rom.runtime.simulator's, which imports this file through rollout
LONGEST_PATH = 256  # steps that are looked ahead at once


class ObstaclePath:
    """Of the obstacles of a body in steps of one size; signals stay what they are. What was looked at is kept."""

    def __init__(self, body: Simulator) -> None:
        self._body, self._is_lost = body, False
        self._first, self._rows, self._speeds = 0, np.empty((0, 0, 3)), np.empty((0, 0, 3))  # from this step on

    def ahead(self, u: Array) -> tuple[ObstacleMotion, int] | None:
        """In the next steps, for `ObstacleMotion.in_step`; how many, at most as many as there are inputs u.

        None: the contact mode follows them, one turns too far in a step, or looks at the skin begin after the next one.
        """
        body, environment = self._body, self._body.environment
        if environment is None or body.switches_itself or self._is_lost or body.begins_to_look:
            return None
        if environment.stands_still:
            motion = environment.step_input(u[0][: body.inputs], body.time, body.dt).obstacles
            return ObstacleMotion(*(part[None] for part in motion)), len(u)
        if not 0 <= body.steps - self._first < len(self._speeds):
            self._look(min(len(u), LONGEST_PATH))
        first = body.steps - self._first
        rows, speeds = self._rows[first : first + len(u) + 1], self._speeds[first : first + len(u)]
        if self._is_lost:
            return None
        before = np.concatenate([environment.state.velocities[None], speeds[:-1]])
        return ObstacleMotion(rows[:-1], rows[1:], before), len(speeds)

    def _look(self, count: int) -> None:
        """Finds where they will be in some steps."""
        body, environment = self._body, self._body.environment
        times = body.times_ahead(count)[1:]
        self._first, self._rows = body.steps, np.array([environment.state.offsets, *map(environment.offsets_at, times)])
        try:
            self._speeds = mean_velocities(self._rows[:-1], self._rows[1:], body.dt)
        except StepError:  # which the step tells, too
            self._is_lost = True

    def go_on(self, count: int) -> None:
        """Has the obstacles be where so many steps have led, which the body is to count afterwards."""
        body, environment = self._body, self._body.environment
        if not environment.stands_still:
            last = body.steps - self._first + count
            environment.go_along(body.times_ahead(count), self._rows[last], self._speeds[last - 1], body.dt)
