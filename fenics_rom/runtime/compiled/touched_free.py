"""The step of a free linear body among obstacles, compiled: `mechanics.frame_contact` of `steppers.free_frame`."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_apart, jit_part
from fenics_rom.mechanics.compiled.contact_law import NOTHING, OTHERWISE, Found
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, turn_too_far
from fenics_rom.mechanics.frame_contact import FEW_SWEEPS, SLOW
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.bent_frame import Bending, remember_shape, restore_shape
from fenics_rom.runtime.compiled.contact_points import see_forces
from fenics_rom.runtime.compiled.frame_tables import bent_at, body_at, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import (
    POSITION,
    TAKEN,
    VELOCITY,
    Body,
    Loads,
    Push,
    State,
    added,
    dot,
    length,
    middle_of,
    put,
    rotated,
    turned_along,
    vector,
)
from fenics_rom.runtime.compiled.free_balance import SPIN, keep_slopes, lack, size_of, solve, turn_at
from fenics_rom.runtime.compiled.free_step import Begun, begin_free_step, end_free_step
from fenics_rom.runtime.compiled.touched_frame import (
    FREE,
    MOST_SWEEPS,
    MOVED,
    Among,
    Sweep,
    Touched,
    TouchedTaken,
    Turn,
    act_on_points,
    among_in,
    ask_in_sweep,
    begin_sweeps,
    end_touched,
    find_in_sweep,
    has_ended,
    is_all_near,
    keep_touched,
    move_inside,
    note_near,
    nothing_taken,
    push_of,
    put_velocities,
    set_arms,
    set_modal,
    set_operator,
    take_out_forces,
)
from fenics_rom.runtime.compiled.touched_frame import VELOCITY as KEPT
from fenics_rom.runtime.compiled.touching import Last


@jit_apart
def take_touched_free_step(table: Array, u: Array, among: Among) -> Touched:
    """Takes a step of a body in a table under u (p,) among obstacles; where it is OTHERWISE nothing is changed."""
    return _take(table, u, among, None)


@jit_apart
def take_touched_bent_free_step(table: Array, u: Array, among: Among) -> Touched:
    """The same of a body that deforms largely."""
    bent = bent_at(table)
    remember_shape(bent)
    touched = _take(table, u, among, bent)
    if touched.step.status != TAKEN:
        restore_shape(bent)
    else:
        copy(among.found.forces, bent.pressed)
    return touched


@jit_part
def _take(table: Array, u: Array, among: Among, bent: Bending | None) -> Touched:
    """The same; of a linear body it has none."""
    body, loads, state, watch = body_at(table), loads_at(table), state_at(table), watch_at(table)
    begun = begin_free_step(body, loads, u, state, bent, among.points)
    h, x, points, now = body.h, begun.x, among.points, state.now[0]
    if begun.status != TAKEN or turn_too_far(among.moving):
        return nothing_taken()
    if not solve(body, loads, begun.acting, begun.q, begun.R, x, state):
        return nothing_taken()
    sweep = begin_sweeps(among, h, begun.q, state.halves[1], begun.R, vector(now, POSITION))
    contact = _find_contact(body, loads, begun, state, among, sweep)
    if contact.status == OTHERWISE:
        return nothing_taken()
    turn = _turn_of(h, begun, x, now)
    by_obstacles = act_on_points(among, sweep, contact, turn)
    push = _push_at(among, sweep, turn, h, x, np.empty(len(x)))
    v̂, spin = _translation(body, begun, turn, now, push.force), rotated(turn.middle, vector(x, 0))
    put_velocities(turn, v̂, spin, sweep.arms, points.inside, among.found.motion[MOVED])
    step = end_free_step(body, loads, begun, x, push, state, watch, bent)
    if step.status != TAKEN:
        return nothing_taken()
    return end_touched(among, step, contact, by_obstacles)


@jit_part
def _turn_of(h: float, begun: Begun, x: Array, now: Array) -> Turn:
    """How the frame turns by x."""
    t, end = turn_at(h, x, now)
    return Turn(begun.R, middle_of(begun.R, t), end, t)


@jit_part
def _translation(body: Body, begun: Begun, turn: Turn, now: Array, contact: Vector) -> Vector:
    """Mid-step velocity of the origin under a contact force."""
    acting = begun.acting
    force = added(added(contact, body.mass, acting.acceleration), 1.0, turned_along(turn.R, turn.end, acting.force))
    for k in range(len(acting.at_points)):
        force = added(force, 1.0, vector(acting.at_points[k], 0))
    return added(vector(now, VELOCITY), body.h / 2 / body.mass, force)


@jit_part
def _push_at(among: Among, sweep: Sweep, turn: Turn, h: float, x: Array, pushed: Array) -> Push:
    """Sets arms at x, and what forces on the points do there to ω̂ and r̂ (3 + m,)."""
    move_inside(among.points, x[3:])
    set_arms(among.points, turn, h, sweep.arms)
    return _push_of(among, sweep, turn, pushed)


@jit_part
def _push_of(among: Among, sweep: Sweep, turn: Turn, pushed: Array) -> Push:
    """Sets what forces do where arms are set."""
    push = push_of(among.points, turn, sweep.arms)
    put(pushed, 0, push.turning)
    set_modal(among.points, pushed[3:])
    return push


@jit_part
def _find_contact(body: Body, loads: Loads, begun: Begun, state: State, among: Among, sweep: Sweep) -> Found:
    """Finds forces in sweeps, and sets x of the step that has begun to its velocities under them."""
    h, x, points, now, motion = body.h, begun.x, among.points, state.now[0], among.found.motion
    v, ω, r, size_before = vector(now, VELOCITY), vector(now, SPIN), state.halves[1], 0.0
    weight, is_stale, has_operator = (body.rigid[0] + body.rigid[1] + body.rigid[2]) / 3, False, False
    corrected, pushed, pushed_after, ρ = x.copy(), np.empty(len(x)), np.empty(len(x)), np.empty(len(x))
    scale, resting = 0.0, math.sqrt(weight * dot(ω, ω) + r.dot(r))
    for count in range(MOST_SWEEPS):
        turn = _turn_of(h, begun, x, now)
        see_forces(points, turn.R, turn.t)
        push = _push_at(among, sweep, turn, h, x, pushed)
        copy(x, corrected)
        if count > 0:
            inertia, L_end = lack(body, loads, begun.acting, begun.q, begun.R, x, now, state.table, ρ)
            if is_stale:
                keep_slopes(body, inertia, L_end, x, state)
                is_stale = has_operator = False
            corrected -= np.dot(state.slopes, ρ - pushed)
            move_inside(points, corrected[3:])
        v̂, spin = _translation(body, begun, turn, now, push.force), rotated(turn.middle, vector(corrected, 0))
        put_velocities(turn, v̂, spin, sweep.arms, points.inside, motion[FREE])
        put_velocities(turn, v, rotated(turn.middle, ω), sweep.arms, sweep.kept, motion[KEPT])
        if count > 0 and not has_operator:
            has_operator = set_operator(among, sweep, turn, state.slopes, h / 2 / body.mass)
        take_out_forces(among)
        ask_in_sweep(among, sweep, count)
        if count == 0:
            if not among.found.pairs.chosen.any():
                return Found(NOTHING, 0, 0.0)
            note_near(among, sweep)
            has_operator = set_operator(among, sweep, turn, state.slopes, h / 2 / body.mass)
        contact = find_in_sweep(among, sweep, count)
        if contact.status == OTHERWISE:
            return contact
        has_operator = is_all_near(among, sweep)
        if not has_operator:  # others are reached, too
            continue
        act_on_points(among, sweep, contact, turn)
        _push_of(among, sweep, turn, pushed_after)
        change = corrected - x + np.dot(state.slopes, pushed_after - pushed)
        x += change
        size, own = size_of(weight, change), _translation(body, begun, turn, now, (0.0, 0.0, 0.0))
        scale = max(scale, size_of(weight, x) + resting + math.sqrt(body.mass) * length(own))
        if has_ended(size, size_before, scale):
            return contact
        is_stale, size_before = count >= FEW_SWEEPS and size > SLOW * size_before, size
    return Found(OTHERWISE, 0, 0.0)


@jit
def take_touched_free_steps(
    table: Array, inputs: Array, among: Among, path: Moving, last: Last, taken: TouchedTaken
) -> tuple[int, Touched]:
    """Takes steps among obstacles on a path, as `take_free_steps`; sets `last` and `taken`."""
    touched = nothing_taken()
    for count in range(len(inputs)):
        copy(among.begun.forces, among.found.pairs.forces)
        after = take_touched_free_step(table, inputs[count], among_in(among, path, count))
        if not keep_touched(table, among, after, last, taken, count, None):
            return count, touched
        touched = after
    return len(inputs), touched


@jit
def take_touched_bent_free_steps(
    table: Array, inputs: Array, among: Among, path: Moving, last: Last, taken: TouchedTaken
) -> tuple[int, Touched]:
    """The same of a body that deforms largely."""
    touched = nothing_taken()
    for count in range(len(inputs)):
        copy(among.begun.forces, among.found.pairs.forces)
        after = take_touched_bent_free_step(table, inputs[count], among_in(among, path, count))
        if not keep_touched(table, among, after, last, taken, count, bent_at(table)):
            return count, touched
        touched = after
    return len(inputs), touched
