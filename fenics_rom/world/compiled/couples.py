"""How a surface of a soft body turns as a whole, and couples that joints hold it by: `mechanics.surface_points`.

ω = J⁻¹ Σ w d × v of its nodes, and a couple τ is w J⁻¹τ × d on them. J⁻¹ and the arms d are kept in the axes that v and
τ are given in: those of the world, or of the frame of a free body.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.frames import added, cross, dot, put, rotated, vector
from fenics_rom.world.compiled.tables import OF_JOINT, Joined, Near

NONE = (0.0, 0.0, 0.0)


class Turning(NamedTuple):
    """Of a surface that c nodes carry."""

    nodes: Array  # (c,)
    weights: Array  # (c,) of these
    arms: Array  # (3 + c, 3): J⁻¹, 1/m², then d, m


@jit_part
def couple_of(meetings: Array, features: Array, c: int) -> int:
    """Which couple a pair is; -1: none. Of all arrays of `Near` it takes two, as many would cost more than the look."""
    return features[c] if meetings[c] == OF_JOINT else -1


@jit_part
def are_couples(near: Near, pairs: Array) -> Array:
    """Which of some pairs (n,) are."""
    are = np.zeros(len(pairs), dtype=np.bool_)
    for i in range(len(pairs)):
        are[i] = couple_of(near.meetings, near.features, pairs[i]) >= 0
    return are


@jit_part
def turning_of(pairs: Near | Joined, row: int, arms: Array) -> Turning:
    """Of the first body of a pair that is a couple, with its arms."""
    return Turning(pairs.nodes[row, 0], pairs.weights[row, 0], arms)


@jit_part
def look_at_turning(of: Turning, places: Array) -> None:
    """Sets J⁻¹ and arms, where points (P, 3) are, m."""
    middle, xx, yy, zz, yz, xz, xy = NONE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(len(of.nodes)):
        middle = added(middle, of.weights[n], vector(places[of.nodes[n]], 0))
    for n in range(len(of.nodes)):
        x, y, z = added(vector(places[of.nodes[n]], 0), -1.0, middle)
        w = of.weights[n]
        put(of.arms[3 + n], 0, (x, y, z))
        xx, yy, zz = xx + w * (y * y + z * z), yy + w * (x * x + z * z), zz + w * (x * x + y * y)
        yz, xz, xy = yz - w * y * z, xz - w * x * z, xy - w * x * y
    rows = inverse_of(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    for k in range(3):
        put(of.arms[k], 0, rows[k])


@jit_part
def inverse_of(matrix: Rotation) -> Rotation:
    """Of a matrix (3, 3)."""
    a, b, c = matrix
    x, y, z = cross(b, c), cross(c, a), cross(a, b)
    whole = 1 / dot(a, x)
    return (
        (whole * x[0], whole * y[0], whole * z[0]),
        (whole * x[1], whole * y[1], whole * z[1]),
        (whole * x[2], whole * y[2], whole * z[2]),
    )


@jit_part
def _by(of: Turning, a: Vector) -> Vector:
    """J⁻¹ a."""
    return rotated((vector(of.arms[0], 0), vector(of.arms[1], 0), vector(of.arms[2], 0)), a)


@jit_part
def turned_by(of: Turning, n: int, v: Vector) -> Vector:
    """What the velocity of the n-th node turns the surface by."""
    x, y, z = _by(of, cross(vector(of.arms[3 + n], 0), v))
    return (of.weights[n] * x, of.weights[n] * y, of.weights[n] * z)


@jit_part
def pushed_by(of: Turning, n: int, couple: Vector) -> Vector:
    """The force on the n-th node by a couple."""
    x, y, z = cross(_by(of, couple), vector(of.arms[3 + n], 0))
    return (of.weights[n] * x, of.weights[n] * y, of.weights[n] * z)


@jit_part
def map_in(of: Turning, n: int) -> Rotation:
    """Q of the n-th node, where Q v is what its velocity turns the surface by."""
    x, y, z = turned_by(of, n, (1.0, 0.0, 0.0)), turned_by(of, n, (0.0, 1.0, 0.0)), turned_by(of, n, (0.0, 0.0, 1.0))
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


@jit_part
def map_of(of: Turning, n: int, outward: Rotation) -> Rotation:
    """Q' of the n-th node with outward Q' = Q outward."""
    Q, back, (a, b, c) = map_in(of, n), inverse_of(outward), outward
    x = rotated(back, rotated(Q, (a[0], b[0], c[0])))
    y = rotated(back, rotated(Q, (a[1], b[1], c[1])))
    z = rotated(back, rotated(Q, (a[2], b[2], c[2])))
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])
