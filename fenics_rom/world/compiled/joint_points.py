"""Points of joints in a step: pairs after those of contacts, and how they move when it begins."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy_rows
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.frames import (
    added,
    cross,
    put,
    rotated,
    rotated_back,
    rotation_in,
    rotation_of,
    vector,
)
from fenics_rom.world.compiled.bodies import (
    middle_of,
    start_turning_of,
    start_velocity_at,
    start_velocity_of_driven,
    start_velocity_of_rigid,
)
from fenics_rom.world.compiled.couples import look_at_turning, turned_by, turning_of
from fenics_rom.world.compiled.rigid_bodies import rows_of
from fenics_rom.world.compiled.row_tables import rows_at
from fenics_rom.world.compiled.rows import begin_rows
from fenics_rom.world.compiled.soft_bodies import START, points_at, rows_in, step_at
from fenics_rom.world.compiled.tables import (
    DRIVEN,
    FREE,
    MEAN,
    MIDDLE,
    OF_JOINT,
    RIGID,
    SLIDES,
    bodies_at,
    driven_at,
    freedoms_at,
    is_soft,
    joined_at,
    kept_at,
    near_at,
    rigid_at,
    softs_at,
)


@jit_apart
def set_joints(world: Array, C: int, h: float) -> None:
    """Adds points of joints to C contacts, with the forces of the step before."""
    bodies, near, joined, first = bodies_at(world), near_at(world), joined_at(world), len(kept_at(world).features)
    for j in range(len(joined.ends)):
        c, u = C + j, (0.0, 0.0, 0.0)
        near.meetings[c], near.slots[c], near.features[c] = OF_JOINT, first + j, joined.couples[j]
        copy_rows(joined.nodes[j], near.nodes[c])
        copy_rows(joined.weights[j], near.weights[c])
        copy_rows(joined.arms[j], near.arms[c])
        put(near.forces[c], 0, vector(joined.forces[j], 0))
        if joined.couples[j] >= 0 and is_soft(bodies.kinds[joined.ends[j, 0]]):
            _look_at_surface(world, j, h)
        for side in range(2):
            body = joined.ends[j, side]
            near.ends[c, side] = body
            near.rigid[c, side] = bodies.numbers[body] if bodies.kinds[body] == RIGID else -1
            moving = _turning_at_start(world, j, body) if joined.couples[j] >= 0 else _start_velocity(world, j, side)
            u = added(u, 1.0 - 2 * side, moving)
        if joined.couples[j] == SLIDES:
            u = _begin_to_slide(world, c, j, h)
        put(near.before[c], 0, u)
    if len(rows_at(world).bodies):
        begin_rows(world, C, h)


@jit_part
def _begin_to_slide(world: Array, c: int, j: int, h: float) -> Vector:
    """Sets where a sliding point is expected, where the first body is pushed; relative velocity there, m/s."""
    bodies, near, joined, rigid, driven = (
        bodies_at(world),
        near_at(world),
        joined_at(world),
        rigid_at(world),
        driven_at(world),
    )
    one, other, arm = joined.ends[j, 0], joined.ends[j, 1], vector(joined.arms[j, 1], 0)
    i, k = bodies.numbers[one], bodies.numbers[other]
    v = start_velocity_at(world, bodies.kinds[other], k, joined.arms[j, 1])
    if bodies.kinds[other] == DRIVEN:
        R, middle = rotation_of(*rotation_in(driven.start[k])), vector(driven.step[k], MIDDLE)
    else:
        R, middle = rows_of(rigid.rotation[k]), middle_of(rigid, freedoms_at(world), h, k)
    arm = rotated(R, arm)
    turns = start_turning_of(world, bodies.kinds[other], k)
    place = added(added(middle, 1.0, arm), h / 2, cross(turns, arm))
    put(near.places[c], 0, place)
    if bodies.kinds[one] == DRIVEN:
        return added(start_velocity_of_driven(driven, i, place), -1.0, v)
    v_one = start_velocity_of_rigid(rigid, i, place, middle_of(rigid, freedoms_at(world), h, i))
    if bodies.kinds[other] == DRIVEN:  # whose way is known
        R = rows_in(driven.step[k], MEAN)
        put(near.places[c], 0, added(middle, 1.0, rotated(R, vector(joined.arms[j, 1], 0))))
    return added(v_one, -1.0, v)


@jit_part
def _look_at_surface(world: Array, j: int, h: float) -> None:
    """Sets how the nodes of a surface lie that a couple holds: in the middle of the step, or in a free body's frame."""
    bodies, joined = bodies_at(world), joined_at(world)
    body, of = joined.ends[j, 0], turning_of(joined, j, joined.arms_of_turning[joined.couples[j]])
    table = softs_at(world)[bodies.numbers[body]]
    if bodies.kinds[body] == FREE:
        look_at_turning(of, points_at(table).start)
    else:
        step = step_at(table)
        look_at_turning(of, step.places + h / 2 * step.velocities)


@jit_part
def _start_velocity(world: Array, j: int, side: int) -> Vector:
    """Of a point of one of the two bodies."""
    bodies, joined = bodies_at(world), joined_at(world)
    body = joined.ends[j, side]
    kind, index = bodies.kinds[body], bodies.numbers[body]
    if not is_soft(kind):
        return start_velocity_at(world, kind, index, joined.arms[j, side])
    v, step = (0.0, 0.0, 0.0), step_at(softs_at(world)[index])
    for k in range(joined.weights.shape[2]):
        share = joined.weights[j, side, k]
        if share != 0.0:
            v = added(v, share, vector(step.velocities[joined.nodes[j, side, k]], 0))
    return v


@jit_part
def _turning_at_start(world: Array, j: int, body: int) -> Vector:
    """How a body turns where a couple holds it, rad/s."""
    bodies, joined, turning = bodies_at(world), joined_at(world), (0.0, 0.0, 0.0)
    kind, index = bodies.kinds[body], bodies.numbers[body]
    if not is_soft(kind):
        return start_turning_of(world, kind, index)
    step, of = step_at(softs_at(world)[index]), turning_of(joined, j, joined.arms_of_turning[joined.couples[j]])
    R = rows_in(step.turn, START)
    for n in range(len(of.nodes)):
        v = vector(step.velocities[of.nodes[n]], 0)
        if kind == FREE:
            turning = added(turning, 1.0, rotated(R, turned_by(of, n, rotated_back(R, v))))
        else:
            turning = added(turning, 1.0, turned_by(of, n, v))
    return turning
