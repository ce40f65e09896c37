"""A free body between two steps: how it moves, and what that stores."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry
from fenics_rom.mechanics.frame_motion import (
    Quaternion,
    Rotation,
    Vector,
    added,
    dot,
    rotated,
    rotated_back,
    rotation_of,
    turned,
)
from fenics_rom.runtime.steppers.differentiable_frame import DifferentiableFrame
from fenics_rom.runtime.steppers.frame_kernel import COUPLED
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape
from fenics_rom.runtime.steppers.inertia import check_definite, solved_inertia, times_inertia


class Motion(NamedTuple):
    """The body between two steps."""

    q: Array
    shape: Shape
    ω: Vector  # in the frame's axes, rad/s
    R: Rotation
    L: Vector  # angular momentum in the frame's axes
    spin: float  # ω·I ω + 2 ω·b r, J


class FreeMotion(DifferentiableFrame):
    """Arguments and attributes as in FrameKernel; `frame.turning` is the angular momentum."""

    _now: Motion
    _surely_definite: float  # up to which |e|² kinetic energy is positive definite

    @property
    def mass(self) -> float:
        """Of the body, kg."""
        return self._mass

    @property
    def energy(self) -> float:
        """Stored, J."""
        v = self.frame.velocity
        return self._with_carried_energy((self._mass * dot(v, v) + self._now.spin + self._square) / 2)

    @property
    def angular_velocity(self) -> Vector:
        """As in FrameKernel."""
        return self._now.ω

    @property
    def momenta(self) -> tuple[Vector, Vector]:
        """Linear and, about the centre of mass, angular, in world axes."""
        x, y, z = self.frame.velocity
        return (self._mass * x, self._mass * y, self._mass * z), self.frame.turning

    @property
    def world_angular_velocity(self) -> Array:
        """In world axes, (3,), rad/s."""
        return np.array(rotated(self._now.R, self._now.ω))

    def place(self, frame: FrameState) -> None:
        """Puts the frame where it is to be; `turning` is here the angular velocity in world axes, rad/s."""
        R, shape = rotation_of(*frame.rotation), self.forget()
        L = added(times_inertia(shape.inertia, rotated_back(R, frame.turning)), 1.0, shape.moved)
        self.frame = frame._replace(turning=rotated(R, L))
        self.resume(self.auxiliary)

    def forget(self) -> Shape:
        """Forgets what was kept of steps that led elsewhere; the shape that the body has."""
        raise NotImplementedError

    def _moving(self, q: Array, shape: Shape, R: Rotation, momentum: Vector, e: Array) -> Motion:
        """The body at q, e = √γ q, with an angular momentum in world axes."""
        if not e.dot(e) <= self._surely_definite:
            check_definite(shape.inertia, self._table[COUPLED])
        L = rotated_back(R, momentum)
        ω = solved_inertia(shape.inertia, added(L, -1.0, shape.moved))
        return Motion(q, shape, ω, R, L, dot(ω, added(L, 1.0, shape.moved)))


def turn_of(R: Rotation, rotation: Quaternion, t: Vector) -> tuple[Geometry, Quaternion]:
    """How a frame turns by Cayley's map of t = h ω̂, and the quaternion at the end."""
    end = turned(rotation, t)
    return Geometry(R, rotation_of(*end), t), end
