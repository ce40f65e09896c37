"""What is read of a robot."""

from dataclasses import dataclass
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.world.joints import AnyJoint
from fenics_rom.world.records import RigidBody


class Frame(NamedTuple):
    """Where a link of the file is, as the robot begins."""

    body: str  # the rigid body that it is part of; "world" of one that stands still
    position: Array  # (3,), m
    rotation: Array  # (4,), a unit quaternion w x y z


class Visual(NamedTuple):
    """A mesh that pictures of a body may show, in its axes from its centre of mass."""

    vertices: Array  # (V, 3), m
    triangles: Array  # (T, 3)
    colour: Array  # (4,) red, green, blue and opacity, 0 to 1


@dataclass(frozen=True)
class Robot:
    """What a World is given of a robot.

    Attributes:
        bodies: by name, "NAME.LINK".
        joints: named "NAME.JOINT", those that have a motor or anything else with a Drive.
        apart: its bodies, which do not touch one another.
        frames: of all links by their name, with those that have no body of their own.
        visuals: of bodies.
        warnings: what of the file is not taken over, or not as it stands there.

    Example:
        >>> fr.read_robot("arm.urdf").frames["tool"].body
        'arm.hand'
    """

    bodies: dict[str, RigidBody]
    joints: list[AnyJoint]
    apart: tuple[tuple[str, ...], ...]
    frames: dict[str, Frame]
    visuals: dict[str, list[Visual]]
    warnings: tuple[str, ...]
