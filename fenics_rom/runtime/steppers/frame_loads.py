"""What acts on a body in a moving frame, but for contact: forces that turn with it, gravity, forces in world axes."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import ZERO, Vector
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.frame_points import FramePoints

if TYPE_CHECKING:
    from fenics_rom.mechanics.environment import Environment

GRAVITY = "gravity"


class FrameForces(NamedTuple):
    """Of one step."""

    modal: Array  # (m,) on the coordinates, N kg^-1/2, of forces that turn with the frame
    force: Vector  # theirs as a whole, N
    torque: Vector  # about the frame's origin, N m, with the shape at rest
    torque_by_shape: Array | None  # (3, m), what q adds to it; None where nothing
    acceleration: Vector  # of gravity, in world axes, m/s²
    at_points: Array | None  # (n, 3) in world axes on the points of the loads, N; None where there are none


class FrameLoads:
    """The loads on one contact mode.

    Args:
        rom: of displacements that strain.
        contact: the contact mode.
        model: its model.
        frame: of the whole body.
        environment: what acts.

    Attributes:
        points: that prescribed forces act on.
    """

    def __init__(self, rom: Rom, contact: str, model: ContactModel, frame: MovingFrame, environment: "Environment"):
        p = model.inputs.shape[1]
        wrenches = frame.wrenches.get(contact, np.zeros((6, p)))
        torque_modes = frame.torque_modes.get(contact, np.zeros((p, 3, len(rom.stiffness))))
        self._turning = p - sum(rom.loads.values())
        self._push = np.concatenate([model.inputs, wrenches])[:, : self._turning]
        by_shape = torque_modes[: self._turning] @ model.coordinates
        self._by_shape = by_shape.transpose(1, 2, 0) if by_shape.any() else None
        self._gravity, self._acceleration, columns, column = -1, np.zeros(3), list[int](), self._turning
        for name, width in rom.loads.items():
            if name == GRAVITY:
                self._gravity = column
                acting = environment.details("effects.gravity")  # which a run may leave out
                self._acceleration = np.array(acting.get("acceleration", ZERO), dtype=float)
            else:
                columns += range(column, column + width)
            column += width
        self._columns = np.array(columns, dtype=int)
        # Torques X × e_x, X × e_y, X × e_z of unit forces at X.
        torques = wrenches[3:, self._columns].reshape(3, -1, 3)
        rest = np.stack([torques[2, :, 1], torques[0, :, 2], torques[1, :, 0]], axis=1)
        self.points = FramePoints(rest, model.inputs[:, self._columns])
        self._order, self._width = model.order, (self._turning + len(self._columns) + (self._gravity >= 0),)
        self._last = b"", self._of(np.zeros(self._width))

    def at(self, u: Array) -> FrameForces:
        """Of inputs u (p,); those of the step before are known."""
        if u.shape != self._width:
            raise ValueError
        if u.tobytes() != self._last[0]:
            self._last = u.tobytes(), self._of(u)
        return self._last[1]

    def _of(self, u: Array) -> FrameForces:
        push = self._push.dot(u[: self._turning])
        fx, fy, fz, tx, ty, tz = push[self._order :].tolist()
        by_shape = None if self._by_shape is None else self._by_shape.dot(u[: self._turning])
        if by_shape is not None and not by_shape.any():
            by_shape = None
        a, points = ZERO, None
        if self._gravity >= 0:
            gx, gy, gz = (float(u[self._gravity]) * self._acceleration).tolist()
            a = gx, gy, gz
        if len(self._columns):
            points = u[self._columns].reshape(-1, 3)
        return FrameForces(push[: self._order], (fx, fy, fz), (tx, ty, tz), by_shape, a, points)
