"""Joints: points of two bodies that stay together; one is a ball joint, two a hinge, three a weld.

Where one of them is soft, a surface of it may be held instead.

A joint holds from its `start` to its `stop`, or while `World.join` and `World.release` say so: its points are those
where the bodies are when it is made. What moves relative to one another then, an impulse stops.

Each point has u = 0 in the middle of every step. As a point goes by h ŝ exactly, it stays where the other one is, to
round-off: nothing needs to be pulled back. After a step an impulse takes what relative velocity is left at its end,
which would change sign in every step: it keeps momenta and can only take energy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, check_known, shown
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.mechanics.triangles import triangles_among
from fenics_rom.world.bodies import NO_ROWS, Body, Points
from fenics_rom.world.drives import STILL, Drive, State
from fenics_rom.world.soft import CLOSED, Soft
from fenics_rom.world.surfaces import hold_surface, is_rigid, soft_points

KINDS = ("ball", "hinge", "weld")
HELD_BY_WELD = 6  # motions of a surface as a whole


@dataclass(frozen=True)
class _OfTwo:
    """What all joints have."""

    first: str
    second: str
    name: str | None = field(default=None, kw_only=True)
    start: float = field(default=0.0, kw_only=True)
    stop: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        where = f"joint of {self.first!r} and {self.second!r}"
        if not 0 <= self.start < np.inf:
            raise SceneError(f"{where}: start = {self.start!r}: use a time from 0 on, in s")
        if self.stop is not None and not self.start < self.stop < np.inf:
            raise SceneError(f"{where}: stop = {self.stop!r}: use a time after its start, {self.start!r} s")
        for name in (self.first, self.second):
            if not isinstance(name, str):
                raise SceneError(f"joint: {shown(name)} was given; use the name of a body")
        if self.first == self.second:
            raise SceneError(f"joint: use two bodies (got {self.first!r} with itself)")


@dataclass(frozen=True)
class Joint(_OfTwo):
    """Points of two bodies that stay together.

    Args:
        first, second: names of the bodies.
        points: (k, 3) in world axes, where the bodies begin, m.
        means: what was asked for, for messages: of a weld where it is, and how its points lie about it.
        along: of a slider its axis, and of a hinge with a drive, of any length but zero, in world axes.
        slides: whether the one point goes along that, and does not turn.
        drive: what acts along, or about, the axis: of rigid bodies.
        name: by which a world lets go of it; None: "joint0" and so on.
        start: when it is made, s; before the first step whose middle is later.
        stop: when it is let go, s; None: never by itself.
    """

    points: tuple[tuple[float, float, float], ...]
    means: str = ""
    along: tuple[float, float, float] | None = None
    slides: bool = False
    drive: Drive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive is not None and not isinstance(self.drive, Drive):
            raise SceneError(f"joint of {self.first!r} and {self.second!r}: use a Drive (got {self.drive!r})")
        if (self.slides or self.drive is not None) and (self.along is None or not np.any(_vector(self.along))):
            raise SceneError(f"joint of {self.first!r} and {self.second!r}: an axis along which it goes is missing")
        points = np.array(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise SceneError(f"joint of {self.first!r} and {self.second!r}: use points of three finite numbers, m")


@dataclass(frozen=True)
class SurfaceJoint(_OfTwo):
    """A surface of a soft body that another body holds.

    A weld holds each of its contact points; one that `rigid` in the supports of its scene names as a whole, by three
    forces and three couples, which are exact as such a surface turns but a little. A ball joint holds its mean place, a
    hinge a line through that. The body begins in the surface's contact mode.

    Args:
        first: the soft body.
        second: the other one.
        surface: name of a contact mode of the first.
        kind: "weld", "ball" or "hinge".
        axis: of a hinge, in the surface, in world axes, of any length but zero.
        name, start, stop: as of a Joint.
    """

    surface: str
    kind: str = "weld"
    axis: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_known("kind of joint", self.kind, KINDS, SceneError)
        if (self.axis is not None) != (self.kind == "hinge"):
            raise SceneError(f"joint of {self.first!r} and {self.second!r}: a hinge has an axis, and no other joint")
        if self.axis is not None:
            _direction(self.axis)


AnyJoint = Joint | SurfaceJoint


def ball(first: str, second: str, point: Sequence[float], **when: Any) -> Joint:
    """A ball joint at a point, m. `when`: name, start and stop of a Joint."""
    return Joint(first, second, (_vector(point),), **when)


def hinge(
    first: str, second: str, point: Sequence[float], axis: Sequence[float], drive: Drive | None = None, **when: Any
) -> Joint:
    """A hinge about an axis through a point, m; how long the axis is says how far apart two points of it are held.

    `drive`: what acts about it, as the second body turns from the first; `when`: name, start and stop of a Joint.
    """
    along, at = _direction(axis) / 2, np.array(_vector(point))
    said = f"hinge at {list(_vector(point))}, which holds two points of its axis, {2 * np.linalg.norm(along):g} m apart"
    return Joint(first, second, (_vector(at - along), _vector(at + along)), said, _vector(axis), False, drive, **when)


def slider(
    first: str, second: str, point: Sequence[float], axis: Sequence[float], drive: Drive | None = None, **when: Any
) -> Joint:
    """A slider: the second of two rigid bodies goes along an axis of the first one, at a point, m, and does not turn.

    `drive` and `when`: as of a hinge.
    """
    _direction(axis)
    return Joint(
        first, second, (_vector(point),), f"slider at {list(_vector(point))}", _vector(axis), True, drive, **when
    )


def weld(first: str, second: str, point: Sequence[float], size: float = 0.1, **when: Any) -> Joint:
    """A weld about a point, m, at three points that are `size` m apart. `when`: name, start and stop of a Joint."""
    corners, about = np.eye(3) * size / 2**0.5, _vector(point)
    points = tuple(_vector(np.array(about) + corner - corners.mean(axis=0)) for corner in corners)
    said = f"weld at {list(about)}, which holds three points about it, {size:g} m from one another"
    return Joint(first, second, points, said, **when)


def _vector(numbers: Sequence[float] | Array) -> tuple[float, float, float]:
    vector = real_numbers_or_nan(numbers)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise SceneError(f"joint: use three finite numbers (got {shown(numbers)})")
    x, y, z = vector.tolist()
    return x, y, z


def _direction(axis: Sequence[float]) -> Array:
    vector = np.array(_vector(axis))
    if not vector.any():
        raise SceneError("hinge: axis: use a vector of any length but 0 (got length 0)")
    return vector


class JointPoints:
    """A joint of bodies as they are when it is made.

    Args:
        joint: as given.
        bodies: by name.

    Attributes:
        first, second: numbers of the bodies.
        points: (k, 3) where they are then, m.
        on_first, on_second: the same on either.
        are_forces: (k,) of which points: the others stand for how the bodies turn, and have couples.
        axes: of pairs that are held, or driven, along some directions alone: these, (r, 3) in axes of the first body,
            that of the drive last.
        drive, state: what acts along the motion that is left, and where it is.
        is_rigid: whether both bodies are.
        warning: what to say of it; empty where there is nothing.

    Raises:
        SceneError: nobody has these names, nothing can move, or the joint cannot be closed.
    """

    def __init__(self, joint: AnyJoint, bodies: Mapping[str, Body]):
        names, where = list(bodies), f"joint of {joint.first!r} and {joint.second!r}: "
        for name in (joint.first, joint.second):
            check_known("body", name, names, SceneError, where)
        self.first, self.second = names.index(joint.first), names.index(joint.second)
        self.is_rigid = not any(isinstance(bodies[name], Soft) for name in (joint.first, joint.second))
        one, other, self.warning = bodies[joint.first], bodies[joint.second], ""
        self.axes, self.state = dict[int, Array](), STILL
        self.drive: Drive | None = None
        if one.is_driven and other.is_driven:
            raise SceneError(f"{where}use a body that can move, and both move as they are told")
        if isinstance(joint, Joint):
            self.points = np.array(joint.points, dtype=float)
            where += f"{joint.means}: " if joint.means else ""
            if joint.slides or joint.drive is not None:
                self._go_along(joint, one, other, where)
                return
            self.on_first = one.points_at(self.points, where)
        else:
            if not isinstance(one, Soft):
                raise SceneError(f"{where}surface {joint.surface!r}: use one of a soft body, which comes first")
            self.points, self.on_first = _hold_surface(one, joint, not isinstance(other, Soft), where)
            order = one.rom.contact_models[joint.surface].order
            if joint.kind == "weld" and order < HELD_BY_WELD and not one.takes_couples:
                self.warning = (
                    f"contact mode {joint.surface!r} of {joint.first!r} has {order} shapes, fewer than the "
                    f"{HELD_BY_WELD} motions that a weld holds: it is locked, and its force and couple cannot be told "
                    "apart; one with force = 'wrench', or of a larger order, can"
                )
        self.on_second = other.points_at(self.points, where, self.on_first.couples)
        self.are_forces = np.ones(len(self.points), dtype=bool)
        self.are_forces[self.on_first.couples] = False

    def _go_along(self, joint: Joint, one: Body, other: Body, where: str) -> None:
        """A slider, or a hinge with a drive: a pair stands for how the bodies turn, and comes last."""
        for name, body in ((joint.first, one), (joint.second, other)):
            if isinstance(body, Soft):
                raise SceneError(f"{where}{name!r} is soft: use rigid bodies; weld one to its surface, and join that")
        assert joint.along is not None
        frame = _frame_along(np.array(joint.along)).dot(rotation_matrix(one.pose.rotation))
        self.points = np.concatenate([self.points, self.points[:1]])
        turns, self.drive = np.array([len(self.points) - 1]), joint.drive
        if joint.slides:
            self.axes = {0: frame if joint.drive is not None else frame[:2]}
        else:
            self.axes = {int(turns[0]): frame[2:]}
        self.on_first = one.points_at(self.points, where, turns)
        tells = np.array([0]) if joint.slides else NO_ROWS
        self.on_second = other.points_at(self.points, where, turns)._replace(tells=tells)
        self.are_forces = np.arange(len(self.points)) != turns[0]
        if joint.drive is not None:
            v = [
                body.pose.velocity + np.cross(body.pose.angular_velocity, self.points[0] - body.pose.position)
                for body in (one, other)
            ]
            ω = [body.pose.angular_velocity for body in (one, other)]
            speed = float(
                frame[2].dot(rotation_matrix(one.pose.rotation).T).dot(np.subtract(*(v if joint.slides else ω)[::-1]))
            )
            self.state = State(joint.drive.position, speed, speed if joint.drive.armature else 0.0)


def _frame_along(axis: Array) -> Array:
    """Three axes, as rows, the last one along that."""
    last = axis / np.linalg.norm(axis)
    first = np.cross(last, np.eye(3)[np.abs(last).argmin()])
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(last, first), last])


def _hold_surface(body: Soft, joint: SurfaceJoint, whole: bool, where: str) -> tuple[Array, Points]:
    """Where a joint holds the surface of a body, which goes to its contact mode: (j, 3), m, and points of the body.

    `whole`: whether a weld may hold it as a whole; `where`: what errors begin with.
    """
    surface, axis = joint.surface, None if joint.axis is None else np.array(joint.axis)
    check_known("contact mode", surface, body.rom.contact_models, SceneError, where)
    body.switch(surface)
    numbers = body.rom.contact_models[surface].contact_points
    nodes = np.searchsorted(body.contact_points, numbers)
    rigid = is_rigid(body.contact_coordinates[nodes], body.rom.rows_of(numbers))
    if rigid and joint.kind == "hinge":
        raise SceneError(
            f"{where}cannot be closed: surface {surface!r} is rigid, which no hinge holds; weld a rigid body to it, "
            "and hinge that"
        )
    triangles = triangles_among(nodes, body.contact_triangles)
    yields = body.yields and not rigid
    held = hold_surface(joint.kind, axis, body.places()[nodes], triangles, whole and not yields, yields)
    if held.gap > CLOSED * body.size:
        raise SceneError(
            f"{where}cannot be closed: its axis leaves surface {surface!r}, by {held.gap:.3g} m; use one in it, "
            "or a rigid body that is welded to it, and hinged"
        )
    return held.places, soft_points(nodes[held.nodes], held.weights)._replace(couples=held.couples)
