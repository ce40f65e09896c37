"""The base that carries a body: how both move between two steps, and whether its poses fit its twists."""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_geometry import Geometry, vector
from fenics_rom.mechanics.frame_motion import Quaternion, Rotation, Vector, added, cross, rotated, turned
from fenics_rom.runtime.steppers.frame_kernel import FrameState, Shape
from fenics_rom.runtime.steppers.inertia import times_inertia

MISFIT = 0.1  # of what the base moves by in a step: so far off may be what its twists say
NEGLIGIBLE = 1e-6  # rad, and of the size of the body: what is no motion


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


def misfit(start: FrameState, end: FrameState, turn: Geometry, v̂: Vector, h: float, size: float) -> tuple[float, float]:
    """How far a base went, m, and turned, rad, in a step of h s otherwise than its twists say; 0 where that is little.

    Args:
        start, end: of the step.
        turn: how the frame turns by its twists.
        v̂: mean velocity, in the frame's axes, m/s.
        h: s.
        size: of the body, m.
    """
    moved, said = added(end.position, -1.0, start.position), rotated(turn.before, added(v̂, 0.5, cross(turn.turn, v̂)))
    away = math.hypot(*added(moved, -h, said))
    if away <= NEGLIGIBLE * size or away <= MISFIT * max(math.hypot(*moved), h * math.hypot(*said)):
        away = 0.0
    turned_by, most = 2 * _apart(turned(start.rotation, turn.turn), end.rotation), math.hypot(*turn.turn)
    if turned_by <= NEGLIGIBLE or turned_by <= MISFIT * max(2 * _apart(start.rotation, end.rotation), most):
        turned_by = 0.0
    return away, turned_by


def frame_state(base: BaseState) -> FrameState:
    """A base as numbers, its rotation a unit quaternion to round-off."""
    w, x, y, z = base.rotation.tolist()
    size = (w * w + x * x + y * y + z * z) ** 0.5
    rotation = w / size, x / size, y / size, z / size
    return FrameState(vector(base.position), rotation, vector(base.velocity), vector(base.angular_velocity))


def _apart(a: Quaternion, b: Quaternion) -> float:
    """Sine of half of the angle, rad, between two rotations."""
    (s, t, u, v), (w, x, y, z) = a, b
    return math.dist(a, b if s * w + t * x + u * y + v * z > 0 else (-w, -x, -y, -z))
