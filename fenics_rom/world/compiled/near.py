"""Where bodies touch or are near in a step: points of soft bodies on rigid shapes; what else does is given."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.shapes import distance
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.frames import added, dot, put, rotated, rotated_back, vector
from fenics_rom.world.compiled.bodies import start_velocity_of_driven, start_velocity_of_rigid
from fenics_rom.world.compiled.soft_bodies import rows_in, step_at, velocities_at
from fenics_rom.world.compiled.tables import (
    DRIVEN,
    FRICTION,
    GIVEN,
    HELPED,
    NO_GAP,
    OF_FRICTION,
    OF_RESTITUTION,
    OF_RIGID,
    RESTITUTION,
    RIGID,
    SIZE,
    SOFT,
    SOFT_FIRST,
    SWUNG,
    bodies_at,
    driven_at,
    freedoms_at,
    given_at,
    kept_at,
    meetings_at,
    near_at,
    rigid_at,
    softs_at,
)
from fenics_rom.world.tolerances import NEAR


@jit
def look_at_margins(world: Array) -> bool:
    """Sets up to where contacts are looked for; whether some are to be given."""
    bodies, meetings, some = bodies_at(world), meetings_at(world), False
    for m in range(len(meetings.bodies)):
        a, b = meetings.bodies[m]
        one, other = bodies.travels[a], bodies.travels[b]
        whole = added(vector(one, 0), -1.0, vector(other, 0))
        margin = 2 * math.sqrt(dot(whole, whole)) + one[3] + other[3] + NEAR * meetings.numbers[m, SIZE]
        meetings.margins[m] = margin
        meetings.are_near[m] = 0.0
        if meetings.kinds[m] == GIVEN:
            between = added(vector(bodies.placed[a], 0), -1.0, vector(bodies.placed[b], 0))
            near = dot(between, between) <= (bodies.radii[a] + bodies.radii[b] + margin) ** 2
            near = near or bodies.kinds[a] == SOFT or bodies.kinds[b] == SOFT
            if near and math.isinf(bodies.radii[b]) and bodies.kinds[a] != SOFT:
                near = _height(bodies.placed[b], between) <= bodies.radii[a] + margin
            if near and math.isinf(bodies.radii[a]) and bodies.kinds[b] != SOFT:
                below = (-between[0], -between[1], -between[2])
                near = _height(bodies.placed[a], below) <= bodies.radii[b] + margin
            meetings.are_near[m] = 1.0 if near else 0.0
            some = some or near
    return some


@jit_part
def _height(placed: Array, between: Vector) -> float:
    """Over a half-space."""
    return placed[5] * between[0] + placed[8] * between[1] + placed[11] * between[2]


@jit
def find_near(world: Array, table: Array, h: float) -> int:
    """Sets the contacts of a step that all bodies have begun, with those of a table; how many, -1: too many."""
    meetings, given, kept, near = meetings_at(world), given_at(table), kept_at(world), near_at(world)
    C, g = int(0 * h), 0  # a 0 that is no constant, of which numba would compile what takes it by itself
    for m in range(len(meetings.bodies)):
        kind = meetings.kinds[m]
        if kind == GIVEN:
            first = meetings.slots[m]
            while g < len(given.meetings) and given.meetings[g] == m:
                if first == meetings.slots[m + 1]:
                    return -1
                near.features[C], near.slots[C] = given.features[g], first
                near.places[C], near.normals[C], near.gaps[C] = given.places[g], given.normals[g], given.gaps[g]
                near.nodes[C], near.weights[C] = given.nodes[g], given.weights[g]
                near.forces[C], near.numbers[C, SWUNG] = 0.0, 0.0
                for slot in range(meetings.slots[m], meetings.slots[m + 1]):
                    if kept.features[slot] == given.features[g]:
                        near.forces[C], near.numbers[C, SWUNG] = kept.forces[slot], kept.swung[slot]
                _set_meeting(world, m, C)
                C, g, first = C + 1, g + 1, first + 1
        else:
            C = _points_on_shape(world, m, h, C)
    look_at_start(world, C, h)
    for c in range(C):
        if abs(near.gaps[c]) < meetings.numbers[near.meetings[c], NO_GAP]:
            near.gaps[c] = 0.0
    return C


@jit_part
def _set_meeting(world: Array, m: int, c: int) -> None:
    """Sets what all contacts of a meeting have."""
    bodies, meetings, near = bodies_at(world), meetings_at(world), near_at(world)
    near.meetings[c] = m
    near.numbers[c, OF_RESTITUTION] = meetings.numbers[m, RESTITUTION]
    near.numbers[c, OF_FRICTION], near.numbers[c, HELPED] = meetings.numbers[m, FRICTION], 0.0
    near.are_rigid[c] = meetings.numbers[m, OF_RIGID]
    for side in range(2):
        body = meetings.bodies[m, side]
        near.ends[c, side] = body
        near.rigid[c, side] = bodies.numbers[body] if bodies.kinds[body] == RIGID else -1


@jit_part
def _points_on_shape(world: Array, m: int, h: float, C: int) -> int:
    """Adds the points of a soft body that are near to a rigid shape; how many contacts there are then."""
    bodies, meetings, kept, near = bodies_at(world), meetings_at(world), kept_at(world), near_at(world)
    side = 0 if meetings.kinds[m] == SOFT_FIRST else 1
    soft, rigid = meetings.bodies[m, side], meetings.bodies[m, 1 - side]
    step, placed, first = step_at(softs_at(world)[bodies.numbers[soft]]), bodies.placed[rigid], meetings.slots[m]
    R, centre, shape, margin, sign = (
        rows_in(placed, 3),
        vector(placed, 0),
        bodies.shapes[rigid],
        meetings.margins[m],
        1.0,
    )
    if side == 1:
        sign = -1.0
    n = np.empty(3)
    for p in range(len(step.places)):
        place = added(vector(step.places[p], 0), h / 2, vector(step.velocities[p], 0))
        local = rotated_back(R, added(place, -1.0, centre))
        gap = distance(shape, local[0], local[1], local[2], n)
        if not gap <= margin:
            continue
        x, y, z = rotated(R, vector(n, 0))
        near.features[C], near.slots[C], near.gaps[C] = p, first + p, gap
        put(near.places[C], 0, place)
        put(near.normals[C], 0, (sign * x, sign * y, sign * z))
        near.nodes[C], near.weights[C] = 0, 0.0
        near.nodes[C, side, 0], near.weights[C, side, 0] = p, 1.0
        near.forces[C], near.numbers[C, SWUNG] = 0.0, 0.0
        if kept.features[first + p] == p:
            near.forces[C], near.numbers[C, SWUNG] = kept.forces[first + p], kept.swung[first + p]
        _set_meeting(world, m, C)
        C += 1
    return C


@jit_part
def look_at_start(world: Array, C: int, h: float) -> None:
    """Sets relative velocities and gaps when the step begins, of gaps in its middle."""
    bodies, near, softs = bodies_at(world), near_at(world), softs_at(world)
    rigid, freedoms, driven = rigid_at(world), freedoms_at(world), driven_at(world)
    for c in range(C):
        u, gone, place = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), vector(near.places[c], 0)
        for side in range(2):
            body, sign = near.ends[c, side], 1.0 - 2 * side
            kind, index = bodies.kinds[body], bodies.numbers[body]
            if kind == RIGID:
                u = added(u, sign, start_velocity_of_rigid(rigid, index, place, vector(bodies.placed[body], 0)))
                gone = added(gone, sign * h * h / 4, vector(freedoms.acceleration[index], 0))
            elif kind == DRIVEN:
                u = added(u, sign, start_velocity_of_driven(driven, index, place))
            else:
                velocities = velocities_at(softs[index])
                for k in range(3):
                    share = sign * near.weights[c, side, k]
                    if share != 0.0:
                        u = added(u, share, vector(velocities[near.nodes[c, side, k]], 0))
        put(near.before[c], 0, u)
        near.gaps[c] -= dot(vector(near.normals[c], 0), added(gone, h / 2, u))
