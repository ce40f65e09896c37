"""A step of a world, whole: bodies begin it, it is found where they touch and by what forces, and they end it."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.braking import SWINGS
from fenics_rom.mechanics.compiled.contact_law import FOUND, Law
from fenics_rom.mechanics.compiled.copying import copy_rows, fill
from fenics_rom.runtime.compiled.frames import added, dot, length, put, vector
from fenics_rom.world.compiled.bodies import (
    begin_driven,
    begin_rigid,
    end_driven,
    end_rigid,
    velocity_of_driven,
    velocity_of_driven_at,
)
from fenics_rom.world.compiled.couples import couple_of
from fenics_rom.world.compiled.forces import Found, find_forces
from fenics_rom.world.compiled.free_bodies import begin_bent_free, begin_free, end_bent_free, end_free, undo_free
from fenics_rom.world.compiled.joint_impulses import stop_joints
from fenics_rom.world.compiled.letting_out import leave_in, overdraws, set_speeds_out
from fenics_rom.world.compiled.near import find_near, lack_rows, look_at_margins
from fenics_rom.world.compiled.operators import be_ready
from fenics_rom.world.compiled.pulled_bodies import end_pulled
from fenics_rom.world.compiled.row_impulses import stop_rows
from fenics_rom.world.compiled.row_tables import rows_at
from fenics_rom.world.compiled.rows import end_rows
from fenics_rom.world.compiled.soft_bodies import (
    BY_OTHERS,
    DISSIPATED,
    SUPPLIED,
    begin_bent,
    begin_relaxing,
    begin_soft,
    bends,
    end_bent,
    end_relaxing,
    end_soft,
    is_pulled,
    mount_on,
    relaxes,
    step_at,
)
from fenics_rom.world.compiled.tables import (
    BY_FRICTION,
    BY_IMPACTS,
    DRIVEN,
    FREE,
    FRICTION,
    HELPED,
    NUMERICAL,
    POWER,
    RIGID,
    SIZE,
    SLIDES,
    SOFT,
    SPIN,
    SWUNG,
    bodies_at,
    driven_at,
    freedoms_at,
    joined_at,
    kept_at,
    meetings_at,
    near_at,
    owed_at,
    rigid_at,
    softs_at,
)
from fenics_rom.world.tolerances import LARGEST, SWERVES

LARGEST_SPEED = 1e100  # m/s: beyond it works overflow
OTHERWISE, NEEDS_CONTACTS, NEEDS_ROWS = -1, -2, -3  # in place of how many contacts there are


@jit_part
def take_step(world: Array, given: Array, h: float, row: int, goes_on: bool, free: bool) -> tuple[int, int]:
    """Takes a step of h s: how many contacts it has, and the sweeps that found their forces.

    Args:
        world: whose inputs and bases are set.
        given: table of contacts that are found elsewhere.
        h: s.
        row: of what is booked, for its works.
        goes_on: whether it has begun, and these contacts are known; the others, too, where none are needed.
        free: as of `find_forces`.

    Returns:
        OTHERWISE: the step is to be taken otherwise, and nothing is changed but what was begun. NEEDS_CONTACTS,
        NEEDS_ROWS: it has begun, and goes on with these contacts, or once rows of residual compliance are kept.
    """
    if not goes_on:
        if not _begin_step(world, h):
            return OTHERWISE, 0
        if row == 0:
            be_ready(world, h)
        if look_at_margins(world):
            return NEEDS_CONTACTS, 0
    C = find_near(world, given, h)
    if C < 0:
        return OTHERWISE, 0
    if lack_rows(world, C):
        return NEEDS_ROWS, 0
    law, start = _law_of(world, h), near_at(world).forces[: C + len(joined_at(world).ends)].copy()
    found = find_forces(world, C, law, free)
    if not _is_to_be_taken(world, C, found, h):
        return OTHERWISE, 0
    if set_speeds_out(world, C, h):
        found = find_forces(world, C, law, free)
        if found.status == FOUND and overdraws(world, C, h):
            copy_rows(start, near_at(world).forces)
            leave_in(world, C)
            found = find_forces(world, C, law, free)
    if not (found.status == FOUND and _end_step(world, C, h, row, free)):
        return OTHERWISE, 0
    if len(rows_at(world).bodies):
        stop_rows(world, h, owed_at(world).bodies[row], owed_at(world).met[row])
    elif len(joined_at(world).ends):
        stop_joints(world, owed_at(world).bodies[row], owed_at(world).met[row])
    return C, found.sweeps


@jit_part
def _law_of(world: Array, h: float) -> Law:
    meetings, friction = meetings_at(world), 0.0
    for m in range(len(meetings.numbers)):
        friction = max(friction, meetings.numbers[m, FRICTION])
    return Law(h, 0.0, friction, 0.0, 0.0, False, SWINGS, math.inf)


@jit_part
def _begin_step(world: Array, h: float) -> bool:
    """Begins the step of all bodies, whose inputs and bases are set; whether they could."""
    bodies, softs, rigid, freedoms = bodies_at(world), softs_at(world), rigid_at(world), freedoms_at(world)
    driven = driven_at(world)
    for kind in (DRIVEN, RIGID, SOFT, FREE):  # who carries is first
        for b in range(len(bodies.kinds)):
            index, placed, travel, could = bodies.numbers[b], bodies.placed[b], bodies.travels[b], True
            if bodies.kinds[b] != kind:
                continue
            if kind == RIGID:
                could = begin_rigid(rigid, freedoms, h, index, placed, travel)
            elif kind == DRIVEN:
                could = begin_driven(driven, h, index, placed, travel)
            elif kind == FREE and bends(softs[index]):
                could = begin_bent_free(softs[index], h, travel)
            elif kind == FREE:
                could = begin_free(softs[index], h, travel)
            else:
                carrier = bodies.carriers[index]
                if carrier >= 0:
                    mount_on(driven.end[carrier], softs[index])
                if bends(softs[index]):
                    could = begin_bent(softs[index], h, travel)
                elif relaxes(softs[index]):
                    could = begin_relaxing(softs[index], h, travel)
                else:
                    could = begin_soft(softs[index], h, travel)
            if not could:
                return False
    return True


@jit_part
def _is_to_be_taken(world: Array, C: int, found: Found, h: float) -> bool:
    """Whether bodies may end the step under the forces that were found."""
    return found.status == FOUND and found.scale <= LARGEST_SPEED and not _lacks_contacts(world, C, h)


@jit_part
def _lacks_contacts(world: Array, C: int, h: float) -> bool:
    """Whether some bodies go much farther than what was looked for is near: see `StepPairs.lacks_pairs`."""
    bodies, near, meetings = bodies_at(world), near_at(world), meetings_at(world)
    rigid, freedoms = rigid_at(world), freedoms_at(world)
    fastest, least = 0.0, np.inf
    for c in range(C + len(joined_at(world).ends)):
        for k in range(3):
            fastest = max(fastest, abs(near.u[c, k] - near.before[c, k]))
    for m in range(len(meetings.numbers)):
        least = min(least, meetings.numbers[m, SIZE])
    if C == 0 or h * fastest <= SWERVES * least:
        return False
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == RIGID:
            i = bodies.numbers[b]
            tried, now, size = freedoms.tries[i], rigid.motion[i], freedoms.size[i]
            whole = added(vector(tried[2], 0), -1.0, vector(now[1], 0))
            beside = added(vector(tried[3], 0), -1.0, vector(now[2], 0))
            if h * (length(whole) + length(beside) * size) > SWERVES * min(size, LARGEST) + bodies.travels[b, 3]:
                return True
    return False


@jit_part
def _end_step(world: Array, C: int, h: float, row: int, free: bool) -> bool:
    """Ends the step of all bodies under the forces that were found of C contacts; tells works in a row.

    Whether they could; if not, nothing is changed.
    """
    if free and not _end_free_bodies(world, h):
        return False
    _keep(world, C, h, row)
    if len(rows_at(world).bodies):
        end_rows(world, C, h, owed_at(world).met[row])
    bodies, works, driven, softs = bodies_at(world), owed_at(world).bodies[row], driven_at(world), softs_at(world)
    _look_at_power(world, C)
    for b in range(len(bodies.kinds)):
        kind, index = bodies.kinds[b], bodies.numbers[b]
        if kind == RIGID:
            of_rigid = np.empty(2)
            end_rigid(rigid_at(world), freedoms_at(world), h, index, of_rigid)
            works[b, 0], works[b, 1], works[b, 2] = of_rigid[0], 0.0, of_rigid[1]
        elif kind == DRIVEN:
            power = h * driven.step[index, POWER]
            works[b, 0], works[b, 1], works[b, 2] = -power, 0.0, power
            end_driven(driven, index)
        else:
            table = softs[index]
            if kind == SOFT and bends(table):
                end_bent(table, h)
            elif kind == SOFT and relaxes(table):
                end_relaxing(table, h)
            elif kind == SOFT:
                end_soft(table, h)
            if kind == SOFT and is_pulled(table):
                end_pulled(table, h)
            told = step_at(table).told
            works[b, 0], works[b, 1], works[b, 2] = told[SUPPLIED], told[DISSIPATED], told[BY_OTHERS]
    return True


@jit_part
def _end_free_bodies(world: Array, h: float) -> bool:
    """Ends the step of those that are soft and free; if one of them cannot, all are where they were."""
    bodies, softs = bodies_at(world), softs_at(world)
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] != FREE:
            continue
        table = softs[bodies.numbers[b]]
        if not (end_bent_free(table, h) if bends(table) else end_free(table, h)):
            for before in range(b):
                if bodies.kinds[before] == FREE:
                    undo_free(softs[bodies.numbers[before]])
            return False
    return True


@jit_part
def _look_at_power(world: Array, C: int) -> None:
    """Sets that of forces on bodies that are driven."""
    bodies, near, driven = bodies_at(world), near_at(world), driven_at(world)
    for c in range(C + len(joined_at(world).ends)):
        f = vector(near.forces[c], 0)
        for side in range(2):
            body = near.ends[c, side]
            if bodies.kinds[body] == DRIVEN and dot(f, f) > 0:
                d = bodies.numbers[body]
                if couple_of(near.meetings, near.features, c) >= 0:
                    v = vector(driven.step[d], SPIN)
                elif c < C or (side == 0 and near.features[c] == SLIDES):
                    v = velocity_of_driven(driven, d, vector(near.places[c], 0))
                else:
                    v = velocity_of_driven_at(driven, d, vector(near.arms[c, side], 0))
                driven.step[d, POWER] += (1.0 - 2 * side) * dot(f, v)


@jit
def force_on(world: Array, C: int, first: int, second: int) -> Array:
    """By which the second of two bodies pushed the first in a step with C contacts, (3,), N; joints are among them."""
    near, couples, force = near_at(world), joined_at(world).couples, np.zeros(3)
    for c in range(C + len(couples)):
        one, other = near.ends[c, 0], near.ends[c, 1]
        if c < C or couples[c - C] < 0:
            sign = 1.0 if one == first and other == second else 0.0
            sign -= 1.0 if one == second and other == first else 0.0
            for k in range(3):
                force[k] += sign * near.forces[c, k]
    return force


@jit
def count_pushing(forces: Array, normals: Array) -> int:
    """How many of C forces (C, 3) push, by more than round-off."""
    most, count = 0.0, 0
    for c in range(len(forces)):
        most = max(most, dot(vector(forces[c], 0), vector(normals[c], 0)))
    for c in range(len(forces)):
        count += dot(vector(forces[c], 0), vector(normals[c], 0)) > 1e-9 * most
    return count


@jit_part
def _keep(world: Array, C: int, h: float, row: int) -> None:
    """Keeps what the next step begins with; tells what impacts and friction dissipated in a row, J."""
    kept, near, joined, met = kept_at(world), near_at(world), joined_at(world), owed_at(world).met[row]
    for slot in range(len(kept.features)):
        kept.features[slot] = -1
    fill(met, 0.0)
    for j in range(len(joined.forces)):
        f = vector(near.forces[C + j], 0)
        put(joined.forces[j], 0, f)
        met[NUMERICAL] -= h * dot(f, vector(near.u[C + j], 0))
    for c in range(C):
        slot, f, u = near.slots[c], vector(near.forces[c], 0), vector(near.u[c], 0)
        kept.features[slot] = near.features[c]
        put(kept.forces[slot], 0, f)
        is_helped = near.numbers[c, HELPED] != 0.0
        near.numbers[c, SWUNG] = min(near.numbers[c, SWUNG], SWINGS) + 1 if is_helped else 0.0
        kept.swung[slot] = near.numbers[c, SWUNG]
        n = vector(near.normals[c], 0)
        whole, normal = dot(f, u), dot(n, f) * dot(n, u)
        met[BY_IMPACTS] -= h * normal
        met[BY_FRICTION] += h * (normal - whole)
        kept.dissipated[near.meetings[c]] -= h * whole
