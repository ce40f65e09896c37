"""Where a frame is, and the inertia of the body in it."""

from typing import NamedTuple

from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_geometry import Geometry
from fenics_rom.mechanics.frame_motion import Quaternion, Vector
from fenics_rom.runtime.steppers.inertia import Inertia


class FrameState(NamedTuple):
    """Where a frame is and how it moves, in world axes."""

    position: Vector  # of its origin, m
    rotation: Quaternion  # from its axes to the world's, a unit quaternion w x y z
    velocity: Vector  # of its origin, m/s
    turning: Vector  # of a free body its angular momentum, kg m²/s; of a base its angular velocity, rad/s


class Shape(NamedTuple):
    """The inertia of the body at q, moving with r."""

    inertia: Inertia  # I(q)
    moved: Vector  # b r
    moment: Vector  # x̄ + c q
    drift: Vector  # c r


def in_frame(turn: Geometry, contact: ContactSolution | None) -> ContactSolution | None:
    """The same with forces as the frame sees them."""
    return None if contact is None else contact._replace(forces=contact.forces.dot(turn.middle))
