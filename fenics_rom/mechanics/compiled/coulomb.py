"""Coulomb's law of many pairs, as the methods that find forces ask it.

Pair c of a point and an obstacle has the frame [n, t1, t2], the force f = λ n + f_t, and u = q + [n, t1, t2]ᵀ (W f), as
in `mechanics.complementarity`. Methods that take many products have the operator of the pairs alone, in their frames.
"""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.mechanics.frame_motion import Vector

# Of the velocities that forces stop: how far they may be from the law where they are looked for further, and at all.
ACCURATE, SOLVED = 1e-14, 1e-12
STAGNATION = 1e-9 / 100  # and at most: see `complementarity.solution`
REGULAR_SHARE = 0.4  # see `complementarity.solution`


@jit_part
def frame_along(axes: Array) -> None:
    """Sets the last two rows of axes (3, 3) to tangents of the first, a unit vector: those of `axes_along`."""
    n = axes[0]
    sign = math.copysign(1.0, n[0])
    w0 = n[0] + sign
    for k in range(1, 3):
        axes[k, 0] = n[k]
        for j in range(1, 3):
            axes[k, j] = n[j] * (n[k] / w0) - (sign if j == k else 0.0)


@jit_part
def in_space(frame: Array, n: float, a: float, b: float) -> Vector:
    """A vector in a frame (3, 3), along the axes of space."""
    return (
        frame[0, 0] * n + frame[1, 0] * a + frame[2, 0] * b,
        frame[0, 1] * n + frame[1, 1] * a + frame[2, 1] * b,
        frame[0, 2] * n + frame[1, 2] * a + frame[2, 2] * b,
    )


@jit_part
def sum_of(shares: Vector, rows: tuple[Vector, Vector, Vector]) -> Vector:
    """Shares of three rows."""
    (a, b, c), (one, two, three) = shares, rows
    return (
        a * one[0] + b * two[0] + c * three[0],
        a * one[1] + b * two[1] + c * three[1],
        a * one[2] + b * two[2] + c * three[2],
    )


@jit_part
def add_motion(W: Array, p: int, fx: float, fy: float, fz: float, moved: Array) -> None:
    """Adds what a force on point p does to the velocities of all points, (3P,), by rows of W: the columns of Wᵀ."""
    x, y, z = 3 * p, 3 * p + 1, 3 * p + 2
    for k in range(len(moved)):
        moved[k] += W[x, k] * fx + W[y, k] * fy + W[z, k] * fz


@jit_part
def push(W: Array, p: int, frame: Array, a: float, b: float, c: float, moved: Array) -> None:
    """`add_motion` of a force in a frame."""
    x, y, z = in_space(frame, a, b, c)
    add_motion(W, p, x, y, z, moved)


@jit_part
def yielding_of(W: Array, p: int, compliance: float) -> float:
    """1/ρ of a pair at a point, m/s/N: see `complementarity.frictional`; compliance is along its normal."""
    return (W[3 * p, 3 * p] + W[3 * p + 1, 3 * p + 1] + W[3 * p + 2, 3 * p + 2] + compliance) / (3 * REGULAR_SHARE)


@jit_part
def look_at(
    W: Array,
    points: Array,
    axes: Array,
    q: Array,
    friction: Array,
    compliance: float,
    yielding: Array,
    f: Array,
    u: Array,
    moved: Array,
) -> float:
    """How far C forces are from the law, the largest |f - P(f - ρ u)|/ρ, m/s.

    Args:
        W: (3P, 3P), m/s/N; where it is not symmetric, its transpose.
        points: (C,) that of each pair.
        axes: (C, 3, 3) frames, rows n, t1 and t2.
        q: (C, 3) free velocities less targets, in these, m/s.
        friction: μ (C,).
        compliance: of each pair along its normal, m/s/N.
        yielding: (C,) 1/ρ of each pair, m/s/N.
        f: (C, 3) in the frames, N.
        u: (C, 3) W f + q; set.
        moved: (3P,) W f of all points, along the axes of space; set.
    """
    fill(moved, 0.0)
    for c in range(len(points)):
        push(W, points[c], axes[c], f[c, 0], f[c, 1], f[c, 2], moved)
    for c in range(len(points)):
        frame, at = axes[c], 3 * points[c]
        for k in range(3):
            u[c, k] = q[c, k] + frame[k, 0] * moved[at] + frame[k, 1] * moved[at + 1] + frame[k, 2] * moved[at + 2]
        u[c, 0] += compliance * f[c, 0]
    return _missed_by(friction, yielding, f, u)


@jit_part
def look_among(V: Array, q: Array, friction: Array, yielding: Array, f: Array, u: Array) -> float:
    """The same by the operator of the pairs alone, see `operator_among`; sets u (C, 3)."""
    copy(q, u)
    add_motion_among(V, f, flat(u))
    return _missed_by(friction, yielding, f, u)


@jit_part
def _missed_by(friction: Array, yielding: Array, f: Array, u: Array) -> float:
    worst = 0.0
    for c in range(len(f)):
        λ, first, second, ρ = f[c, 0], f[c, 1], f[c, 2], 1 / yielding[c]
        n = λ - ρ * u[c, 0]
        if n <= 0:  # as most are where few push: nothing is along tangents
            off = max(abs(λ), abs(first), abs(second))
        else:
            x, y, cone = first - ρ * u[c, 1], second - ρ * u[c, 2], friction[c] * n
            length = math.sqrt(x * x + y * y)
            share = cone / length if length > cone else 1.0
            off = max(abs(λ - n), abs(first - share * x), abs(second - share * y))
        worst = max(worst, off * yielding[c])
    return worst


@jit_part
def operator_among(W: Array, points: Array, axes: Array, compliance: float, V: Array) -> None:
    """Sets V (3C, 3C): what a force of one of C pairs, a row, does to the velocities of all, in their frames.

    Other arguments as of `look_at`. What a pair yields along its normal is on the diagonal.
    """
    for i in range(len(points)):
        p, frame = 3 * points[i], axes[i]
        for a in range(3):
            x, y, z, row = frame[a, 0], frame[a, 1], frame[a, 2], V[3 * i + a]
            for j in range(len(points)):
                q, other = 3 * points[j], axes[j]
                u = x * W[p, q] + y * W[p + 1, q] + z * W[p + 2, q]
                v = x * W[p, q + 1] + y * W[p + 1, q + 1] + z * W[p + 2, q + 1]
                w = x * W[p, q + 2] + y * W[p + 1, q + 2] + z * W[p + 2, q + 2]
                for b in range(3):
                    row[3 * j + b] = other[b, 0] * u + other[b, 1] * v + other[b, 2] * w
        V[3 * i, 3 * i] += compliance


@jit_part
def add_motion_among(V: Array, f: Array, moved: Array) -> None:
    """Adds what forces of pairs (C, 3) do to their velocities, (3C,)."""
    for c in range(len(f)):
        if f[c, 0] != 0.0 or f[c, 1] != 0.0 or f[c, 2] != 0.0:
            add_pushes(V, c, f[c, 0], f[c, 1], f[c, 2], moved)


@jit_part
def add_pushes(V: Array, c: int, n: float, a: float, b: float, moved: Array) -> None:
    """The same of one pair's force."""
    first, second, third = V[3 * c], V[3 * c + 1], V[3 * c + 2]
    for k in range(len(moved)):
        moved[k] += n * first[k] + a * second[k] + b * third[k]
