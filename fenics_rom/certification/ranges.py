"""The parameters of a certificate, and the world at a point of their ranges."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import quaternion_of, quaternion_of_vector, rotation_matrix
from fenics_rom.scene.certificate_checks import joined_to, joints_to_world
from fenics_rom.scene.certificate_format import OF_POSE, BodyRanges
from fenics_rom.scene.world_format import JointEntry, WorldBody, WorldFile

UNITS = {"mass": "kg", "position": "m", "rotation": "rad", "velocity": "m/s", "spin": "rad/s", "pace": "1"}
AXES = ".x", ".y", ".z"


@dataclass(frozen=True)
class Parameter:
    """A number of a body that goes from `low` to `high`; `axis` of a vector, -1 of what is none."""

    body: str
    key: str
    axis: int
    low: float
    high: float

    @property
    def name(self) -> str:
        """As it is printed."""
        return f"{self.body}.{self.key}{'' if self.axis < 0 else AXES[self.axis]}"

    @property
    def unit(self) -> str:
        """Of the number."""
        return UNITS[self.key]

    def at(self, share: float) -> float:
        """The number at a share of the range."""
        return self.low + share * (self.high - self.low)


def parameters_of(ranges: Mapping[str, BodyRanges]) -> list[Parameter]:
    """What changes, in the order of the file."""
    found = []
    for body, of_body in ranges.items():
        for key, given in vars(of_body).items():
            if given is None:
                continue
            low, high = given
            ends = zip(low, high, strict=True) if isinstance(low, tuple) else [(low, high)]
            axes = range(3) if isinstance(low, tuple) else [-1]
            found += [Parameter(body, key, axis, *pair) for axis, pair in zip(axes, ends, strict=True)]
    return [each for each in found if each.low < each.high]


def file_at(file: WorldFile, point: Array) -> WorldFile:
    """A world file with its parameters at a point (d,) of [0, 1]^d; what does not change has its low end."""
    table = file.certificate
    assert table is not None
    shares = dict(zip(((p.body, p.key, p.axis) for p in parameters_of(table.ranges)), point.tolist(), strict=True))
    bodies, joints = dict(file.bodies), file.joints
    for name, ranges in table.ranges.items():
        values = {key: _at(ranges, name, key, shares) for key, given in vars(ranges).items() if given is not None}
        if "mass" in values:
            bodies[name] = replace(bodies[name], mass=values["mass"])
        if "pace" in values:
            bodies[name] = replace(bodies[name], path=_paced(bodies[name].path, values["pace"]))
        pose = {key: np.array(value) for key, value in values.items() if key in OF_POSE}
        if pose:
            group = joined_to(name, file)
            bodies, joints = _posed(name, pose, group, bodies, joints, joints_to_world(group, file))
    return replace(file, bodies=bodies, joints=joints)


def _at(ranges: BodyRanges, name: str, key: str, shares: Mapping[tuple[str, str, int], float]) -> Any:
    low, high = getattr(ranges, key)
    if not isinstance(low, tuple):
        return Parameter(name, key, -1, low, high).at(shares.get((name, key, -1), 0.0))
    ends = enumerate(zip(low, high, strict=True))
    return tuple(Parameter(name, key, axis, *pair).at(shares.get((name, key, axis), 0.0)) for axis, pair in ends)


def _paced(path: Any, pace: float) -> Any:
    """A path that is gone along so many times as fast, from its first row on."""
    begin = path.times[0]
    twists = {key: getattr(path, key) for key in ("velocities", "angular_velocities")}
    faster = {key: None if rows is None else pace * rows for key, rows in twists.items()}
    return replace(path, times=begin + (path.times - begin) / pace, **faster)


def _posed(
    name: str,
    pose: Mapping[str, Array],
    group: list[str],
    bodies: dict[str, WorldBody],
    joints: tuple[JointEntry, ...],
    held: list[JointEntry],
) -> tuple[dict[str, WorldBody], tuple[JointEntry, ...]]:
    """Moves a body, and all that is joined to it as one with it: about its place, or what holds it to the world."""
    body = bodies[name]
    about = np.array(body.position if not held else held[0].point)
    shift = pose.get("position", np.array(body.position)) - np.array(body.position)
    turn = np.eye(3)
    if "rotation" in pose:
        turn = _matrix(pose["rotation"]) @ _matrix(np.array(body.rotation)).T
    velocity, spin = pose.get("velocity", np.array(body.velocity)), pose.get("spin", np.array(body.spin))
    moved = dict(bodies)
    for each in group:
        old = bodies[each]
        place = about + shift + turn @ (np.array(old.position) - about)
        new: dict[str, Any] = {
            "position": tuple(place),
            "rotation": tuple(_vector(turn @ _matrix(np.array(old.rotation)))),
        }
        if {"velocity", "spin"} & pose.keys():
            swept = np.cross(spin, place - about - shift)
            new |= {"velocity": tuple(swept if held else velocity + swept), "spin": tuple(spin)}
        moved[each] = replace(old, **new)
    return moved, tuple(_with(joint, group, about, shift, turn) for joint in joints)


def _with(joint: JointEntry, group: list[str], about: Array, shift: Array, turn: Array) -> JointEntry:
    """A joint of bodies that were moved: its point and axis go with them."""
    if not {joint.first, joint.second} & {*group}:
        return joint
    point = None if joint.point is None else tuple(about + shift + turn @ (np.array(joint.point) - about))
    axis = None if joint.axis is None else tuple(turn @ np.array(joint.axis))
    return replace(joint, point=point, axis=axis)


def _matrix(rotation: Array) -> Array:
    return rotation_matrix(quaternion_of_vector(rotation))


def _vector(R: Array) -> Array:
    """The rotation vector of a matrix."""
    w, *xyz = quaternion_of(R)
    length = math.hypot(*xyz)
    return np.array(xyz) * (2 * math.atan2(length, w) / length if length else 2.0)
