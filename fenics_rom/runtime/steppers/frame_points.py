"""Points of a body in a moving frame within one step: forces on them in world axes, and how far they go, exactly."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_motion import (
    ZERO,
    Rotation,
    Vector,
    added,
    cross,
    cross_matrix,
    mean,
    rotated,
    rotated_back,
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
        return ZERO if a == ZERO else mean(rotated(self.before, a), rotated(self.after, a))

    def seen(self, a: Vector) -> Vector:
        """R*ᵀ a = Rᵀa - t/2 × Rᵀa: a vector in world axes as the frame sees it in the step."""
        b = rotated_back(self.before, a)
        return added(b, -0.5, cross(self.turn, b))


class Push(NamedTuple):
    """What forces on points do."""

    force: Vector  # all together, in world axes, N
    torque: Vector  # about the frame's origin, in world axes, N m
    turning: Vector  # R*ᵀ of it
    modal: Array  # (m,) on the coordinates, N kg^-1/2


class FramePoints(NamedTuple):
    """Points at X + V q in the frame."""

    rest: Array  # X (P, 3) from the frame's origin, m
    rows: Array  # Vᵀ of the points, (m, 3 P)

    def moved(self, q: Array) -> Array:
        """V q, (P, 3)."""
        moved: Array = q.dot(self.rows).reshape(-1, 3)
        return moved

    def of(self, some: Array) -> "FramePoints":
        """Some of them, (s,)."""
        rows = self.rows.reshape(len(self.rows), -1, 3)[:, some].reshape(len(self.rows), -1)
        return FramePoints(self.rest[some], rows)

    def maps(self, turn: Geometry, arms: Array) -> tuple[Array, Array]:
        """Velocities (3 P, 3) of unit ω̂ and (3 P, m) of unit r̂."""
        crossed = np.zeros((len(arms), 3, 3))  # -a~
        x, y, z = arms.T
        crossed[:, 0, 1], crossed[:, 0, 2], crossed[:, 1, 2] = z, -y, x
        crossed -= crossed.transpose(0, 2, 1)
        return crossed.dot(turn.middle).reshape(-1, 3), self.modal_maps(turn)

    def modal_maps(self, turn: Geometry) -> Array:
        """Velocities (3 P, m) of unit r̂."""
        rows: Array = self.rows.reshape(len(self.rows), -1, 3).dot(turn.middle.T).reshape(len(self.rows), -1)
        return rows.T

    def push(self, forces: Array, turn: Geometry, arms: Array) -> Push:
        """Of forces (P, 3) in world axes, N, at arms (P, 3) from the origin, m."""
        B = arms.T.dot(forces)
        torque = np.array((B[1, 2] - B[2, 1], B[2, 0] - B[0, 2], B[0, 1] - B[1, 0]))
        modal = self.rows.dot(forces.dot(turn.middle).ravel())
        return Push(vector(forces.sum(axis=0)), vector(torque), vector(torque.dot(turn.middle)), modal)


def arms_of(turn: Geometry, start: Array, end: Array) -> Array:
    """a = (R y + R⁺ y⁺)/2 (P, 3) in world axes, of places y at the start and the end in the frame."""
    return (start.dot(turn.start.T) + end.dot(turn.end.T)) / 2


def turned_velocities(ω: Array, arms: Array) -> Array:
    """ω × a (P, 3)."""
    velocities: Array = arms.dot(cross_matrix(ω).T)
    return velocities


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
