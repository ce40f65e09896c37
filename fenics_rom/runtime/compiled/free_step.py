"""The step of a free linear body in its frame: `steppers.free_frame`, compiled; `free_balance` has its equations."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.frame_motion import Rotation
from fenics_rom.mechanics.largest_turn import LARGEST_TURN
from fenics_rom.runtime.compiled.bent_frame import (
    FOLLOWED,
    Bending,
    end_shape,
    expect_free,
    pressed_rims,
    remember_shape,
    restore_shape,
    solve_held,
    twice_strained,
)
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.frame_tables import bent_at, body_at, keep_step, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import (
    GIVEN,
    IS_SHAPE_KNOWN,
    MOVED,
    NOT_PUSHED,
    OTHERWISE,
    POSITION,
    ROTATION,
    TAKEN,
    TURNING,
    VELOCITY,
    Acting,
    Body,
    Loads,
    Push,
    State,
    Step,
    Taken,
    Watch,
    act,
    added,
    dot,
    give,
    inertia_in,
    length,
    look,
    push_points,
    put,
    remember,
    restore,
    rotation_in,
    rotation_of,
    shape_at,
    torque_of,
    turn_of_top,
    turned,
    turned_along,
    vector,
)
from fenics_rom.runtime.compiled.free_balance import (
    IS_PASSED,
    LENGTH,
    MOMENTUM,
    PASSED,
    SPIN,
    find_motion,
    solve,
    turn_at,
)
from fenics_rom.runtime.compiled.small_matrices import dot as sum_of_products
from fenics_rom.runtime.compiled.small_matrices import square_by


class Begun(NamedTuple):
    """A step of a free body that has begun."""

    status: int
    q: Array  # (m,)
    R: Rotation
    acting: Acting
    x: Array  # ω̂ and r̂ (3 + m,) as they are expected


@jit_apart
def take_free_step(table: Array, u: Array) -> Step:
    """Takes a step of a body in a table (`frame_tables`) under u (p,)."""
    return _take(table, u, None)


@jit_apart
def take_bent_free_step(table: Array, u: Array) -> Step:
    """The same of a body that deforms largely."""
    bent = bent_at(table)
    remember_shape(bent)
    step = _take(table, u, bent)
    if step.status == OTHERWISE:
        restore_shape(bent)
    return step


@jit_part
def _take(table: Array, u: Array, bent: Bending | None) -> Step:
    """The same; of a linear body it has none."""
    body, loads, state, watch = body_at(table), loads_at(table), state_at(table), watch_at(table)
    none = Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    begun, now = begin_free_step(body, loads, u, state, bent, None), state.now[0]
    if begun.status == OTHERWISE:
        return none
    acting, q, x = begun.acting, begun.q, begun.x
    if body.couples or len(acting.at_points):
        if not solve(body, loads, acting, q, begun.R, x, state):
            return none
    else:
        r̂ = x[3:]
        if bent is None:
            copy(-np.dot(body.inverse, state.table[GIVEN]), r̂)
        elif not solve_held(bent, state.table[GIVEN], r̂):
            return none
        torque, of_top = torque_of(acting, q, body.h, r̂), inertia_in(now)
        ω̂, left = turn_of_top(of_top, vector(now, MOMENTUM), torque, vector(now, SPIN), vector(x, 0), body.h)
        if left != 0.0:
            return none
        put(x, 0, ω̂)
    return end_free_step(body, loads, begun, x, NOT_PUSHED, state, watch, bent)


@jit_part
def begin_free_step(
    body: Body, loads: Loads, u: Array, state: State, bent: Bending | None, points: Points | None
) -> Begun:
    """Begins a step under u (p,). Nothing is changed but what is known of the state.

    `bent`: of a body that deforms largely; `points` where obstacles can touch that. Else there are none.
    """
    h, m = body.h, len(body.ω)
    e, r = state.halves[0], state.halves[1]
    q, x = e * body.inverse_ω, np.empty(3 + m)
    now, kept, table, acting = state.now[0], state.kept, state.table, act(loads, u, m)
    if bent is not None:
        acting = pressed_rims(bent, u, q, h, acting)
    R, is_known = rotation_of(*rotation_in(now)), True
    if not kept[IS_SHAPE_KNOWN]:
        shape_at(body, q, r, table, now)
        is_known = find_motion(body.is_definite, e, table, now)
        kept[IS_SHAPE_KNOWN] = 1.0 if is_known else 0.0
    ω = vector(now, SPIN)
    if not (is_known and h * length(ω) <= LARGEST_TURN):
        return Begun(OTHERWISE, q, R, acting, x)
    put(x, 0, ω)
    copy(r, x[3:])
    if kept[IS_PASSED] and h <= 2 * kept[LENGTH]:
        share = h / kept[LENGTH]
        for k in range(3 + m):
            x[k] += share * (x[k] - kept[PASSED + k])
    if bent is None:
        give(body, acting.modal, e, r, table)
    else:
        expect_free(body, loads, acting, u, q, R, x, state, bent, points)
    return Begun(TAKEN, q, R, acting, x)


@jit_part
def end_free_step(
    body: Body, loads: Loads, begun: Begun, x: Array, push: Push, state: State, watch: Watch, bent: Bending | None
) -> Step:
    """Takes a step that has begun with ω̂ and r̂ of x, under contact forces that push; their work is not told."""
    h, m, r̂, ω̂, now, kept = body.h, len(body.ω), x[3:], vector(x, 0), state.now[0], state.kept
    q, R, acting = begun.q, begun.R, begun.acting
    (t, end), velocity = turn_at(h, x, now), vector(now, VELOCITY)
    torque = torque_of(acting, q, h, r̂)
    power, τ = dot(torque, ω̂) + acting.modal.dot(r̂), turned_along(R, end, torque)
    force = added(turned_along(R, end, acting.force), body.mass, acting.acceleration)
    if len(acting.at_points):
        modal = np.empty(m)
        pulled, by_points, turning = push_points(loads, acting.at_points, R, end, t, q, h, r̂, modal)
        force, τ, power = added(force, 1.0, pulled), added(τ, 1.0, by_points), power + dot(turning, ω̂) + modal.dot(r̂)
    whole = added(force, 1.0, push.force)
    v̂ = added(velocity, h / 2 / body.mass, whole)
    power += dot(force, v̂)
    remember(state)
    e, r = state.halves[0], state.halves[1]
    for i in range(m):
        e[i] += h * body.ω[i] * r̂[i]
        r[i] = 2 * r̂[i] - r[i]
    w, x_, y_, z_ = turned(rotation_in(now), t)
    put(now, POSITION, added(vector(now, POSITION), h, v̂))
    now[ROTATION] = w
    put(now, ROTATION + 1, (x_, y_, z_))
    put(now, VELOCITY, added(velocity, h / body.mass, whole))
    put(now, TURNING, added(vector(now, TURNING), h, added(τ, 1.0, push.torque)))
    after = e * body.inverse_ω
    shape_at(body, after, r, state.table, now)
    if not find_motion(body.is_definite, e, state.table, now):
        restore(state)
        return Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    kept[IS_PASSED], kept[LENGTH] = 1.0, h
    for k in range(3 + m):
        kept[PASSED + k] = x[k]
    ω, v, within = vector(now, SPIN), vector(now, VELOCITY), sum_of_products(r, r)
    if bent is None:
        within, heat = within + sum_of_products(e, e), h * square_by(body.D, r̂)
    else:
        heat, power = end_shape(bent, q, after, r̂), power + bent.vectors[FOLLOWED].dot(r̂)
        within += twice_strained(bent, after)
        put(bent.felt, 6, ω)
    turning_too = dot(ω, added(vector(now, MOMENTUM), 1.0, vector(now, MOVED)))
    look(watch, e, within, length(ω))
    square = body.mass * dot(v, v) + turning_too + within
    return Step(TAKEN, square, within, h * power, heat)


@jit
def take_free_steps(table: Array, inputs: Array, taken: Taken) -> tuple[int, Step]:
    """Takes steps under inputs (n, p): how many, and the last one.

    It ends before a step that is to be taken otherwise, or whose energy is not finite; `taken` is set.
    """
    last = Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    for count in range(len(inputs)):
        step = take_free_step(table, inputs[count])
        if not keep_step(table, step, taken, count, None):
            return count, last
        last = step
    return len(inputs), last


@jit
def take_bent_free_steps(table: Array, inputs: Array, taken: Taken) -> tuple[int, Step]:
    """The same of a body that deforms largely."""
    last = Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    for count in range(len(inputs)):
        step = take_bent_free_step(table, inputs[count])
        if not keep_step(table, step, taken, count, bent_at(table)):
            return count, last
        last = step
    return len(inputs), last
