"""Joints: points of two bodies that stay together; one is a ball joint, two a hinge, three a weld.

Each point has u = 0 in the middle of every step. As a point goes by h ŝ exactly, it stays where the other one is, to
round-off: nothing needs to be pulled back. After a step an impulse takes what relative velocity is left at its end,
which would change sign in every step: it keeps momenta and can only take energy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, check_known
from fenics_rom.world.bodies import Body

LARGEST_GAP = 1e-6  # of the distance of the bodies' centres: what a joint may be apart where it begins


@dataclass(frozen=True)
class Joint:
    """Points of two bodies that stay together.

    Args:
        first, second: names of the bodies.
        points: (k, 3) in world axes, where the bodies begin, m.
    """

    first: str
    second: str
    points: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise SceneError(
                f"joint of {self.first!r} and {self.second!r}: allowed are points of three finite numbers, m"
            )
        if self.first == self.second:
            raise SceneError(f"joint: allowed are two bodies, given: {self.first!r} with itself")


def ball(first: str, second: str, point: Sequence[float]) -> Joint:
    """A ball joint at a point, m."""
    return Joint(first, second, (_vector(point),))


def hinge(first: str, second: str, point: Sequence[float], axis: Sequence[float]) -> Joint:
    """A hinge about an axis through a point, m; how long the axis is says how far apart two points of it are held."""
    along, at = _direction(axis) / 2, np.array(_vector(point))
    return Joint(first, second, (_vector(at - along), _vector(at + along)))


def weld(first: str, second: str, point: Sequence[float], size: float = 0.1) -> Joint:
    """A weld about a point, m, at three points that are `size` m apart."""
    corners = np.eye(3) * size / 2**0.5
    return Joint(
        first, second, tuple(_vector(np.array(_vector(point)) + corner - corners.mean(axis=0)) for corner in corners)
    )


def _vector(numbers: Sequence[float] | Array) -> tuple[float, float, float]:
    vector = np.array(numbers, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise SceneError(f"joint: allowed are three finite numbers, given: {numbers!r}")
    x, y, z = vector.tolist()
    return x, y, z


def _direction(axis: Sequence[float]) -> Array:
    vector = np.array(_vector(axis))
    if not vector.any():
        raise SceneError("hinge: axis: allowed is a vector of any length but 0, given: length 0")
    return vector


class JointPoints:
    """A joint of bodies as they begin.

    Args:
        joint: as given.
        bodies: by name.

    Attributes:
        first, second: numbers of the bodies.
        points: (k, 3) where they begin, m.
        on_first, on_second: the same on either.

    Raises:
        SceneError: nobody has these names, nothing can move, or the joint cannot be closed.
    """

    def __init__(self, joint: Joint, bodies: Mapping[str, Body]):
        names, where = list(bodies), f"joint of {joint.first!r} and {joint.second!r}: "
        for name in (joint.first, joint.second):
            check_known("body", name, names, SceneError, where)
        self.first, self.second = names.index(joint.first), names.index(joint.second)
        self.points = np.array(joint.points, dtype=float)
        one, other = bodies[joint.first], bodies[joint.second]
        if one.is_driven and other.is_driven:
            raise SceneError(f"{where}allowed is a body that can move, and both move as they are told")
        self.on_first, self.on_second = one.points_at(self.points, where), other.points_at(self.points, where)
