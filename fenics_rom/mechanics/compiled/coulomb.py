"""Coulomb's law of many pairs, as the methods that find forces ask it, along the axes of space.

Pair c of a point and an obstacle has the frame [n, t1, t2], the force f = λ n + f_t, and u = q + [n, t1, t2]ᵀ (W f), as
in `mechanics.complementarity`. What W f of all points is, is kept along.
"""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import fill

# Of the velocities that forces stop: how far they may be from the law where they are looked for further, and at all.
ACCURATE, SOLVED = 1e-14, 1e-12
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
def add_motion(W: Array, p: int, fx: float, fy: float, fz: float, moved: Array) -> None:
    """Adds what a force on point p does to the velocities of all points, (3P,), by rows of W: the columns of Wᵀ."""
    x, y, z = 3 * p, 3 * p + 1, 3 * p + 2
    for k in range(len(moved)):
        moved[k] += W[x, k] * fx + W[y, k] * fy + W[z, k] * fz


@jit_part
def push(W: Array, p: int, frame: Array, a: float, b: float, c: float, moved: Array) -> None:
    """`add_motion` of a force in a frame."""
    x = frame[0, 0] * a + frame[1, 0] * b + frame[2, 0] * c
    y = frame[0, 1] * a + frame[1, 1] * b + frame[2, 1] * c
    z = frame[0, 2] * a + frame[1, 2] * b + frame[2, 2] * c
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
    """How far C forces are from the law, the largest |f - P(f - ρ u)|/ρ, m/s; arguments as of `find_by_sweeps`.

    Sets u (C, 3) and moved (3P,).
    """
    worst = 0.0
    fill(moved, 0.0)
    for c in range(len(points)):
        push(W, points[c], axes[c], f[c, 0], f[c, 1], f[c, 2], moved)
    for c in range(len(points)):
        frame, at = axes[c], 3 * points[c]
        for k in range(3):
            u[c, k] = q[c, k] + frame[k, 0] * moved[at] + frame[k, 1] * moved[at + 1] + frame[k, 2] * moved[at + 2]
        u[c, 0] += compliance * f[c, 0]
        n = f[c, 0] - u[c, 0] / yielding[c]
        first, second = f[c, 1] - u[c, 1] / yielding[c], f[c, 2] - u[c, 2] / yielding[c]
        length, cone = math.sqrt(first * first + second * second), friction[c] * max(n, 0.0)
        if length > cone:
            first, second = first * (cone / length), second * (cone / length)
        off = max(abs(f[c, 0] - max(n, 0.0)), abs(f[c, 1] - first), abs(f[c, 2] - second))
        worst = max(worst, off * yielding[c])
    return worst
