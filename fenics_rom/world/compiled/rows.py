"""Rows of joints in a step: directions as bodies go, laws of drives, what these do: `world.joint_rows`."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.frames import dot, put, rotated, rotation_in, rotation_of, vector
from fenics_rom.world import drive_law, turning
from fenics_rom.world.compiled.rigid_bodies import rows_of
from fenics_rom.world.compiled.row_tables import (
    ALONG,
    AT_START,
    COMPLIANCE,
    FIXED,
    FOLLOWING,
    FORCE,
    HELD,
    KNOWN,
    TARGET_SPEED,
    TURNING,
    Rows,
    rows_at,
)
from fenics_rom.world.compiled.soft_bodies import rows_in
from fenics_rom.world.compiled.tables import (
    BY_JOINTS,
    BY_MOTORS,
    DRIVEN,
    MEAN,
    NUMERICAL,
    SPIN,
    bodies_at,
    driven_at,
    freedoms_at,
    joined_at,
    near_at,
    rigid_at,
)
from fenics_rom.world.drive_law import (
    ARMATURE,
    AT_ZERO,
    BEGIN,
    BOTTOM,
    BY_MOTOR,
    END,
    IS_STEEP,
    POSITION,
    ROTOR,
    SLOPE,
    SPEED,
    TOP,
)
from fenics_rom.world.drive_law import FORCE as BY_ALL
from fenics_rom.world.tolerances import MISSES, MOST_CHANGES

_mean_rotation, _turning_along = map(jit_shared, (turning.mean_rotation, turning.turning_along))
set_law, motor_force, stored = map(jit_shared, (drive_law.set_law, drive_law.motor_force, drive_law.stored))


@jit_part
def _by_turn(world: Array, b: int, h: float, begins: bool) -> Vector:
    """By what a body turns in the step that was tried, rad, in world axes; 0 between two steps."""
    bodies = bodies_at(world)
    i = bodies.numbers[b]
    if begins:
        return 0.0, 0.0, 0.0
    if bodies.kinds[b] == DRIVEN:
        x, y, z = vector(driven_at(world).step[i], SPIN)
    else:
        x, y, z = rotated(rows_of(rigid_at(world).rotation[i]), vector(freedoms_at(world).tries[i, 3], 0))
    return h * x, h * y, h * z


@jit_part
def _mean(world: Array, b: int, h: float, begins: bool) -> Rotation:
    """(R + R⁺)/2 of a body in that step; R between two."""
    bodies = bodies_at(world)
    i = bodies.numbers[b]
    if bodies.kinds[b] == DRIVEN:
        if begins:
            return rotation_of(*rotation_in(driven_at(world).start[i]))
        return rows_in(driven_at(world).step[i], MEAN)
    R = rows_of(rigid_at(world).rotation[i])
    return R if begins else _mean_rotation(R, h, vector(freedoms_at(world).tries[i, 3], 0))


@jit_apart
def look(world: Array, h: float, begins: bool) -> float:
    """Has directions be those of the last try, or between two steps: by how much that changes one, at most."""
    rows, joined, changed = rows_at(world), joined_at(world), 0.0
    for e in range(len(rows.pairs)):
        kind, D = rows.kinds[e], rows.D[e]
        if kind in (FOLLOWING, FIXED) or (kind == AT_START and not begins):
            continue
        one, other = joined.ends[rows.pairs[e]]
        x, y, z = rotated(_mean(world, one, h, begins), vector(rows.basis[e], 0))
        if kind == TURNING:
            turns = _by_turn(world, one, h, begins), _by_turn(world, other, h, begins)
            x, y, z = _turning_along((x, y, z), turns[0], turns[1])
        sign = -1.0 if kind in (ALONG, TURNING) else 1.0
        for k, d in enumerate((sign * x, sign * y, sign * z)):
            changed = max(changed, abs(D[k] - d))
            D[k] = d
    for e in range(len(rows.pairs)):
        if rows.kinds[e] == FOLLOWING:
            x, y, z = vector(rows.D[rows.leaders[e]], 0)
            share = rows.basis[e, 0]
            put(rows.D[e], 0, (share * x, share * y, share * z))
    return changed


@jit_part
def speed_of(rows: Rows, row: int, u: Array) -> float:
    """That of a row, of velocities (J, 3) of points of joints."""
    s = 0.0
    for e in range(rows.begins[row], rows.begins[row + 1]):
        s += dot(vector(rows.D[e], 0), vector(u[rows.pairs[e]], 0))
    return s


@jit_part
def set_forces(rows: Rows, z: Array, forces: Array) -> None:
    """Sets forces (J, 3) on the first bodies, of forces (R,) of rows."""
    fill(forces, 0.0)
    for row in range(len(z)):
        if z[row] != 0.0:
            for e in range(rows.begins[row], rows.begins[row + 1]):
                for k in range(3):
                    forces[rows.pairs[e], k] += z[row] * rows.D[e, k]


@jit_apart
def begin_rows(world: Array, C: int, h: float) -> None:
    """Begins a step, of which pairs are set: laws of drives."""
    rows, before = rows_at(world), near_at(world).before[C:]
    look(world, h, True)
    fill(rows.numbers[HELD], 1.0)
    for k in (COMPLIANCE, TARGET_SPEED, KNOWN):
        fill(rows.numbers[k], 0.0)
    for q in range(len(rows.driven)):
        a = speed_of(rows, rows.driven[q], before)
        pieces, on = rows.pieces[q], rows.on[q]
        count = set_law(rows.drives[q], rows.states[q], a, h, pieces)
        if count != on[0]:
            on[0], on[1] = count, count - 1
            for k in range(count - 1, -1, -1):
                if a <= pieces[k, END]:
                    on[1] = k
        _go_to_piece(rows, q)


@jit_part
def _go_to_piece(rows: Rows, q: int) -> None:
    """Has a drive be on a piece of its law."""
    piece, row = rows.pieces[q, rows.on[q, 1]], rows.driven[q]
    numbers, slope, is_steep = rows.numbers, piece[SLOPE], piece[IS_STEEP] > 0
    numbers[HELD, row] = 1.0 if is_steep or slope > 0 else 0.0
    numbers[COMPLIANCE, row] = numbers[TARGET_SPEED, row] = numbers[KNOWN, row] = 0.0
    if is_steep:
        numbers[TARGET_SPEED, row] = piece[BEGIN]
    elif slope > 0:
        numbers[COMPLIANCE, row], numbers[TARGET_SPEED, row] = 1 / slope, piece[AT_ZERO] / slope
    else:
        numbers[KNOWN, row] = piece[AT_ZERO]


@jit_apart
def settle(world: Array, u: Array, z: Array, changes: int) -> int:
    """How many changes of pieces there were in a try, in which u (J, 3) and z (R,) were found after some.

    As many as before where all drives are on the pieces of these; -1 where there are too many.
    """
    rows = rows_at(world)
    Q, fastest, largest, begun = len(rows.driven), 0.0, 0.0, changes
    for j in range(len(u)):
        for k in range(3):
            fastest = max(fastest, abs(u[j, k]))
    for row in range(len(z)):
        largest = max(largest, abs(z[row]))
    fastest, largest = MISSES * fastest, MISSES * largest
    for q in range(Q):
        row, on = rows.driven[q], rows.on[q, 1]
        piece, to = rows.pieces[q, on], on
        if piece[IS_STEEP] > 0:
            if z[row] > piece[TOP] + largest:
                to -= 1
            elif z[row] < piece[BOTTOM] - largest:
                to += 1
        else:
            s = speed_of(rows, row, u)
            if s < piece[BEGIN] - fastest:
                to -= 1
            elif s > piece[END] + fastest:
                to += 1
        if to == on:
            continue
        changes += 1
        if changes > MOST_CHANGES * (1 + Q):
            return -1
        rows.on[q, 1] = to
        _go_to_piece(rows, q)
        if changes > MOST_CHANGES * Q / 2 and changes > begun:
            break
    return changes


@jit_apart
def end_rows(world: Array, C: int, h: float, met: Array) -> None:
    """Ends a step of h s: drives go on, and what they did is told, J, as of `Owed.met`."""
    rows, u = rows_at(world), near_at(world).u[C:]
    for q in range(len(rows.driven)):
        row, drive, state = rows.driven[q], rows.drives[q], rows.states[q]
        s, z = speed_of(rows, row, u), rows.numbers[FORCE, row]
        pushed = motor_force(drive, state, h, s)
        rotor = 2 * s - state[ROTOR] if drive[ARMATURE] > 0 else 0.0
        position = state[POSITION] + h * s
        gained = stored(drive, position, rotor) - stored(drive, state[POSITION], state[ROTOR])
        met[BY_MOTORS] += h * pushed * s
        met[BY_JOINTS] += h * (pushed - z) * s - gained
        met[NUMERICAL] += h * z * s
        state[POSITION], state[SPEED], state[ROTOR] = position, s, rotor
        state[BY_MOTOR], state[BY_ALL] = pushed, z


@jit_part
def is_at_limit(rows: Rows, q: int) -> bool:
    """Whether a limit stopped a drive in the last step."""
    piece = rows.pieces[q, rows.on[q, 1]]
    return bool(piece[IS_STEEP] > 0 and (piece[TOP] == np.inf or piece[BOTTOM] == -np.inf))
