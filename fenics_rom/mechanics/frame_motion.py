"""Rotations of a moving frame: unit quaternions (w, x, y, z), matrices, and Cayley's map.

    cay(t) = (1 - t~/2)⁻¹ (1 + t~/2),    t~ a = t × a

turns by 2 atan(|t|/2) about t: a step of h s at the mid-step angular velocity ω̂ in the axes of the frame leads from R
to R⁺ = R cay(h ω̂), and with R* = R (1 + h/2 ω̂~) and u⁺ = u + h û

    (R⁺ u⁺ - R u)/h = (R* ω̂) × (R u + R⁺ u⁺)/2 + R* û    exactly,        (R + R⁺)/2 = R*⁻ᵀ.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

if TYPE_CHECKING:
    from fenics_rom.mechanics.base_path import BaseState

Numbers = Sequence[float] | Array
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Rotation = tuple[Vector, Vector, Vector]  # the rows of R
ZERO: Vector = (0.0, 0.0, 0.0)
MOST_TURNED = 2.0  # rad in a step of what moves as it is told: beyond it nobody knows which way
LEAST_COSINE = math.cos(MOST_TURNED / 2)


def cross_matrix(a: Numbers) -> Array:
    """a~ (3, 3), with a~ b = a × b."""
    x, y, z = a
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def rotation_matrix(quaternion: Numbers) -> Array:
    """R (3, 3) of a unit quaternion."""
    return np.array(rotation_of(*map(float, quaternion)))


def rotation_matrices(quaternions: Array) -> Array:
    """R (n, 3, 3) of unit quaternions (n, 4)."""
    return np.array(rotation_of(*quaternions.T)).transpose(2, 0, 1)


def rotation_of(w: float, x: float, y: float, z: float) -> Rotation:
    """R of a unit quaternion."""
    ww, xx, yy, zz, wx, wy, wz = w * w, x * x, y * y, z * z, 2 * w * x, 2 * w * y, 2 * w * z
    xy, xz, yz = 2 * x * y, 2 * x * z, 2 * y * z
    return (
        (ww + xx - yy - zz, xy - wz, xz + wy),
        (xy + wz, ww - xx + yy - zz, yz - wx),
        (xz - wy, yz + wx, ww - xx - yy + zz),
    )


def quaternion_of(R: Array) -> Array:
    """The unit quaternion (4,), w >= 0, of a rotation matrix (3, 3)."""
    # 4 w², 4 x², 4 y², 4 z²: divided by the root of the largest nothing cancels.
    squares = 1 + np.array((R.trace(), *(2 * R.diagonal() - R.trace())))
    (w, x, y, z), largest = squares, int(squares.argmax())
    (a, b, c), (d, e, f) = (
        (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]),
        (R[2, 1] + R[1, 2], R[0, 2] + R[2, 0], R[1, 0] + R[0, 1]),
    )
    q = np.array(((w, a, b, c), (a, x, f, e), (b, f, y, d), (c, e, d, z))[largest])
    return q / (math.copysign(1.0, q[0]) * math.hypot(*q))


def quaternion_of_vector(turn: Numbers) -> Array:
    """The unit quaternion (4,) of a turn about a vector (3,) by its length, rad."""
    angle = math.hypot(*turn)
    half = math.sin(angle / 2) / angle if angle > 0 else 0.5
    return np.array((math.cos(angle / 2), *(half * part for part in turn)))


def turned(quaternion: Numbers, t: Numbers) -> Quaternion:
    """The unit quaternion of R cay(t), t (3,) in the axes of the frame that the quaternion of R turns."""
    w, x, y, z = quaternion
    a, b, c = t[0] / 2, t[1] / 2, t[2] / 2
    w, x, y, z = (
        w - x * a - y * b - z * c,
        x + w * a + y * c - z * b,
        y + w * b + z * a - x * c,
        z + w * c + x * b - y * a,
    )
    size = math.sqrt(w * w + x * x + y * y + z * z)
    return w / size, x / size, y / size, z / size


def composed(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation b, then a."""
    (s, t, u, v), (w, x, y, z) = a, b
    return (
        s * w - t * x - u * y - v * z,
        s * x + t * w + u * z - v * y,
        s * y + u * w + v * x - t * z,
        s * z + v * w + t * y - u * x,
    )


def cayley(t: Numbers) -> Array:
    """cay(t), (3, 3)."""
    return rotation_matrix(turned((1.0, 0.0, 0.0, 0.0), t))


def world_displacement(pose: "BaseState", origin: Array, rest: Array, displacement: Array) -> Array:
    """Of points at rest (P, 3) in world axes that have moved by (P, 3) in the frame, (P, 3), m."""
    moved: Array = pose.position + (rest - origin + displacement).dot(rotation_matrix(pose.rotation).T) - rest
    return moved


def world_velocity(pose: "BaseState", origin: Array, rest: Array, displacement: Array, velocity: Array) -> Array:
    """Of the same points that move with (P, 3) in the frame, (P, 3), m/s."""
    R = rotation_matrix(pose.rotation)
    arms = (rest - origin + displacement).dot(R.T)
    moving: Array = pose.velocity + arms.dot(cross_matrix(pose.angular_velocity).T) + velocity.dot(R.T)
    return moving


def cross(a: Vector, b: Vector) -> Vector:
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Vector, b: Vector) -> float:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(a: Numbers) -> float:
    """|a|, of (3,)."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def added(a: Vector, factor: float, b: Vector) -> Vector:
    """a + factor b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


def mean(a: Vector, b: Vector) -> Vector:
    """(a + b)/2."""
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2


def rotated(R: Rotation, a: Vector) -> Vector:
    """R a."""
    ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz)), (x, y, z) = R, a
    return xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z


def rotated_back(R: Rotation, a: Vector) -> Vector:
    """Rᵀ a."""
    ((xx, xy, xz), (yx, yy, yz), (zx, zy, zz)), (x, y, z) = R, a
    return xx * x + yx * y + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z


def seen(R: Rotation, t: Vector, a: Vector) -> Vector:
    """R*ᵀ a = Rᵀa - t/2 × Rᵀa: a vector in world axes as a frame sees it that turns from R to R cay(t)."""
    b = rotated_back(R, a)
    return added(b, -0.5, cross(t, b))


def turned_along(start: Rotation, end: Rotation, a: Vector) -> Vector:
    """(R + R⁺)/2 a: what turns with a frame as it acts in a step."""
    return mean(rotated(start, a), rotated(end, a))
