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
from fenics_rom.mechanics.compiled.coulomb import SOLVED, add_motion_among, add_pushes
from fenics_rom.mechanics.compiled.work_space import release, take, take_rows, taken

ROUND_OFF = 2e-15  # of the velocities that forces stop: what a sweep may change at its end
MOST_SWEEPS, MOST_FURTHER = 200, 12  # where they suffice they are rarely more than 60; of them from SOLVED on
FARTHEST = 4.0  # of the last change, by which forces go further


@jit_part
def find_by_sweeps(V: Array, q: Array, friction: Array, f: Array, most: int, space: Array) -> int:
    """Forces of C pairs: how many sweeps they took.

    Args:
        V: their operator (3C, 3C), of `coulomb.operator_among`.
        q: (C, 3) free velocities less targets, in the frames.
        friction: μ (C,).
        f: (C, 3) in the frames, to begin with; set to what is found, in the cones.
        most: sweeps.
        space: with room for 19 numbers of each pair.
    """
    C, speed, further, begun_with = len(f), largest_of(q), 0, taken(space)
    soft, stiff, moved = take_rows(space, C, 2), take_rows(space, C, 2), take(space, 3 * C)
    for c in range(C):
        n, a, b = V[3 * c, 3 * c], V[3 * c + 1, 3 * c + 1], V[3 * c + 2, 3 * c + 2]
        half, skew, least = (a - b) / 2, V[3 * c + 2, 3 * c + 1], 1e-12 * (n + a + b)
        soft[c, 0], soft[c, 1] = max(n, least), max((a + b) / 2 + math.sqrt(half * half + skew * skew), least)
        stiff[c, 0], stiff[c, 1] = 1 / soft[c, 0], 1 / soft[c, 1]
    fill(moved, 0.0)
    add_motion_among(V, f, moved)
    n, forces, moved_last = 3 * C, flat(f), take(space, len(moved))
    begun, last, changed = take(space, n), take(space, n), take(space, n)
    fill(last, 0.0)
    fill(changed, 0.0)
    fill(moved_last, 0.0)
    for count in range(1, most + 1):
        copy(forces, begun)
        missed = _sweep(V, q, friction, soft, stiff, f, moved)
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
def _sweep(V: Array, q: Array, friction: Array, soft: Array, stiff: Array, f: Array, moved: Array) -> float:
    """One sweep: the largest change of what a pair does by itself, m/s.

    `soft` (C, 2): compliances of each pair along the normal and across; `stiff` is one by them; moved: (3C,) V f.
    """
    missed = 0.0
    for c in range(len(f)):
        at, λ, first, second = 3 * c, f[c, 0], f[c, 1], f[c, 2]
        d = max(0.0, λ - (q[c, 0] + moved[at]) * stiff[c, 0]) - λ
        ua, ub = q[c, 1] + moved[at + 1] + V[at, at + 1] * d, q[c, 2] + moved[at + 2] + V[at, at + 2] * d
        ta, tb, cone = first - ua * stiff[c, 1], second - ub * stiff[c, 1], friction[c] * (λ + d)
        square = ta * ta + tb * tb
        if square > cone * cone:
            share = cone / math.sqrt(square)
            ta, tb = ta * share, tb * share
        da, db = ta - first, tb - second
        if d != 0.0 or da != 0.0 or db != 0.0:
            add_pushes(V, c, d, da, db, moved)
            f[c, 0], f[c, 1], f[c, 2] = max(0.0, λ + d), ta, tb
            missed = max(missed, abs(d) * soft[c, 0], (abs(da) + abs(db)) * soft[c, 1])
    return missed


@jit_part
def _go_further(values: Array, last: Array, share: float) -> None:
    """Takes back a share of the change from the last values, which become those of now."""
    for k in range(len(values)):
        now = values[k]
        values[k], last[k] = now + share * (last[k] - now), now
