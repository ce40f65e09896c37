"""The step of a carried linear body among obstacles, compiled: `mechanics.frame_contact` of `steppers.carried_frame`.

How its frame turns is known, so that velocities follow forces exactly, by r̂ = A⁻¹ (right + Sᵀ f).
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_apart, jit_part
from fenics_rom.mechanics.compiled.contact_law import NOTHING, OTHERWISE, Found
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, turn_too_far
from fenics_rom.runtime.compiled.bent_frame import Bending, remember_shape, restore_shape
from fenics_rom.runtime.compiled.carried_step import (
    OF_BASE,
    SPIN,
    Begun,
    begin_carried_step,
    end_carried_step,
    inverse_of_carried,
)
from fenics_rom.runtime.compiled.frame_tables import bent_at, body_at, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import POSITION, TAKEN, Body, State, dot, middle_of, rotated, vector
from fenics_rom.runtime.compiled.touched_frame import (
    FREE,
    MOST_SWEEPS,
    MOVED,
    VELOCITY,
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
from fenics_rom.runtime.compiled.touching import Last


@jit_apart
def take_touched_carried_step(table: Array, u: Array, base: Array, among: Among) -> Touched:
    """Takes a step among obstacles; the other arguments are as of `take_carried_step`."""
    return _take(table, u, base, among, None)


@jit_apart
def take_touched_bent_carried_step(table: Array, u: Array, base: Array, among: Among) -> Touched:
    """The same of a body that deforms largely."""
    bent = bent_at(table)
    remember_shape(bent)
    touched = _take(table, u, base, among, bent)
    if touched.step.status != TAKEN:
        restore_shape(bent)
    else:
        copy(among.found.forces, bent.pressed)
    return touched


@jit_part
def _take(table: Array, u: Array, base: Array, among: Among, bent: Bending | None) -> Touched:
    """The same; of a linear body it has none."""
    body, loads, state, watch = body_at(table), loads_at(table), state_at(table), watch_at(table)
    begun = begin_carried_step(body, loads, u, base, state, bent, among.points)
    if begun.status != TAKEN or turn_too_far(among.moving):
        return nothing_taken()
    h, now, q, turn = body.h, state.now[0], state.halves[0] * body.inverse_ω, _turn_of(begun)
    sweep, r̂ = begin_sweeps(among, h, q, state.halves[1], begun.R, vector(now, POSITION)), begun.rate.copy()
    contact = _find_contact(body, begun, turn, r̂, state, among, sweep)
    if contact.status == OTHERWISE:
        return nothing_taken()
    by_obstacles = act_on_points(among, sweep, contact, turn)
    _put_moved(body, begun, turn, r̂, among, sweep, among.found.motion[MOVED])
    push = push_of(among.points, turn, sweep.arms)
    step = end_carried_step(body, loads, begun, base, r̂, push, state, watch, bent)
    return end_touched(among, step, contact, by_obstacles)


@jit_part
def _turn_of(begun: Begun) -> Turn:
    """How the frame turns in a step that has begun."""
    return Turn(begun.R, middle_of(begun.R, begun.t), begun.end, begun.t)


@jit_part
def _put_moved(body: Body, begun: Begun, turn: Turn, r̂: Array, among: Among, sweep: Sweep, row: Array) -> None:
    """Sets velocities (3P,) of the points at r̂ (m,), and their arms."""
    move_inside(among.points, r̂)
    set_arms(among.points, turn, body.h, sweep.arms)
    of_base = rotated(turn.middle, begun.v̂), rotated(turn.middle, begun.ω̂)
    put_velocities(turn, of_base[0], of_base[1], sweep.arms, among.points.inside, row)


@jit_part
def _find_contact(body: Body, begun: Begun, turn: Turn, r̂: Array, state: State, among: Among, sweep: Sweep) -> Found:
    """Finds forces in sweeps, and sets r̂ (m,) under them."""
    now, motion, r, size_before = state.now[0], among.found.motion, state.halves[1], 0.0
    v, ω, inverse, modal = vector(now, OF_BASE), vector(now, SPIN), body.inverse, np.empty(len(r̂))
    before = rotated(turn.middle, v), rotated(turn.middle, ω)
    scale, resting = 0.0, math.sqrt(r.dot(r) + body.mass * (dot(v, v) + body.size**2 * dot(ω, ω)))
    for count in range(MOST_SWEEPS):
        _put_moved(body, begun, turn, r̂, among, sweep, motion[FREE])
        put_velocities(turn, before[0], before[1], sweep.arms, sweep.kept, motion[VELOCITY])
        take_out_forces(among)
        ask_in_sweep(among, sweep, count)
        if count == 0:
            if not among.found.pairs.chosen.any():
                return Found(NOTHING, 0, 0.0)
            note_near(among, sweep)
            inverse = inverse_of_carried(body, state)
            set_operator(among, sweep, turn, inverse, 0.0)
        contact = find_in_sweep(among, sweep, count)
        if contact.status == OTHERWISE:
            return contact
        if not is_all_near(among, sweep):  # others are reached, too
            set_operator(among, sweep, turn, inverse, 0.0)
            continue
        act_on_points(among, sweep, contact, turn)
        set_modal(among.points, modal)
        after = begun.rate + np.dot(inverse, modal)
        change = after - r̂
        copy(after, r̂)
        size = math.sqrt(change.dot(change))
        scale = max(scale, math.sqrt(r̂.dot(r̂)) + resting)
        if has_ended(size, size_before, scale):
            return contact
        size_before = size
    return Found(OTHERWISE, 0, 0.0)


@jit
def take_touched_carried_steps(
    table: Array, inputs: Array, bases: Array, among: Among, path: Moving, last: Last, taken: TouchedTaken
) -> tuple[int, Touched]:
    """Takes steps among obstacles on a path, as `take_carried_steps`; sets `last` and `taken`."""
    touched = nothing_taken()
    for count in range(len(inputs)):
        copy(among.begun.forces, among.found.pairs.forces)
        after = take_touched_carried_step(table, inputs[count], bases[count], among_in(among, path, count))
        if not keep_touched(table, among, after, last, taken, count, None):
            return count, touched
        touched = after
    return len(inputs), touched


@jit
def take_touched_bent_carried_steps(
    table: Array, inputs: Array, bases: Array, among: Among, path: Moving, last: Last, taken: TouchedTaken
) -> tuple[int, Touched]:
    """The same of a body that deforms largely."""
    touched = nothing_taken()
    for count in range(len(inputs)):
        copy(among.begun.forces, among.found.pairs.forces)
        after = take_touched_bent_carried_step(table, inputs[count], bases[count], among_in(among, path, count))
        if not keep_touched(table, among, after, last, taken, count, bent_at(table)):
            return count, touched
        touched = after
    return len(inputs), touched
