"""Where bodies touch or are near in a step: points of soft bodies on rigid shapes; what else does is given."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy, copy_rows, fill
from fenics_rom.mechanics.compiled.shapes import distance
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.contact_points import lacks_rows
from fenics_rom.runtime.compiled.frames import added, cross, dot, put, rotated, rotated_back, vector
from fenics_rom.world.compiled.bodies import middle_of, start_velocity_of_driven, start_velocity_of_rigid
from fenics_rom.world.compiled.joint_points import set_joints
from fenics_rom.world.compiled.soft_bodies import SPUN, points_at, rows_in, step_at
from fenics_rom.world.compiled.soft_collision import NONE, find_nearest
from fenics_rom.world.compiled.tables import (
    DRIVEN,
    FREE,
    FRICTION,
    GIVEN,
    JOINED,
    NO_GAP,
    OF_FRICTION,
    OF_RESTITUTION,
    OF_RIGID,
    OUT,
    RESTITUTION,
    RIGID,
    SIZE,
    SOFT_BOTH,
    SOFT_FIRST,
    SWUNG,
    bodies_at,
    driven_at,
    freedoms_at,
    given_at,
    is_followed,
    is_soft,
    joined_at,
    kept_at,
    meetings_at,
    near_at,
    rigid_at,
    softs_at,
)
from fenics_rom.world.tolerances import NEAR


@jit_part
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
            near = near or is_soft(bodies.kinds[a]) or is_soft(bodies.kinds[b])
            if near and math.isinf(bodies.radii[b]) and not is_soft(bodies.kinds[a]):
                near = _height(bodies.placed[b], between) <= bodies.radii[a] + margin
            if near and math.isinf(bodies.radii[a]) and not is_soft(bodies.kinds[b]):
                below = (-between[0], -between[1], -between[2])
                near = _height(bodies.placed[a], below) <= bodies.radii[b] + margin
            meetings.are_near[m] = 1.0 if near else 0.0
            some = some or near
    return some


@jit_part
def _height(placed: Array, between: Vector) -> float:
    """Over a half-space."""
    return placed[5] * between[0] + placed[8] * between[1] + placed[11] * between[2]


@jit_part
def lack_rows(world: Array, C: int) -> bool:
    """Whether C contacts and joints need residual compliance of contact points that is not kept; it is noted."""
    bodies, near, softs, some = bodies_at(world), near_at(world), softs_at(world), False
    for c in range(C + len(joined_at(world).ends)):
        for side in range(2):
            b = near.ends[c, side]
            if is_soft(bodies.kinds[b]):
                points = points_at(softs[bodies.numbers[b]])
                for k in range(near.nodes.shape[2]):
                    some = (near.weights[c, side, k] != 0.0 and lacks_rows(points, near.nodes[c, side, k])) or some
    return some


@jit_part
def find_near(world: Array, table: Array, h: float) -> int:
    """Sets the contacts of a step that all bodies have begun, with those of a table; how many, -1: too many."""
    meetings, given, kept, near = meetings_at(world), given_at(table), kept_at(world), near_at(world)
    C, g = int(0 * h), 0  # a 0 that is no constant, of which numba would compile what takes it by itself
    for m in range(len(meetings.bodies)):
        kind, begun = meetings.kinds[m], C
        if kind == GIVEN and not meetings.are_near[m]:
            continue
        if kind == GIVEN:
            first = meetings.slots[m]
            while g < len(given.meetings) and given.meetings[g] == m:
                if first == meetings.slots[m + 1]:
                    return -1
                near.features[C], near.slots[C] = given.features[g], first
                near.gaps[C] = given.gaps[g]
                copy(given.places[g], near.places[C])
                copy(given.normals[g], near.normals[C])
                copy_rows(given.nodes[g], near.nodes[C])
                fill(near.weights[C], 0.0)
                copy_rows(given.weights[g], near.weights[C])
                near.numbers[C, SWUNG] = 0.0
                put(near.forces[C], 0, (0.0, 0.0, 0.0))
                for slot in range(meetings.slots[m], meetings.slots[m + 1]):
                    if kept.features[slot] == given.features[g]:
                        near.numbers[C, SWUNG] = kept.swung[slot]
                        copy(kept.forces[slot], near.forces[C])
                C, g, first = C + 1, g + 1, first + 1
        elif kind == SOFT_BOTH:
            C = _points_on_surface(world, m, h, 1, _points_on_surface(world, m, h, 0, C))
        elif kind != JOINED:
            C = _points_on_shape(world, m, h, C)
        _set_meeting(world, m, begun, C)
    look_at_start(world, C, h)
    if len(joined_at(world).ends):
        set_joints(world, C, h)
    for c in range(C):
        if abs(near.gaps[c]) < meetings.numbers[near.meetings[c], NO_GAP]:
            near.gaps[c] = 0.0
    return C


@jit_part
def _set_meeting(world: Array, m: int, first: int, C: int) -> None:
    """Sets what all contacts of a meeting have, from the first on, and the forces that they begin with.

    These are those of the step before; contacts that are given have theirs.
    """
    bodies, meetings, near, kept = bodies_at(world), meetings_at(world), near_at(world), kept_at(world)
    one, other = meetings.bodies[m]
    first_rigid = bodies.numbers[one] if bodies.kinds[one] == RIGID else -1
    second_rigid = bodies.numbers[other] if bodies.kinds[other] == RIGID else -1
    for c in range(first, C):
        near.meetings[c] = m
        near.numbers[c, OF_RESTITUTION] = meetings.numbers[m, RESTITUTION]
        near.numbers[c, OF_FRICTION], near.numbers[c, OUT] = meetings.numbers[m, FRICTION], 0.0
        near.are_rigid[c] = meetings.numbers[m, OF_RIGID]
        near.ends[c, 0], near.ends[c, 1] = one, other
        near.rigid[c, 0], near.rigid[c, 1] = first_rigid, second_rigid
        if meetings.kinds[m] != GIVEN:
            slot = near.slots[c]
            is_known = kept.features[slot] == near.features[c]
            near.numbers[c, SWUNG] = kept.swung[slot] if is_known else 0.0
            put(near.forces[c], 0, vector(kept.forces[slot], 0) if is_known else (0.0, 0.0, 0.0))


@jit_apart
def _points_on_shape(world: Array, m: int, h: float, C: int) -> int:
    """Adds the points of a soft body that are near to a rigid shape; how many contacts there are then."""
    bodies, meetings, near = bodies_at(world), meetings_at(world), near_at(world)
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
        _set_node(near.nodes[C], near.weights[C], side, p)
        C += 1
    return C


@jit_apart
def _points_on_surface(world: Array, m: int, h: float, side: int, C: int) -> int:
    """Adds the points of one of two soft bodies that are near to the other; how many contacts there are then."""
    bodies, meetings, near = bodies_at(world), meetings_at(world), near_at(world)
    softs, one, other = softs_at(world), meetings.bodies[m, side], meetings.bodies[m, 1 - side]
    step, surface = step_at(softs[bodies.numbers[one]]), step_at(softs[bodies.numbers[other]])
    points, corners = step.places + h / 2 * step.velocities, surface.places + h / 2 * surface.velocities
    P, c, sign = len(points), surface.nodes.shape[1], 1.0 - 2 * side
    before = len(corners) if side == 1 else 0  # points of the first are counted first
    on, carriers, weights = np.empty(P, dtype=np.int64), np.empty((P, c), dtype=np.int64), np.empty((P, c))
    normals, gaps = np.empty((P, 3)), np.empty(P)
    found = meetings.margins[m], on, carriers, weights, normals, gaps
    find_nearest(points, corners, surface.triangles, surface.radii, surface.nodes, surface.around, *found)
    for p in range(P):
        if on[p] == NONE:
            continue
        near.features[C], near.slots[C] = before + p, meetings.slots[m] + before + p
        near.gaps[C], place = gaps[p], vector(points[p], 0)
        put(near.normals[C], 0, (sign * normals[p, 0], sign * normals[p, 1], sign * normals[p, 2]))
        _set_node(near.nodes[C], near.weights[C], side, p)
        if side == 1:
            place = (0.0, 0.0, 0.0)  # that of the first body
        for k in range(c):
            carrier, share = carriers[p, k], weights[p, k]
            near.nodes[C, 1 - side, k], near.weights[C, 1 - side, k] = carrier, share
            if side == 1:
                place = added(place, share, vector(corners[carrier], 0))
        put(near.places[C], 0, place)
        C += 1
    return C


@jit_part
def _set_node(nodes: Array, weights: Array, side: int, p: int) -> None:
    """Sets which point of a soft body a contact is at, on one of its sides, (2, c) each."""
    fill(weights, 0.0)
    nodes[side, 0], weights[side, 0] = p, 1.0


@jit_part
def look_at_start(world: Array, C: int, h: float) -> None:
    """Sets relative velocities and gaps of C contacts when the step begins, of gaps in its middle."""
    bodies, near, softs = bodies_at(world), near_at(world), softs_at(world)
    rigid, freedoms, driven = rigid_at(world), freedoms_at(world), driven_at(world)
    for c in range(C):
        u, gone, place = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), vector(near.places[c], 0)
        for side in range(2):
            body, sign = near.ends[c, side], 1.0 - 2 * side
            kind, index = bodies.kinds[body], bodies.numbers[body]
            if kind == RIGID:
                u = added(u, sign, start_velocity_of_rigid(rigid, index, place, middle_of(rigid, freedoms, h, index)))
                gone = added(gone, sign * h * h / 4, vector(freedoms.acceleration[index], 0))
            elif kind == DRIVEN:
                u = added(u, sign, start_velocity_of_driven(driven, index, place))
            else:
                step, off = step_at(softs[index]), place
                for k in range(near.weights.shape[2]):
                    share, p = near.weights[c, side, k], near.nodes[c, side, k]
                    if share != 0.0:
                        v = vector(step.velocities[p], 0)
                        u, off = (
                            added(u, sign * share, v),
                            added(added(off, -share, vector(step.places[p], 0)), -h / 2 * share, v),
                        )
                if kind == FREE and is_followed(bodies, near, c, side):
                    u = added(u, sign, cross(vector(step.turn, SPUN), off))
        put(near.before[c], 0, u)
        near.gaps[c] -= dot(vector(near.normals[c], 0), added(gone, h / 2, u))
