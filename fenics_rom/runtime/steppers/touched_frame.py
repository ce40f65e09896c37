"""A body in a moving frame as contact sees it: where its points go, and what forces on them do; see frame_contact."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_geometry import Geometry, Push, arms_of, carried_along, turned_operator, turning_maps
from fenics_rom.mechanics.frame_motion import Quaternion, Vector, cross_matrix
from fenics_rom.runtime.steppers.frame_kernel import FrameKernel
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.frame_state import in_frame


class TouchedFrame(FrameKernel):
    """Arguments and attributes as in FrameKernel."""

    _yields: tuple[object, Array] = None, np.empty((0, 0))  # what points that are near yield, by which, and how turned

    def yielding(self, turn: Geometry, contact: ContactSolution | None) -> Array | None:
        """Mid-step velocity (P, 3) in the frame of the points in the residual part; None where there is none."""
        if self.residual is None or (contact is None and self.residual.is_at_rest):
            return None
        return self.residual.velocity(in_frame(turn, contact))

    def arms(self, turn: Geometry, rate: Array, yielding: Array | None) -> Array:
        """Of the contact points from the origin in the middle of a step, (P, 3), m."""
        start, moved = self.places(), self.points.moved(rate)
        return arms_of(turn, start, start + self.h * (moved if yielding is None else moved + yielding))

    def turn_at(self, x: Array) -> tuple[Geometry, Quaternion]:
        """How the frame turns at the velocities x that a step solves for, and the quaternion at the end."""
        raise NotImplementedError

    def geometry(self, x: Array) -> Geometry:
        """The first of these."""
        return self.turn_at(x)[0]

    def renew(self, x: Array) -> None:
        """As in FrameBody of mechanics.frame_contact; nothing where slopes are exact."""

    def velocities(self, turn: Geometry, arms: Array, x: Array, yielding: Array | None) -> Array:
        """Mid-step velocities (P, 3) of the contact points in world axes, less that of the origin, m/s."""
        ω̂, r̂ = self.rates(x)
        inside = self.points.moved(r̂) if yielding is None else self.points.moved(r̂) + yielding
        return carried_along(turn, arms, ω̂, inside)

    def push(self, forces: Array, turn: Geometry, arms: Array) -> Push:
        """What forces (P, 3) on the contact points do, N in world axes."""
        return self.points.push(forces, turn, arms)

    @property
    def tells_apart(self) -> bool:
        """Whether W is regular: of a basis alone it is singular where more points touch than it has coordinates."""
        return self.residual is not None

    def delassus(self, near: Array, turn: Geometry, arms: Array) -> Array:
        """Mid-step velocities (3 s, 3 s) of those contact points (s,), at arms (s, 3), per force, m/s/N."""
        maps = self._maps(self.points.of(near), turn, arms)
        W: Array = maps.dot(self._inverse_slopes).dot(maps.T)
        if self.residual is None:
            return W
        key = near.tobytes(), turn.before, self.residual.times
        if self._yields[0] != key:  # as in sweeps before
            self._yields = key, turned_operator(turn.start, self.residual.delassus_of(near), turn.start)
        return W + self._yields[1]

    def moved(self, near: Array, turn: Geometry, arms: Array, change: Array) -> Array:
        """As in ActuatedBody of mechanics.frame_contact."""
        return self._maps(self.points.of(near), turn, arms)[:, self._eliminated :].dot(change)

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""
        inverse, pushed = self._inverse_slopes, np.concatenate([change.force, change.turning, change.modal])
        spread: Array = inverse[self._eliminated :].dot(pushed[-len(inverse) :])
        return spread

    def _spread_columns(self, columns: Array) -> Array:
        """As in PartedKernel."""
        spread: Array = self._inverse_slopes[self._eliminated :, -len(columns) :].dot(columns)
        return spread

    @property
    def _inverse_slopes(self) -> Array:
        """Of what force, torque and coordinates balance, with v̂, ω̂ and r̂; of carried bodies with r̂ alone."""
        raise NotImplementedError

    def _maps(self, points: FramePoints, turn: Geometry, arms: Array) -> Array:
        """Velocities (3 s, any) of points at arms (s, 3) by these."""
        modal = points.modal_maps(turn)
        if self._constants.carried:
            return modal
        return np.hstack([np.tile(np.eye(3), (len(arms), 1)), turning_maps(turn, arms), modal])

    @property
    def touched(self) -> Array:
        """As in BookedKernel, in world axes."""
        return self._touched

    def start_velocities(self) -> Array:
        """Velocities (P, 3) of the contact points in world axes, m/s."""
        if self.residual is None:
            return self.basis_velocities
        beyond: Array = self.residual.points[1].dot(self._rotation.T)
        return self.basis_velocities + beyond

    @property
    def basis_velocities(self) -> Array:
        """The same (P, 3) within the basis: what the points yield beyond it has next to no mass."""
        inside = self.points.moved(self._r) + self.places().dot(cross_matrix(self.angular_velocity).T)
        velocities: Array = inside.dot(self._rotation.T) + self.frame.velocity
        return velocities

    def inverse_mass(self, some: Array) -> Array:
        """Velocities (3 s, 3 s), 1/kg, that impulses on contact points give the shape in a frame that is moved."""
        rows = self.points.of(some).rows
        return turned_operator(self._rotation, rows.T.dot(rows), self._rotation)

    def kick(self, impulses: Array) -> None:
        """Adds these (P, 3), N s, between two steps, without booking them."""
        self._r += self.points.rows.dot(impulses.dot(self._rotation).ravel())
        self.move_on()

    def kept_velocities(self, turn: Geometry, arms: Array) -> Array:
        """What `velocities` and that of the origin are with the body's velocities at the start of the step, (P, 3)."""
        inside = self.points.moved(self._r)
        if self.residual is not None:
            inside += self.residual.points[1]
        velocities: Array = carried_along(turn, arms, np.array(self.angular_velocity), inside)
        return velocities + self.kept_translation(turn)

    def kept_translation(self, turn: Geometry) -> Vector:
        """The same of the origin, (3,)."""
        return self.frame.velocity
