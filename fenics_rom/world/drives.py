"""What acts along the one motion that a hinge or a slider leaves: motor, limits, friction, damping, spring, rotor.

In a step of h s the joint goes by h s, from x with the speed a. What acts is a monotone law, force t over speed s:

    rotor       -2 I (s - ψ)/h          ψ its speed; it ends at 2 s - ψ
    damping     -d s
    spring      -k (x + h/2 s - rest)
    motor       gain (target - x - h/2 s) - d s,  gain (target - s),  or the target; within ± most
    friction    -F sign(s), and none between 0 and a/2: with that it stops within the step
    limits      t ≥ 0 where s = (lower - x)/h; an impulse takes what it moves by at the end

Friction, damping and limits have t s ≤ 0: they take energy at any step. Rotor and spring store what they take, to the
last bit, and the motor's h t s is what it supplies.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from fenics_rom.arguments import is_number
from fenics_rom.errors import SceneError, check_known, shown
from fenics_rom.world.drive_law import MOST_PIECES, set_law, stored

MOTORS = ("position", "velocity", "torque")


@dataclass(frozen=True)
class Motor:
    """What pushes a joint towards a target, which each step is given by the name of the joint.

    Args:
        kind: "position": gain (target - position) - damping · speed; "velocity": gain (target - speed); "torque": the
            target.
        gain: N m/rad or N m s/rad; of a slider N/m or N s/m. A "torque" has none.
        damping: of a "position", N m s/rad; of a slider N s/m.
        most: the largest torque, N m, or force, N.
    """

    kind: str
    gain: float = 0.0
    damping: float = 0.0
    most: float = math.inf

    def __post_init__(self) -> None:
        check_known("kind of motor", self.kind, MOTORS, SceneError)
        if (self.kind != "torque") != (_is_least("gain", self.gain, 0.0) > 0):
            raise SceneError(
                f"motor: kind = {self.kind!r}, gain = {shown(self.gain)}: use a gain > 0 of a position or "
                "velocity, none of a torque"
            )
        if _is_least("damping", self.damping, 0.0) and self.kind != "position":
            raise SceneError(
                f"motor: damping = {self.damping!r}: give it to a motor of kind position; this is a {self.kind}"
            )
        if not (isinstance(self.most, float | int) and self.most > 0):
            raise SceneError(f"motor: most = {shown(self.most)}: use a number > 0")


@dataclass(frozen=True)
class Drive:
    """What acts along the motion of a hinge or a slider. Its position is how the second body went from the first.

    Args:
        position: where the bodies begin, rad, about the axis; of a slider m, along it.
        limits: the least and the most position, rad or m.
        friction: the torque, N m, or force, N, that dry friction holds against.
        damping: N m s/rad, or N s/m.
        armature: inertia of a rotor that turns with the joint, kg m², or mass, kg.
        stiffness, rest: of a spring, N m/rad or N/m, and where it is slack.
        motor: what pushes it.
        follows: name of another joint, ratio and offset: position = ratio · its position + offset, at any force.

    Example:
        >>> from fenics_rom.world.drives import Drive, Motor
        >>> Drive(limits=(-1.0, 1.0), friction=0.1, motor=Motor("position", gain=50.0, damping=5.0)).armature
        0.0
    """

    position: float = 0.0
    limits: tuple[float, float] | None = None
    friction: float = field(default=0.0, kw_only=True)
    damping: float = field(default=0.0, kw_only=True)
    armature: float = field(default=0.0, kw_only=True)
    stiffness: float = field(default=0.0, kw_only=True)
    rest: float = field(default=0.0, kw_only=True)
    motor: Motor | None = field(default=None, kw_only=True)
    follows: tuple[str, float, float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("friction", "damping", "armature", "stiffness"):
            _is_least(name, getattr(self, name), 0.0)
        for name in ("position", "rest"):
            _is_least(name, getattr(self, name), -math.inf)
        if self.motor is not None and not isinstance(self.motor, Motor):
            raise SceneError(f"drive: motor = {shown(self.motor)}: use a Motor")
        if self.limits is not None:
            lower, upper = self.limits
            if not lower < upper:
                raise SceneError(f"drive: limits = {self.limits!r}: use two numbers, the smaller one first")
            if not lower <= self.position <= upper:
                raise SceneError(
                    f"drive: position = {self.position!r}: use one within its limits, {lower!r} to {upper!r}"
                )
        if self.follows is not None:
            name, *numbers = self.follows
            if not isinstance(name, str) or len(numbers) != 2 or not all(map(is_number, numbers)):
                raise SceneError(f"drive: follows = {shown(self.follows)}: use a name, a ratio and an offset")

    def energy(self, state: "State") -> float:
        """Of rotor and spring, J."""
        return stored(self.numbers, state.position, state.rotor)

    @cached_property
    def numbers(self) -> tuple[float, ...]:
        """As `drive_law` has it."""
        lower, upper = (-math.inf, math.inf) if self.limits is None else self.limits
        kind, gain, damping, most = 0, 0.0, 0.0, math.inf
        if self.motor is not None:
            kind, gain, damping = 1 + MOTORS.index(self.motor.kind), self.motor.gain, self.motor.damping
            most = self.motor.most
        own = self.friction, self.damping, self.armature, self.stiffness, self.rest
        return tuple(map(float, (lower, upper, *own, kind, gain, damping, most)))


def _is_least(name: str, value: float, least: float) -> float:
    if not (is_number(value) and value >= least):
        allowed = "a finite number" if least == -math.inf else f"a finite number >= {least:g}"
        raise SceneError(f"drive: {name} = {shown(value)}: use {allowed}")
    return value


class Piece(NamedTuple):
    """A part of a law: t = force - slope · s, or, if it is steep, any t at one speed."""

    is_steep: bool
    slope: float
    force: float
    speeds: tuple[float, float]  # from s to s
    forces: tuple[float, float]  # from the largest t, which the smallest s has, to the smallest


class State(NamedTuple):
    """Of a joint between two steps."""

    position: float  # x
    speed: float  # a, or in the middle of the step that ended
    rotor: float  # ψ
    target: float = 0.0
    by_motor: float = 0.0  # in the last step, N m or N
    force: float = 0.0  # of all that acts along it


STILL = State(0.0, 0.0, 0.0)


def law_of(drive: Drive, state: State, a: float, h: float) -> list[Piece]:
    """The law of a step of h s that begins with a speed a, in pieces from the smallest speed on."""
    numbers = [[0.0] * 7 for _ in range(MOST_PIECES)]
    count = set_law(drive.numbers, state, a, h, numbers)
    return [Piece(steep > 0, k, b, (s, end), (top, t)) for steep, k, b, s, end, top, t in numbers[:count]]


def piece_at(law: list[Piece], speed: float) -> int:
    """The first piece of a law that a speed is on; the last one beyond it."""
    return next((k for k, piece in enumerate(law) if speed <= piece.speeds[1]), len(law) - 1)
