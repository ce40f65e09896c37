"""Forces of many pairs under Coulomb's law, by sweeps of block Gauss-Seidel along the axes of space.

One pair after the other, normal before tangent (Jean, CMAME 177, 1999), until no force changes: what all points do is
kept along, so that a pair costs three rows of W. After every sweep the forces go as much further as the last two tell
(Anderson 1965), which takes a third of the sweeps.
"""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled.copying import copy, fill, largest_of
from fenics_rom.mechanics.compiled.coulomb import SOLVED, push
from fenics_rom.mechanics.compiled.work_space import release, take, take_frames, take_rows, taken

ROUND_OFF = 2e-15  # of the velocities that forces stop: what a sweep may change at its end
MOST_SWEEPS, MOST_FURTHER = 200, 12  # where they suffice they are rarely more than 60; of them from SOLVED on
FARTHEST = 4.0  # of the last change, by which forces go further


@jit_part
def _local_compliance(W: Array, p: int, axes: Array, local: Array) -> None:
    """Sets local (3, 3) to a point's own block of W in a frame."""
    for a in range(3):
        x = y = z = 0.0
        for j in range(3):
            row = W[3 * p + j]
            x += axes[a, j] * row[3 * p]
            y += axes[a, j] * row[3 * p + 1]
            z += axes[a, j] * row[3 * p + 2]
        for b in range(3):  # rows of W are what forces move
            local[b, a] = x * axes[b, 0] + y * axes[b, 1] + z * axes[b, 2]


@jit_part
def find_by_sweeps(
    W: Array,
    points: Array,
    axes: Array,
    q: Array,
    friction: Array,
    compliance: float,
    f: Array,
    moved: Array,
    most: int,
    space: Array,
) -> int:
    """Forces of C pairs: how many sweeps they took.

    Args:
        W: (3P, 3P), m/s/N; where it is not symmetric, its transpose.
        points: (C,) that of each pair.
        axes: (C, 3, 3) frames, rows n, t1 and t2.
        q: (C, 3) free velocities less targets, in these.
        friction: μ (C,).
        compliance: of each pair along its normal, m/s/N.
        f: (C, 3) in the frames, to begin with; set to what is found, in the cones.
        moved: (3P,) W f of all points, along the axes of space; changed with f.
        most: sweeps.
        space: with room for 22 numbers of each pair and 3 of each point.
    """
    C, speed, further, begun_with = len(points), largest_of(q), 0, taken(space)
    own, soft, stiff = take_frames(space, C), take_rows(space, C, 2), take_rows(space, C, 2)
    for c in range(C):
        _local_compliance(W, points[c], axes[c], own[c])
        own[c, 0, 0] += compliance
        half, skew = (own[c, 1, 1] - own[c, 2, 2]) / 2, own[c, 1, 2]
        least = 1e-12 * (own[c, 0, 0] + own[c, 1, 1] + own[c, 2, 2])
        soft[c, 0] = max(own[c, 0, 0], least)
        soft[c, 1] = max((own[c, 1, 1] + own[c, 2, 2]) / 2 + math.sqrt(half * half + skew * skew), least)
        stiff[c, 0], stiff[c, 1] = 1 / soft[c, 0], 1 / soft[c, 1]
    n, forces, moved_last = 3 * C, flat(f), take(space, len(moved))
    begun, last, changed = take(space, n), take(space, n), take(space, n)
    fill(last, 0.0)
    fill(changed, 0.0)
    fill(moved_last, 0.0)
    for count in range(1, most + 1):
        copy(forces, begun)
        missed = _sweep(W, points, axes, q, friction, compliance, own, soft, stiff, f, moved)
        further += missed <= SOLVED * speed
        if missed <= ROUND_OFF * speed or further > MOST_FURTHER:
            break
        along = square = 0.0
        for k in range(n):
            now = forces[k] - begun[k]
            bent = now - changed[k]
            along, square, changed[k] = along + now * bent, square + bent * bent, now
        share = max(-FARTHEST, min(0.5, along / square)) if count > 1 and square > 0 else 0.0
        _go_further(forces, last, share)
        _go_further(moved, moved_last, share)
    release(space, begun_with)
    return count


@jit_part
def _sweep(
    W: Array,
    points: Array,
    axes: Array,
    q: Array,
    friction: Array,
    compliance: float,
    own: Array,
    soft: Array,
    stiff: Array,
    f: Array,
    moved: Array,
) -> float:
    """One sweep: the largest change of what a pair does by itself, m/s.

    `own` (C, 3, 3), and `soft` (C, 2) along the normal and across: compliances of each pair; `stiff` is one by `soft`.
    """
    missed = 0.0
    for c in range(len(points)):
        at, λ, first, second = 3 * points[c], f[c, 0], f[c, 1], f[c, 2]
        vx, vy, vz = moved[at], moved[at + 1], moved[at + 2]
        n, a, b = axes[c, 0], axes[c, 1], axes[c, 2]
        d = max(0.0, λ - (q[c, 0] + n[0] * vx + n[1] * vy + n[2] * vz + compliance * λ) * stiff[c, 0]) - λ
        ua = q[c, 1] + a[0] * vx + a[1] * vy + a[2] * vz + own[c, 1, 0] * d
        ub = q[c, 2] + b[0] * vx + b[1] * vy + b[2] * vz + own[c, 2, 0] * d
        ta, tb, cone = first - ua * stiff[c, 1], second - ub * stiff[c, 1], friction[c] * (λ + d)
        square = ta * ta + tb * tb
        if square > cone * cone:
            share = cone / math.sqrt(square)
            ta, tb = ta * share, tb * share
        da, db = ta - first, tb - second
        if d != 0.0 or da != 0.0 or db != 0.0:
            push(W, points[c], axes[c], d, da, db, moved)
            f[c, 0], f[c, 1], f[c, 2] = max(0.0, λ + d), ta, tb
            missed = max(missed, abs(d) * soft[c, 0], (abs(da) + abs(db)) * soft[c, 1])
    return missed


@jit_part
def _go_further(values: Array, last: Array, share: float) -> None:
    """Takes back a share of the change from the last values, which become those of now."""
    for k in range(len(values)):
        now = values[k]
        values[k], last[k] = now + share * (last[k] - now), now
