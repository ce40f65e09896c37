"""A free soft body in a step of several: its step is begun once, and found under each of the forces that are tried."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import cross_matrix
from fenics_rom.runtime.steppers.free_frame import FreeFrame
from fenics_rom.runtime.steppers.pushed_step import PushedPoints, PushedStep, are_relative
from fenics_rom.world.bodies import Points
from fenics_rom.world.soft import Soft


class FreeSoft(Soft):
    """Arguments and attributes as in Soft."""

    takes_couples = True
    _kept: tuple[FreeFrame, float, Points, PushedPoints] | None = None  # the last points, kept for the next

    @property
    def _free_frame(self) -> FreeFrame:
        kernel = self._stepper.kernel
        assert isinstance(kernel, FreeFrame)
        return kernel

    def _open(self) -> None:
        """As in Soft."""
        self._begun = PushedStep(self._free_frame, self._inputs.u)
        self._asked_at: Points | None = None

    def start_velocities(self, points: Points, places: Array) -> Array:
        """As in Body."""
        velocities = super().start_velocities(points, places)
        within = are_relative(points.weights)
        asked = points.follows | within
        if asked.any():
            own = self._carriers.mean(points, self._start) + self._h / 2 * velocities
            off = np.where(within[:, None], 0.0, places) - own
            spin = cross_matrix(self._free_frame.world_angular_velocity)
            velocities[asked] += off[asked].dot(spin.T)
        return velocities

    def attempt(self, points: Points, places: Array, forces: Array) -> Array:
        """As in Body."""
        if self._asked_at is not points and len(forces):
            self._asked_at = points
            self._begun.begin_at(self._pushed(points))
        self._forces = forces
        return self._begun.velocities(forces, places)

    def _pushed(self, points: Points) -> PushedPoints:
        """Those of a step; kept as long as they are the same, but for surfaces that turn as a whole."""
        known = None if len(points.couples) else self._kept
        if known is None or known[0] is not self._free_frame or known[1] != self._h or known[2] is not points:
            pushed = PushedPoints.of(self._free_frame, *points[:2], points.follows, points.couples)
            self._kept = known = self._free_frame, self._h, points, pushed
        return known[3]

    def delassus(self, points: Points, places: Array) -> Array:
        """As in Body; after an attempt."""
        return self._begun.operator()

    def close(self) -> None:
        """As in Soft."""
        asked, contact = self._asked_at, None
        if asked is not None:
            contact = self._hand(asked, self._forces)
            if len(asked.couples):
                contact = contact._replace(forces=self._begun.on_nodes(len(contact.forces)))
        self._tried = True
        self._twice = self._begun.close(contact)
        if not math.isfinite(self._twice):
            self._leave_finite(self._inputs.u)

    def undo(self) -> None:
        """As in Body."""
        super().undo()
        self._free_frame.forget()
