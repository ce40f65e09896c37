"""Contact points of a linear body in a frame that moves: where they are in a step, and how they answer forces.

A point at y in the frame moves in it by û = V r̂ + what it yields beyond the basis. With the forces g on points, as the
frame sees them, r̂ changes by A⁻¹ V g and û by Vᵀ A⁻¹ V g + C g, C the residual compliance in the step: exactly, of
a frame whose turn is known. `steppers.touched_frame` and `steppers.residual_motion` have the equations.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled.copying import add_row, copy_rows, fill
from fenics_rom.mechanics.compiled.work_space import work_space
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.rom.block_rows import WANTED
from fenics_rom.runtime.compiled.frames import added, combine, cross, mean, put, rotated, seen, vector
from fenics_rom.runtime.compiled.touching import FORGOTTEN
from fenics_rom.runtime.compiled.yielding import step_beyond

INERTIA, WHOLE, LOST, TAU = range(4)  # in `Points.times`, s: 2τ²/h, a, β + (θ - ½) h and τ


class Points(NamedTuple):
    """P of them, of a body with m modes."""

    rest: Array  # X (P, 3) from the frame's origin, m
    rows: Array  # Vᵀ (m, 3P)
    R: Array  # rows of residual compliance that are kept (K, 3, 3P), m/N; (0, 0, 0) where there is none
    times: Array  # (4,), s
    beyond: Array  # g, y and their rates, (4, 3P)
    beyond_before: Array  # the same before the step
    # Of the step that has begun:
    start: Array  # y (P, 3), m
    free: Array  # û (P, 3) without contact, m/s
    inside: Array  # û (P, 3) under the forces of now, m/s
    forces: Array  # (P, 3) in world axes, N
    seen: Array  # g (P, 3)
    pushed: Array  # (P,) whether a force acts there
    spread: Array  # A⁻¹ V (m, 3P), and
    is_spread: Array  # (P,) of which points it is known
    slots: Array  # (P,) where in R those of a point are; below 0: they are not kept


class Beyond(NamedTuple):
    """What points do beyond the basis: `touching.Yielding`."""

    R: Array
    inertia: float
    whole: float
    lost: float
    τ: float


@jit_part
def lacks_rows(points: Points, p: int) -> bool:
    """Whether rows of R of a point are needed, and not kept; that is noted."""
    if len(points.R) == 0 or points.slots[p] >= 0:
        return False
    points.slots[p] = WANTED
    return True


@jit_part
def begin_points(points: Points, q: Array, rate: Array) -> None:
    """Sets where points are, and how they move without contact, at q and r̂ (m,)."""
    n = 3 * len(points.rest)
    start, free, rest = flat(points.start), flat(points.free), flat(points.rest)
    combine(q, points.rows, start)
    combine(rate, points.rows, free)
    for k in range(n):
        start[k] += rest[k]
    if len(points.R):
        inertia, whole, y, y_rate = points.times[INERTIA], points.times[WHOLE], points.beyond[1], points.beyond[3]
        for k in range(n):
            start[k] += y[k]
            free[k] += (inertia * y_rate[k] - y[k]) / whole


@jit_part
def place_points(
    points: Points, r: Array, R: Rotation, origin: Vector, v: Vector, ω: Vector, places: Array, velocities: Array
) -> None:
    """Sets places (P, 3), m, and velocities (P, 3), m/s, when a step begins, in world axes.

    Args:
        points: of a step that has begun.
        r: rates (m,).
        R, origin: of the frame, in world axes.
        v, ω: its velocities in its own axes.
        places, velocities: set.
    """
    n = 3 * len(points.rest)
    moving = np.empty(n)
    combine(r, points.rows, moving)
    if len(points.R):
        moving += points.beyond[3]
    for p in range(len(places)):
        y = vector(points.start[p], 0)
        put(places[p], 0, added(rotated(R, y), 1.0, origin))
        put(velocities[p], 0, rotated(R, added(added(v, 1.0, vector(moving, 3 * p)), 1.0, cross(ω, y))))


@jit_part
def see_forces(points: Points, R: Rotation, t: Vector) -> None:
    """Sets what the frame sees of the forces in a step that turns it by t."""
    for p in range(len(points.rest)):
        f = points.forces[p]
        points.pushed[p] = 1.0 if f[0] != 0.0 or f[1] != 0.0 or f[2] != 0.0 else 0.0
        if points.pushed[p]:
            put(points.seen[p], 0, seen(R, t, vector(f, 0)))
        else:
            put(points.seen[p], 0, (0.0, 0.0, 0.0))


@jit_part
def spread_some(points: Points, inverse: Array) -> None:
    """Makes `spread` known of those points that are pushed, with A⁻¹ (m, m)."""
    m = len(inverse)
    for p in range(len(points.rest)):
        if points.pushed[p] and not points.is_spread[p]:
            points.is_spread[p] = 1.0
            spread_one(points, inverse, p, m)


@jit_part
def spread_one(points: Points, inverse: Array, p: int, m: int) -> None:
    """Sets A⁻¹ V of a point."""
    for i in range(m):
        x = y = z = 0.0
        row = inverse[i]
        for j in range(m):
            of = points.rows[j]
            x += row[j] * of[3 * p]
            y += row[j] * of[3 * p + 1]
            z += row[j] * of[3 * p + 2]
        to = points.spread[i]
        to[3 * p], to[3 * p + 1], to[3 * p + 2] = x, y, z


@jit_part
def answer(points: Points, rate: Array, changed: Array) -> None:
    """Sets r̂ (m,) under the forces, from that without, and `inside` of all points; `spread` is to be known."""
    n, P = 3 * len(points.rest), len(points.rest)
    inside, free, m = flat(points.inside), flat(points.free), len(rate)
    change = np.zeros(m)
    for p in range(P):
        if points.pushed[p]:
            x, y, z = points.seen[p, 0], points.seen[p, 1], points.seen[p, 2]
            for i in range(m):
                row = points.spread[i]
                change[i] += row[3 * p] * x + row[3 * p + 1] * y + row[3 * p + 2] * z
    for i in range(m):
        changed[i] = rate[i] + change[i]
    combine(change, points.rows, inside)
    for k in range(n):
        inside[k] += free[k]
    add_yielding(points, inside)


@jit_part
def add_yielding(points: Points, inside: Array) -> None:
    """Adds to the velocities of all points (3P,) in the frame, m/s, what they yield to the forces beyond the basis."""
    if len(points.R):
        for p in range(len(points.rest)):
            if points.pushed[p]:
                for k in range(3):
                    add_row(points.R[points.slots[p], k], points.seen[p, k] / points.times[WHOLE], inside)


@jit_part
def arm_of(points: Points, p: int, R: Rotation, end: Rotation, h: float) -> Vector:
    """Of a point from the frame's origin in the middle of a step, in world axes, m."""
    y = vector(points.start[p], 0)
    return mean(rotated(R, y), rotated(end, added(y, h, vector(points.inside[p], 0))))


@jit_part
def end_points(points: Points, h: float, pull: Array) -> tuple[float, float]:
    """Takes the step of what points do beyond the basis: what it loses, J, and twice the energy stored there.

    `pull` (2, 3P) as of `step_beyond`, of a material that relaxes; (0, 3P): it does not.
    """
    if not len(points.R):
        return 0.0, 0.0
    n = 3 * len(points.rest)
    copy_rows(points.beyond, points.beyond_before)
    times, f = points.times, points.seen.reshape(n)
    yielding = Beyond(points.R, times[INERTIA], times[WHOLE], times[LOST], times[TAU])
    rates = np.empty(n)
    fill(rates, 0.0)
    for p in range(len(points.rest)):
        for k in range(3 if points.pushed[p] else 0):
            add_row(points.R[points.slots[p], k], points.seen[p, k], rates)
    lost, _, stored = step_beyond(yielding, h, points.beyond, pull, f, rates, work_space(n))
    if not points.pushed.any() and stored < 2 * FORGOTTEN and not len(pull):
        points.beyond[:] = 0.0
        return 0.0, 0.0
    return lost, stored
