"""What acts on a body in a moving frame, but for contact: forces that turn with it, gravity, forces in world axes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, vector
from fenics_rom.mechanics.frame_motion import ZERO, Vector, cross_matrix, rotated_back
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.frame_slopes import SPIN, PointsMoved, StepTurn
from fenics_rom.runtime.steppers.slopes import Slopes

if TYPE_CHECKING:
    from fenics_rom.mechanics.environment import Environment


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
        following: of inputs whose forces on the coordinates are found elsewhere, as they follow the body, the places;
            and the places of those whose force and torque as a whole are, too.

    Attributes:
        width: number of inputs.
        turning: places of those (t,) whose forces turn with the frame: contact, actuators, and friction at guides.
        push: (m + 6, t) theirs on the coordinates, as a whole, and torques, per unit of the input.
        by_shape: (3, m, t) what q adds to the torques; None where nothing.
        pulling: places of those (f,) that pull all mass alike: gravity, and a base that is shaken.
        fields: (f, 3) accelerations per unit of these, m/s².
        columns: places of the inputs that are prescribed forces.
        points: that these act on.
    """

    def __init__(
        self,
        rom: Rom,
        contact: str,
        model: ContactModel,
        frame: MovingFrame,
        environment: "Environment",
        following: tuple[Sequence[int], Sequence[int]] = ((), ()),
    ):
        p = model.inputs.shape[1]
        wrenches = frame.wrenches.get(contact, np.zeros((6, p)))
        torque_modes = frame.torque_modes.get(contact, np.zeros((p, 3, len(rom.stiffness))))
        column = p - sum(rom.loads.values())
        columns, turning, pulling, fields = list[int](), list(range(column)), list[int](), environment.uniform_fields
        for name, width in rom.loads.items():
            if name in rom.environment.uniform_fields:
                pulling.append(column)
            elif name in rom.environment.inner_loads:
                turning.append(column)
            else:
                columns += range(column, column + width)
            column += width
        self.turning, self.columns = np.array(turning, dtype=int), np.array(columns, dtype=int)
        self.pulling = np.array(pulling, dtype=int)
        acting = [fields.get(name, np.zeros(3)) for name in rom.loads if name in rom.environment.uniform_fields]
        self.fields = np.array(acting).reshape(-1, 3)  # of which a run may leave some out
        push = np.concatenate([model.inputs, wrenches])
        for rows, places in zip((slice(model.order), slice(model.order, None)), following, strict=True):
            push[rows, list(places)] = 0.0
        self.push = push[:, self.turning]
        by_shape = torque_modes[self.turning] @ model.coordinates
        self.by_shape = by_shape.transpose(1, 2, 0) if by_shape.any() else None
        # Torques X × e_x, X × e_y, X × e_z of unit forces at X.
        torques = wrenches[3:, self.columns].reshape(3, -1, 3)
        rest = np.stack([torques[2, :, 1], torques[0, :, 2], torques[1, :, 0]], axis=1)
        self.points = FramePoints(rest, model.inputs[:, self.columns])
        self._order, self.width = model.order, p
        self._last = b"", self._of(np.zeros(self.width))

    def at(self, u: Array) -> FrameForces:
        """Of inputs u (p,); those of the step before are known."""
        if u.shape != (self.width,):
            raise ValueError
        if u.tobytes() != self._last[0]:
            self._last = u.tobytes(), self._of(u)
        return self._last[1]

    def modal(self, forces: FrameForces, turn: Geometry, frame: MovingFrame) -> Array:
        """Forces (m,) on the coordinates, in a step that turns so."""
        modal = forces.modal
        if forces.acceleration != ZERO:
            modal = modal + np.array(turn.seen(forces.acceleration)).dot(frame.moment_modes)
        if forces.at_points is not None:
            modal = modal + self.points.rows.dot(forces.at_points.dot(turn.middle).ravel())
        return modal

    def columns_of(self, turn: Geometry, frame: MovingFrame) -> Array:
        """The same (m, p) of inputs of 1."""
        columns = np.zeros((self._order, self.width))
        columns[:, self.turning] = self.push[: self._order]
        for column, field in zip(self.pulling, self.fields, strict=True):
            columns[:, column] = np.array(turn.seen(vector(field))) @ frame.moment_modes
        if len(self.columns):
            rows = self.points.rows.reshape(self._order, -1, 3)
            columns[:, self.columns] = (rows @ turn.middle.T).reshape(self._order, -1)
        return columns

    def slopes(
        self, forces: FrameForces, step: StepTurn, frame: MovingFrame, ends: tuple[Array, Array]
    ) -> tuple[Slopes, Array]:
        """What force, R*ᵀ torque and modal forces (k,) in a step between two q (m,) change by, and with inputs.

        But for the torque of gravity, which the base bears.
        """
        (q, q_end), turn, m = ends, step.turn, self._order
        start, end, columns = np.zeros((6 + m, 6 + m)), np.zeros((6 + m, 6 + m)), np.zeros((6 + m, self.width))
        start[:3, SPIN], end[:3, SPIN] = (-R @ cross_matrix(forces.force) / 2 for R in (turn.start, turn.end))
        if forces.torque_by_shape is not None:
            start[SPIN, 6:] = end[SPIN, 6:] = forces.torque_by_shape / 2
        columns[:3, self.turning] = (turn.start + turn.end) / 2 @ self.push[m : m + 3]
        columns[SPIN, self.turning], columns[6:] = self.push[m + 3 :], self.columns_of(turn, frame)
        if self.by_shape is not None:
            columns[SPIN, self.turning] += np.einsum("kmt,m->kt", self.by_shape, (q + q_end) / 2)
        for column, field in zip(self.pulling, self.fields, strict=True):
            columns[:3, column] = frame.mass * field
        falling, c = cross_matrix(rotated_back(turn.before, forces.acceleration)), frame.moment_modes
        start[6:, SPIN] = c.T @ (falling - step.half @ falling)
        by_turn = np.vstack([np.zeros((6, 3)), c.T @ falling / 2])
        slopes = step.slopes(start, end, by_turn)
        if len(self.columns):
            at = self.points.rest + self.points.moved(q)
            points = PointsMoved(step, self.points.rows, at, self.points.moved((q_end - q) / step.h))
            columns[:, self.columns] = points.by_forces()
            if forces.at_points is not None:
                slopes = slopes.with_(points.push(forces.at_points).slopes)
        return slopes, columns

    def _of(self, u: Array) -> FrameForces:
        turning = u[self.turning]
        push = self.push.dot(turning)
        fx, fy, fz, tx, ty, tz = push[self._order :].tolist()
        by_shape = None if self.by_shape is None else self.by_shape.dot(turning)
        if by_shape is not None and not by_shape.any():
            by_shape = None
        a, points = ZERO, None
        if len(self.pulling):
            gx, gy, gz = u[self.pulling].dot(self.fields).tolist()
            a = gx, gy, gz
        if len(self.columns):
            points = u[self.columns].reshape(-1, 3)
        return FrameForces(push[: self._order], (fx, fy, fz), (tx, ty, tz), by_shape, a, points)
