"""Impulses that stop what rows of joints still move by when a step ends: `JointRows.stop`."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.runtime.compiled.frames import (
    added,
    cross,
    dot,
    put,
    rotated,
    rotated_back,
    rotation_in,
    rotation_of,
    vector,
)
from fenics_rom.world.compiled.bodies import times
from fenics_rom.world.compiled.joint_impulses import add_soft, kick, transposed, velocity_between
from fenics_rom.world.compiled.rigid_bodies import rows_of
from fenics_rom.world.compiled.row_maps import Maps, maps_of, set_couple, set_point
from fenics_rom.world.compiled.row_operators import factor_rows, set_rows, solve_all
from fenics_rom.world.compiled.row_tables import COMPLIANCE, HELD, TARGET_SPEED, Rows, rows_at
from fenics_rom.world.compiled.rows import is_at_limit, look, set_forces, speed_of, stored
from fenics_rom.world.compiled.tables import (
    BY_JOINTS,
    BY_OTHERS,
    DRIVEN,
    RIGID,
    SOFT,
    bodies_at,
    driven_at,
    freedoms_at,
    joined_at,
    rigid_at,
)
from fenics_rom.world.drive_law import ARMATURE, POSITION, ROTOR

REDUNDANT = 1e-12  # of a row's own: a pivot that is none


@jit_apart
def stop_rows(world: Array, h: float, works: Array, met: Array) -> None:
    """Stops them, and books what that takes: works (B, 3) of bodies and `Owed.met`, J.

    What touches a body that takes no impulses goes on as it moves.
    """
    bodies, joined, rows = bodies_at(world), joined_at(world), rows_at(world)
    J, R = len(joined.ends), rows.numbers.shape[1]
    for j in rows.slides:
        _meet(world, j)
    u = np.zeros((J, 3))
    for j in range(J):
        if joined.are_stopped[j]:
            put(u[j], 0, velocity_between(world, j))
    if not u.any():
        return
    look(world, h, True)
    _hold(rows, joined.are_stopped)
    maps = _maps(world, J)
    set_rows(world, maps, 0)
    factor_rows(world, maps, 0, REDUNDANT)
    impulses, forces = np.zeros(R), np.empty((J, 3))
    for row in range(R):
        if rows.numbers[HELD, row] != 0.0:
            impulses[row] = rows.numbers[TARGET_SPEED, row] - speed_of(rows, row, u)
    solve_all(world, impulses)
    set_forces(rows, impulses, forces)
    _kick_rigid(world, forces, works)
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == SOFT or bodies.kinds[b] == DRIVEN:
            kick(world, b, forces, works[b])
    for j in range(J):
        left = velocity_between(world, j) if joined.are_stopped[j] else (0.0, 0.0, 0.0)
        met[BY_JOINTS] -= dot(vector(forces[j], 0), added(vector(u[j], 0), 1.0, left)) / 2
    _turn_rotors(rows, impulses, met)


@jit_part
def _kick_rigid(world: Array, impulses: Array, works: Array) -> None:
    """Adds impulses (J, 3), N s, to all rigid bodies, and what they get to works (B, 3), J."""
    bodies, joined, rigid, freedoms = bodies_at(world), joined_at(world), rigid_at(world), freedoms_at(world)
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == RIGID:
            works[b, BY_OTHERS] -= _energy_of(world, bodies.numbers[b])
    for j in range(len(joined.ends)):
        x, y, z = impulses[j]
        for side in range(2):
            b, sign = joined.ends[j, side], 1.0 - 2 * side
            i = bodies.numbers[b]
            if bodies.kinds[b] != RIGID:
                continue
            v, L = rigid.motion[i, 1], freedoms.momentum[i]
            if joined.couples[j] >= 0:
                put(L, 0, added(vector(L, 0), sign, (x, y, z)))
            else:
                arm = rotated(rows_of(rigid.rotation[i]), vector(joined.arms[j, side], 0))
                put(v, 0, added(vector(v, 0), sign / rigid.mass[i], (x, y, z)))
                put(L, 0, added(vector(L, 0), sign, cross(arm, (x, y, z))))
    for b in range(len(bodies.kinds)):
        i = bodies.numbers[b]
        if bodies.kinds[b] == RIGID:
            spun = rotated_back(rows_of(rigid.rotation[i]), vector(freedoms.momentum[i], 0))
            put(rigid.motion[i, 2], 0, rotated(rows_of(freedoms.inverse[i]), spun))
            works[b, BY_OTHERS] += _energy_of(world, i)


@jit_part
def _energy_of(world: Array, i: int) -> float:
    """Of a rigid body that moves freely, J."""
    rigid = rigid_at(world)
    v, ω = vector(rigid.motion[i, 1], 0), vector(rigid.motion[i, 2], 0)
    return (rigid.mass[i] * dot(v, v) + dot(ω, rotated(rows_of(rigid.inertia[i]), ω))) / 2


@jit_part
def _meet(world: Array, j: int) -> None:
    """Has the first body be held where a sliding point of the second one is."""
    bodies, joined = bodies_at(world), joined_at(world)
    places = np.empty((2, 12))
    for side in range(2):
        b = joined.ends[j, side]
        i = bodies.numbers[b]
        if bodies.kinds[b] == DRIVEN:
            start = driven_at(world).start[i]
            put(places[side], 0, vector(start, 0))
            R = rotation_of(*rotation_in(start))
        else:
            put(places[side], 0, vector(rigid_at(world).motion[i, 0], 0))
            R = rows_of(rigid_at(world).rotation[i])
        for k in range(3):
            put(places[side], 3 + 3 * k, R[k])
    R, other = rows_of(places[0, 3:].reshape(3, 3)), rows_of(places[1, 3:].reshape(3, 3))
    place = added(vector(places[1], 0), 1.0, rotated(other, vector(joined.arms[j, 1], 0)))
    put(joined.arms[j, 0], 0, rotated_back(R, added(place, -1.0, vector(places[0], 0))))


@jit_part
def _hold(rows: Rows, are_stopped: Array) -> None:
    """Sets which rows are held: those of joints, where limits were hit, and with slack where there are rotors."""
    numbers = rows.numbers
    fill(numbers[HELD], 1.0)
    fill(numbers[COMPLIANCE], 0.0)
    fill(numbers[TARGET_SPEED], 0.0)
    for q in range(len(rows.driven)):
        row, inertia = rows.driven[q], rows.drives[q, ARMATURE]
        if is_at_limit(rows, q):
            continue
        if inertia > 0:
            numbers[COMPLIANCE, row], numbers[TARGET_SPEED, row] = 1 / inertia, rows.states[q, ROTOR]
        else:
            numbers[HELD, row] = 0.0
    for row in range(len(numbers[HELD])):
        for e in range(rows.begins[row], rows.begins[row + 1]):
            if not are_stopped[rows.pairs[e]] and (rows.D[e, 0] != 0 or rows.D[e, 1] != 0 or rows.D[e, 2] != 0):
                numbers[HELD, row] = 0.0


@jit_part
def _maps(world: Array, J: int) -> Maps:
    """Of all points of joints, of impulses."""
    bodies, joined, rigid, freedoms = bodies_at(world), joined_at(world), rigid_at(world), freedoms_at(world)
    some = False
    for b in range(len(bodies.kinds)):
        some = some or bodies.kinds[b] == SOFT
    Wᵀ = np.zeros((3 * J if some else 0, 3 * J if some else 0))
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == SOFT:
            add_soft(world, b, Wᵀ)
    maps = maps_of(world, 0, np.arange(J), Wᵀ)
    for b in range(len(rigid.mass)):
        R = rows_of(rigid.rotation[b])
        inverse = times(R, transposed(times(R, rows_of(freedoms.inverse[b]))))
        for i in range(3):
            maps.answers[b, i, i] = 1 / rigid.mass[b]
            for k in range(3):
                maps.answers[b, 3 + i, 3 + k] = inverse[i][k]
    for j in range(J):
        for side in range(2):
            b = bodies.numbers[joined.ends[j, side]] if bodies.kinds[joined.ends[j, side]] == RIGID else -1
            maps.rigid[j, side] = b
            if b < 0:
                continue
            if joined.couples[j] >= 0:
                set_couple(maps.motion[j, side])
            else:
                arm = rotated(rows_of(rigid.rotation[b]), vector(joined.arms[j, side], 0))
                set_point(maps.motion[j, side], arm)
            for m in range(3):
                for k in range(6):
                    maps.forced[j, side, m, k] = maps.motion[j, side, m, k]
    return maps


@jit_part
def _turn_rotors(rows: Rows, impulses: Array, met: Array) -> None:
    """Has rotors turn with their joints; where limits were hit they stand."""
    for q in range(len(rows.driven)):
        row, drive, state = rows.driven[q], rows.drives[q], rows.states[q]
        if drive[ARMATURE] > 0:
            before = stored(drive, state[POSITION], state[ROTOR])
            slack = rows.numbers[COMPLIANCE, row]
            state[ROTOR] = state[ROTOR] - slack * impulses[row] if slack > 0 else 0.0
            met[BY_JOINTS] += before - stored(drive, state[POSITION], state[ROTOR])
