"""A step of a moving frame: how it turns, where points on it go, exactly, and what forces on them do.

A point at y in the frame is at a = (R y + R⁺ y⁺)/2 from its origin in the middle of the step. Where the origin goes
with v̂, the frame turns with ω̂ and y changes by h û, it goes by h [v̂ + (R* ω̂) × a + R* û].
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import ZERO, Numbers, Rotation, Vector, added, cross_matrix, seen, turned_along

TOO_FAR = (
    "the body is so far from its shape at rest that its kinetic energy is not positive any more: use what a "
    "body of small strains can do in its frame; less force, or large_deformation, is the cure"
)


@dataclass
class Geometry:
    """How the frame turns in a step.

    Attributes:
        before, after: R, R⁺ = R cay(t).
        turn: t = h ω̂, in the frame's axes.
    """

    before: Rotation
    after: Rotation
    turn: Vector

    @cached_property
    def start(self) -> Array:
        """R (3, 3)."""
        return np.array(self.before)

    @cached_property
    def end(self) -> Array:
        """R⁺ (3, 3)."""
        return np.array(self.after)

    @cached_property
    def middle(self) -> Array:
        """R* = R (1 + t~/2), (3, 3)."""
        middle: Array = self.start + self.start.dot(cross_matrix(self.turn)) / 2
        return middle

    def mean(self, a: Vector) -> Vector:
        """(R + R⁺)/2 a: what turns with the frame as it acts in the step."""
        return ZERO if a == ZERO else turned_along(self.before, self.after, a)

    def seen(self, a: Vector) -> Vector:
        """R*ᵀ a = Rᵀa - t/2 × Rᵀa: a vector in world axes as the frame sees it in the step."""
        return seen(self.before, self.turn, a)


class Push(NamedTuple):
    """What forces on points do."""

    force: Vector  # all together, in world axes, N
    torque: Vector  # about the frame's origin, in world axes, N m
    turning: Vector  # R*ᵀ of it
    modal: Array  # on the coordinates; of a reduced body (m,), N kg^-1/2

    def beside(self, other: "Push | None") -> "Push":
        """What these and other forces do together."""
        if other is None:
            return self
        force, torque = added(self.force, 1.0, other.force), added(self.torque, 1.0, other.torque)
        return Push(force, torque, added(self.turning, 1.0, other.turning), self.modal + other.modal)

    @staticmethod
    def of(forces: Array, turn: Geometry, arms: Array, spread: Callable[[Array], Array]) -> "Push":
        """Of forces (P, 3) in world axes, N, at arms (P, 3), m; `spread` gives theirs on coordinates, in the frame."""
        B = arms.T.dot(forces)
        torque = np.array((B[1, 2] - B[2, 1], B[2, 0] - B[0, 2], B[0, 1] - B[1, 0]))
        inside = spread(forces.dot(turn.middle))
        return Push(vector(forces.sum(axis=0)), vector(torque), vector(torque.dot(turn.middle)), inside)


def arms_of(turn: Geometry, start: Array, end: Array) -> Array:
    """a = (R y + R⁺ y⁺)/2 (P, 3) in world axes, of places y at the start and the end in the frame."""
    return (start.dot(turn.start.T) + end.dot(turn.end.T)) / 2


def carried_along(turn: Geometry, arms: Array, ω: Numbers, inside: Array) -> Array:
    """Velocities (P, 3) in world axes, less the origin's, by ω (3,) and those inside of the frame (P, 3)."""
    velocities: Array = arms.dot(cross_matrix(turn.middle.dot(ω)).T) + inside.dot(turn.middle.T)
    return velocities


def turning_maps(turn: Geometry, arms: Array) -> Array:
    """Velocities (3 P, 3) of points at arms (P, 3) per unit of ω̂."""
    return crossed(arms).dot(turn.middle).reshape(-1, 3)


def crossed(arms: Array) -> Array:
    """-a~ (k, 3, 3) of arms (k, 3): velocities of points of a body that turns."""
    maps = np.zeros((len(arms), 3, 3), arms.dtype)
    x, y, z = arms.T
    maps[:, 0, 1], maps[:, 0, 2], maps[:, 1, 2] = z, -y, x
    maps -= maps.transpose(0, 2, 1)
    return maps


def turned_operator(left: Array, operator: Array, right: Array) -> Array:
    """L W Rᵀ of an operator W (3 P, 3 P), point by point."""
    P = len(operator) // 3
    once = np.matmul(left, operator.reshape(P, 3, 3 * P)).reshape(3 * P, P, 3)
    turned: Array = once.dot(right.T).reshape(3 * P, 3 * P)
    return turned


def vector(numbers: Array) -> Vector:
    """Three numbers."""
    x, y, z = numbers.tolist()
    return x, y, z
