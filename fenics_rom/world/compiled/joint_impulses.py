"""Impulses that stop what joints still move by when a step ends: `StepPairs.stop_joints`."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.mechanics.compiled.copying import add_row
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.frame_tables import state_at
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
from fenics_rom.world import turning
from fenics_rom.world.compiled.bodies import start_turning_of, start_velocity_at, times
from fenics_rom.world.compiled.couples import Turning, pushed_by, turned_by, turning_of
from fenics_rom.world.compiled.joints import factor_of, solve_held
from fenics_rom.world.compiled.rigid_bodies import rows_of, set_map, set_map_of_couple
from fenics_rom.world.compiled.soft_bodies import points_at
from fenics_rom.world.compiled.soft_kicks import kick_soft, velocities_between
from fenics_rom.world.compiled.tables import (
    BY_JOINTS,
    BY_OTHERS,
    DRIVEN,
    RIGID,
    SOFT,
    SUPPLIED,
    Joined,
    bodies_at,
    freedoms_at,
    is_soft,
    joined_at,
    rigid_at,
    softs_at,
)

transposed = jit_shared(turning.transposed)
REDUNDANT = 1e-12  # of the largest pivot: what joints hold twice


@jit_apart
def stop_joints(world: Array, works: Array, met: Array) -> None:
    """Stops them, and books what that takes: works (B, 3) of bodies and `Owed.met`, J.

    Joints of a body that takes no impulses go on as they move.
    """
    bodies, joined = bodies_at(world), joined_at(world)
    J = len(joined.ends)
    u = np.zeros((J, 3))
    for j in range(J):
        if joined.are_stopped[j]:
            put(u[j], 0, velocity_between(world, j))
    if not u.any():
        return
    W, impulses = np.zeros((3 * J, 3 * J)), np.empty((J, 3))
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == RIGID:
            _add_rigid(world, b, W)
        elif bodies.kinds[b] == SOFT:
            add_soft(world, b, W)
    solve_held(factor_of(W, REDUNDANT), -u.reshape(3 * J), impulses.reshape(3 * J))
    for b in range(len(bodies.kinds)):
        for j in range(J):
            if joined.ends[j, 0] == b or joined.ends[j, 1] == b:
                kick(world, b, impulses, works[b])
                break
    taken = 0.0
    for j in range(J):
        if joined.are_stopped[j]:
            left = velocity_between(world, j)
            taken -= dot(vector(impulses[j], 0), added(vector(u[j], 0), 1.0, left)) / 2
    met[BY_JOINTS] += taken


@jit_part
def velocity_between(world: Array, j: int) -> Vector:
    """Of the first body at a point of a joint relative to the second, when a step has ended, m/s."""
    joined, u = joined_at(world), (0.0, 0.0, 0.0)
    for side in range(2):
        b = joined.ends[j, side]
        u = added(u, 1.0 - 2 * side, _velocity_of(world, b, j, side))
    return u


@jit_part
def _velocity_of(world: Array, b: int, j: int, side: int) -> Vector:
    """Of one of the two bodies."""
    bodies, joined = bodies_at(world), joined_at(world)
    kind, index = bodies.kinds[b], bodies.numbers[b]
    if joined.couples[j] >= 0:
        return _turning_of(world, b, j)
    if is_soft(kind):
        v, table = (0.0, 0.0, 0.0), softs_at(world)[index]
        for k in range(joined.weights.shape[2]):
            if joined.weights[j, side, k] != 0.0:
                v = added(v, joined.weights[j, side, k], velocities_between(table, joined.nodes[j, side, k]))
        return v
    return start_velocity_at(world, kind, index, joined.arms[j, side])


@jit_part
def _turning_in(joined: Joined, j: int) -> Turning:
    return turning_of(joined, j, joined.arms_of_turning[joined.couples[j]])


@jit_part
def _turning_of(world: Array, b: int, j: int) -> Vector:
    """How one of the two bodies turns that a couple holds, rad/s."""
    bodies, joined, turning = bodies_at(world), joined_at(world), (0.0, 0.0, 0.0)
    kind, index = bodies.kinds[b], bodies.numbers[b]
    if not is_soft(kind):
        return start_turning_of(world, kind, index)
    of = _turning_in(joined, j)
    for n in range(len(of.nodes)):
        turning = added(turning, 1.0, turned_by(of, n, velocities_between(softs_at(world)[index], of.nodes[n])))
    return turning


@jit_part
def _add_rigid(world: Array, b: int, W: Array) -> None:
    """Adds the velocities (3J, 3J) per impulse of a rigid body, 1/kg."""
    joined, rigid, index = joined_at(world), rigid_at(world), bodies_at(world).numbers[b]
    R, maps = rows_of(rigid.rotation[index]), np.zeros((6, len(W)))
    for j in range(len(joined.ends)):
        for side in range(2):
            if joined.ends[j, side] == b and joined.are_stopped[j] and joined.couples[j] >= 0:
                set_map_of_couple(maps, 3 * j, 1.0 - 2 * side)
            elif joined.ends[j, side] == b and joined.are_stopped[j]:
                set_map(maps, 3 * j, 1.0 - 2 * side, rotated(R, vector(joined.arms[j, side], 0)))
    by_torque = times(R, transposed(times(R, rows_of(freedoms_at(world).inverse[index]))))
    for row in range(len(W)):
        for k in range(3):
            add_row(maps[k], maps[k, row] / rigid.mass[index], W[row])
            share = dot(by_torque[k], (maps[3, row], maps[4, row], maps[5, row]))
            add_row(maps[3 + k], share, W[row])


@jit_part
def add_soft(world: Array, b: int, W: Array) -> None:
    """The same of a soft body that is not free."""
    joined, table = joined_at(world), softs_at(world)[bodies_at(world).numbers[b]]
    rows, R = points_at(table).rows, rotation_of(*rotation_in(state_at(table).now[0]))
    moved = np.zeros((len(W), len(rows)))
    for j in range(len(joined.ends)):
        for side in range(2):
            if joined.ends[j, side] == b and joined.are_stopped[j]:
                for k in range(joined.weights.shape[2]):
                    share, p = (1.0 - 2 * side) * joined.weights[j, side, k], joined.nodes[j, side, k]
                    if share != 0.0:
                        for i in range(len(rows)):
                            x, y, z = rotated(R, vector(rows[i], 3 * p))
                            if joined.couples[j] >= 0:
                                x, y, z = turned_by(_turning_in(joined, j), k, (x, y, z))
                                share = 1.0
                            moved[3 * j, i] += share * x
                            moved[3 * j + 1, i] += share * y
                            moved[3 * j + 2, i] += share * z
    for row in range(len(W)):
        for column in range(len(W)):
            W[row, column] += moved[row].dot(moved[column])


@jit_part
def kick(world: Array, b: int, impulses: Array, works: Array) -> None:
    """Adds impulses (J, 3), N s, to a body, and what it gets to its works (3,), J."""
    bodies, joined = bodies_at(world), joined_at(world)
    kind, index, work = bodies.kinds[b], bodies.numbers[b], 0.0
    for j in range(len(joined.ends)):
        for side in range(2):
            if joined.ends[j, side] == b:
                work += (1.0 - 2 * side) * dot(vector(impulses[j], 0), _velocity_of(world, b, j, side))
    if kind == DRIVEN:
        works[BY_OTHERS] += work
        works[SUPPLIED] -= work
    elif kind == RIGID:
        works[BY_OTHERS] += _kick_rigid(world, b, impulses)
    elif kind == SOFT:
        table = softs_at(world)[index]
        at_nodes = np.zeros((len(points_at(table).rest), 3))
        for j in range(len(joined.ends)):
            for side in range(2):
                if joined.ends[j, side] == b:
                    for k in range(joined.weights.shape[2]):
                        to = at_nodes[joined.nodes[j, side, k]]
                        share, pushed = (1.0 - 2 * side) * joined.weights[j, side, k], vector(impulses[j], 0)
                        if joined.couples[j] >= 0:
                            share, pushed = 1.0, pushed_by(_turning_in(joined, j), k, pushed)
                        put(to, 0, added(vector(to, 0), share, pushed))
        gained = kick_soft(table, at_nodes)
        for j in range(len(joined.ends)):
            for side in range(2):
                if joined.ends[j, side] == b:
                    work += (1.0 - 2 * side) * dot(vector(impulses[j], 0), _velocity_of(world, b, j, side))
        works[BY_OTHERS] += work / 2
        works[SUPPLIED] += gained - work / 2


@jit_part
def _kick_rigid(world: Array, b: int, impulses: Array) -> float:
    """By how much that changes the energy of a rigid body, J."""
    joined, rigid, freedoms, index = joined_at(world), rigid_at(world), freedoms_at(world), bodies_at(world).numbers[b]
    motion, inverse = rigid.motion[index], rows_of(freedoms.inverse[index])
    R, inertia = rows_of(rigid.rotation[index]), rows_of(rigid.inertia[index])
    v, ω, L = vector(motion[1], 0), vector(motion[2], 0), vector(freedoms.momentum[index], 0)
    before = rigid.mass[index] * dot(v, v) + dot(ω, rotated(inertia, ω))
    for j in range(len(joined.ends)):
        for side in range(2):
            if joined.ends[j, side] == b:
                x, y, z = impulses[j]
                sign, arm = 1.0 - 2 * side, rotated(R, vector(joined.arms[j, side], 0))
                if joined.couples[j] >= 0:
                    L = added(L, sign, (x, y, z))
                else:
                    v = added(v, sign / rigid.mass[index], (x, y, z))
                    L = added(L, sign, cross(arm, (x, y, z)))
    ω = rotated(inverse, rotated_back(R, L))
    put(motion[1], 0, v)
    put(motion[2], 0, ω)
    put(freedoms.momentum[index], 0, L)
    return (rigid.mass[index] * dot(v, v) + dot(ω, rotated(inertia, ω)) - before) / 2
