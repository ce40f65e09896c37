"""The base that carries a body: how both move between two steps."""

from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_geometry import vector
from fenics_rom.mechanics.frame_motion import Rotation, Vector, added, cross
from fenics_rom.runtime.steppers.frame_kernel import FrameState, Shape
from fenics_rom.runtime.steppers.inertia import times_inertia


class Motion(NamedTuple):
    """The body between two steps."""

    q: Array
    shape: Shape
    R: Rotation
    v: Vector  # of the base, in the frame's axes
    ω: Vector

    P: Vector  # and its momenta, linear and about the frame's origin
    L: Vector


def motion_of(q: Array, shape: Shape, R: Rotation, v: Vector, ω: Vector, mass: float) -> Motion:
    """The same with its momenta."""
    P = added(added(cross(ω, shape.moment), mass, v), 1.0, shape.drift)
    L = added(added(times_inertia(shape.inertia, ω), 1.0, shape.moved), 1.0, cross(shape.moment, v))
    return Motion(q, shape, R, v, ω, P, L)


def frame_state(base: BaseState) -> FrameState:
    """A base as numbers, its rotation a unit quaternion to round-off."""
    w, x, y, z = base.rotation.tolist()
    size = (w * w + x * x + y * y + z * z) ** 0.5
    rotation = w / size, x / size, y / size, z / size
    return FrameState(vector(base.position), rotation, vector(base.velocity), vector(base.angular_velocity))
