"""The base that carries a body: how both move between two steps."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_geometry import Geometry, vector
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.steppers.frame_loads import FrameForces
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape
from fenics_rom.runtime.steppers.ground_ties import TieForces
from fenics_rom.runtime.steppers.inertia import momenta_of


class Motion(NamedTuple):
    """The body between two steps."""

    q: Array
    shape: Shape
    R: Rotation
    v: Vector  # of the base, in the frame's axes
    ω: Vector

    P: Vector  # and its momenta, linear and about the frame's origin
    L: Vector


class Begun(NamedTuple):
    """What does not change within a step."""

    A: Array  # (m,) where it is diagonal, else (m, m)
    right: Array  # (m,)
    turn: Geometry
    end: FrameState  # of the base
    v̂: Vector
    ω̂: Vector
    v_end: Vector  # in the frame's axes
    ω_end: Vector
    forces: FrameForces
    modal: Array  # (m,) of them
    tied: TieForces | None  # of ties to the ground without r̂

    @property
    def origin(self) -> Array:
        """R* v̂ (3,), of the frame's origin."""
        origin: Array = self.turn.middle.dot(self.v̂)
        return origin


def motion_of(q: Array, shape: Shape, R: Rotation, v: Vector, ω: Vector, mass: float) -> Motion:
    """The same with its momenta."""
    return Motion(q, shape, R, v, ω, *momenta_of(*shape, v, ω, mass))


def frame_state(base: BaseState) -> FrameState:
    """A base as numbers, its rotation a unit quaternion to round-off."""
    w, x, y, z = base.rotation.tolist()
    size = (w * w + x * x + y * y + z * z) ** 0.5
    rotation = w / size, x / size, y / size, z / size
    return FrameState(vector(base.position), rotation, vector(base.velocity), vector(base.angular_velocity))
