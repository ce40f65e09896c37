"""Free linear soft bodies of a world in a step: begun once, and found under each of the forces that are tried.

Equations are those of `steppers.pushed_step`, unknowns ω̂ and r̂, of which v̂ follows. Forces of own points act on nodes.
Where a body is pushed at the place X of another one's point, with its own at the arm a, (X - p̂ - a) × f turns it, too.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy, copy_rows
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.bent_frame import Bending, remember_shape
from fenics_rom.runtime.compiled.contact_points import (
    WHOLE,
    Points,
    add_yielding,
    arm_of,
    begin_points,
    end_points,
    place_points,
)
from fenics_rom.runtime.compiled.frame_tables import body_at, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import (
    OTHERWISE,
    POSITION,
    TAKEN,
    VELOCITY,
    Acting,
    Body,
    Push,
    act,
    added,
    combine,
    cross,
    length,
    put,
    restore,
    rotated,
    rotated_back,
    rotation_in,
    rotation_of,
    seen,
    turned_along,
    vector,
)
from fenics_rom.runtime.compiled.free_balance import SPIN, correct, keep_slopes, lack, speed_at, turn_at
from fenics_rom.runtime.compiled.free_step import Begun, begin_free_step, end_free_step
from fenics_rom.runtime.compiled.kept_slopes import SCALE, begin_search, has_ended, lacks_slopes
from fenics_rom.runtime.steppers.inertia import MOST_ITERATIONS
from fenics_rom.world.compiled.couples import inverse_of, pushed_by
from fenics_rom.world.compiled.free_operators import Pushes, acting_on, mean_arm, turning_at
from fenics_rom.world.compiled.soft_bodies import (
    BY_OTHERS,
    CENTRE,
    DISSIPATED,
    END,
    FORCE,
    MIDDLE,
    ORIGIN,
    POWER,
    RIMS,
    SPUN,
    SQUARE,
    START,
    SUPPLIED,
    TORQUE,
    TURN,
    WITHIN,
    bending_of,
    look_at_travel,
    middle_of,
    points_at,
    put_rows,
    rows_in,
    step_at,
)


class _Moved(NamedTuple):
    """What moves s nodes."""

    some: Array  # (s,) which they are
    rows: Array  # Vᵀ (m, 3s)
    compliance: Array  # C (3s, 3s), m/s/N; (0, 0) where there is none


@jit_apart
def begin_free(table: Array, h: float, travel: Array) -> bool:
    """Begins the step of a linear body; whether it could. Sets how far it goes, (4,)."""
    return _begin(table, h, travel, None, None)


@jit_apart
def begin_bent_free(table: Array, h: float, travel: Array) -> bool:
    """The same of one that deforms largely."""
    bent = bending_of(table)
    remember_shape(bent)
    return _begin(table, h, travel, bent, points_at(table))


@jit_part
def _begin(table: Array, h: float, travel: Array, bent: Bending | None, touched: Points | None) -> bool:
    """The same."""
    body, state, points, step = body_at(table), state_at(table), points_at(table), step_at(table)
    e, r = state.halves[0], state.halves[1]
    begun = begin_free_step(body, loads_at(table), step.u, state, bent, touched)
    if begun.status == OTHERWISE:
        return False
    if bent is not None:
        plain = act(loads_at(table), step.u, len(body.ω))
        put(step.turn, RIMS, added(begun.acting.force, -1.0, plain.force))
        put(step.turn, RIMS + 3, added(begun.acting.torque, -1.0, plain.torque))
    copy(begun.x, step.changed)
    now, turn, R, ω = state.now[0], step.turn, begun.R, vector(state.now[0], SPIN)
    put_rows(turn, START, R)
    put(turn, SPUN, rotated(R, ω))
    step.rate[:] = 0.0
    begin_points(points, e * body.inverse_ω, step.rate)
    origin, v = vector(now, POSITION), rotated_back(R, vector(now, VELOCITY))
    place_points(points, r, R, origin, v, ω, step.places, step.velocities)
    look_at_travel(h, step.velocities, travel)
    return bool(np.isfinite(step.changed.sum() + points.free.sum()))


@jit_part
def try_free(table: Array, h: float, pushes: Pushes) -> bool:
    """Finds how a body moves under forces, which its nodes have; whether it could."""
    body, loads, state, points, step = (
        body_at(table), loads_at(table), state_at(table), points_at(table), step_at(table),
    )  # fmt: skip
    acting, q, x = acting_on(table), state.halves[0] * body.inverse_ω, step.changed
    now, moved, ρ, modal = state.now[0], _moved(points), np.empty(len(x)), np.empty(len(q))
    R, search, pushed, sizes = rotation_of(*rotation_in(now)), begin_search(state), (0.0, 0.0, 0.0), 0.0
    points.seen[:] = 0.0
    for p in moved.some:
        f = vector(points.forces[p], 0)
        pushed, sizes = added(pushed, 1.0, f), sizes + abs(f[0]) + abs(f[1]) + abs(f[2])
    for _ in range(MOST_ITERATIONS):
        inertia, L_end = lack(body, loads, acting, q, R, x, now, state.table, ρ)
        if len(moved.some):
            push = _push_at(body, acting, now, points, moved, pushes, pushed, x, modal)
            put(ρ, 0, added(vector(ρ, 0), -1.0, push.turning))
            for i in range(len(modal)):
                ρ[3 + i] -= modal[i]
        if lacks_slopes(state, search):
            keep_slopes(body, inertia, L_end, x, state)
        size = correct(body, x, ρ, state)
        if search[SCALE] == 0.0:
            search[SCALE] = speed_at(body, x, state)
            if len(moved.some):
                whole = math.sqrt(body.mass)
                _, end = turn_at(h, x, now)
                v̂ = _translation(body, acting, now, end, (0.0, 0.0, 0.0))
                search[SCALE] += whole * length(v̂) + h / 2 * sizes / whole
        if has_ended(size, state, search):
            push = _push_at(body, acting, now, points, moved, pushes, pushed, x, modal)
            _tell(body, acting, now, points, pushes, push, x, step.turn)
            return True
        if not math.isfinite(size):
            return False
    return False


@jit_part
def _moved(points: Points) -> _Moved:
    """Of those that are pushed."""
    some, m = points.pushed.nonzero()[0], len(points.rows)
    n = 3 * len(some)
    rows, compliance = np.empty((m, n)), np.empty((n if len(points.R) else 0, n))
    for s in range(len(some)):
        for k in range(3):
            to, at = 3 * s + k, 3 * some[s] + k
            for i in range(m):
                rows[i, to] = points.rows[i, at]
            for j in range(len(some) if len(points.R) else 0):
                row = points.R[points.slots[some[s]], k]
                for c in range(3):
                    compliance[to, 3 * j + c] = row[3 * some[j] + c] / points.times[WHOLE]
    return _Moved(some, rows, compliance)


@jit_part
def _translation(body: Body, acting: Acting, now: Array, end: Rotation, pushed: Vector) -> Vector:
    """v̂ of the centre of mass, where contact pushes with a force."""
    force = turned_along(rotation_of(*rotation_in(now)), end, acting.force)
    force = added(added(force, body.mass, acting.acceleration), 1.0, pushed)
    for n in range(len(acting.at_points)):
        force = added(force, 1.0, vector(acting.at_points[n], 0))
    return added(vector(now, VELOCITY), body.h / 2 / body.mass, force)


@jit_part
def _push_at(
    body: Body,
    acting: Acting,
    now: Array,
    points: Points,
    moved: _Moved,
    pushes: Pushes,
    pushed: Vector,
    x: Array,
    modal: Array,
) -> Push:
    """What forces do at the velocities x, all together `pushed`; sets theirs on the coordinates (m,)."""
    h, (t, end), R = body.h, turn_at(body.h, x, now), rotation_of(*rotation_in(now))
    some, rows, torque = moved.some, moved.rows, (0.0, 0.0, 0.0)
    inside, felt = np.empty(3 * len(some)), np.empty(3 * len(some))
    combine(x[3:], rows, inside)
    for p in some:
        put(points.seen[p], 0, seen(R, t, vector(points.forces[p], 0)))
    for i in range(len(pushes.couples)):
        if pushes.couples[i] >= 0:
            of, couple = turning_at(pushes, i), vector(pushes.forces[i], 0)
            torque = added(torque, 1.0, couple)
            for n in range(len(of.nodes)):
                g = points.seen[of.nodes[n]]
                put(g, 0, added(vector(g, 0), 1.0, pushed_by(of, n, seen(R, t, couple))))
    for s in range(len(some)):
        put(felt, 3 * s, vector(points.seen[some[s]], 0))
    if len(moved.compliance):
        inside += np.dot(moved.compliance, felt)
    for s in range(len(some)):
        p = some[s]
        put(points.inside[p], 0, added(vector(points.free[p], 0), 1.0, vector(inside, 3 * s)))
        torque = added(torque, 1.0, cross(arm_of(points, p, R, end, h), vector(points.forces[p], 0)))
    p̂ = added(vector(now, POSITION), h / 2, _translation(body, acting, now, end, pushed))
    for i in range(len(pushes.follows)):
        if pushes.follows[i]:
            off = added(added(vector(pushes.places[i], 0), -1.0, p̂), -1.0, mean_arm(points, pushes, i, R, end, h))
            torque = added(torque, 1.0, cross(off, vector(pushes.forces[i], 0)))
    copy(np.dot(rows, felt), modal)
    return Push(pushed, torque, seen(R, t, torque))


@jit_part
def _tell(
    body: Body, acting: Acting, now: Array, points: Points, pushes: Pushes, push: Push, x: Array, turn: Array
) -> None:
    """Sets how the frame and all points move with the velocities x, and what pushes."""
    (t, end), R = turn_at(body.h, x, now), rotation_of(*rotation_in(now))
    v̂, middle = _translation(body, acting, now, end, push.force), middle_of(R, t)
    put_rows(turn, END, end)
    put_rows(turn, MIDDLE, middle)
    put(turn, TURN, t)
    put(turn, ORIGIN, v̂)
    put(turn, SPUN, rotated(middle, vector(x, 0)))
    put(turn, CENTRE, added(vector(now, POSITION), body.h / 2, v̂))
    put(turn, FORCE, push.force)
    put(turn, TORQUE, push.torque)
    n = 3 * len(points.rest)
    inside, free = points.inside.reshape(n), points.free.reshape(n)
    combine(x[3:], points.rows, inside)
    inside += free
    add_yielding(points, inside)
    back = inverse_of(middle)
    for p in range(len(points.rest) if (pushes.couples >= 0).any() else 0):  # with those of couples
        if points.pushed[p]:
            put(points.forces[p], 0, rotated_back(back, vector(points.seen[p], 0)))


@jit_apart
def end_free(table: Array, h: float) -> bool:
    """Takes the step of a linear body under the forces that were tried last; whether it could."""
    return _end(table, h, None)


@jit_apart
def end_bent_free(table: Array, h: float) -> bool:
    """The same of one that deforms largely."""
    bent = bending_of(table)
    could = _end(table, h, bent)
    copy(points_at(table).forces, bent.pressed)
    return could


@jit_part
def _end(table: Array, h: float, bent: Bending | None) -> bool:
    """The same."""
    body, loads, state, points, step = (
        body_at(table), loads_at(table), state_at(table), points_at(table), step_at(table),
    )  # fmt: skip
    turn, told = step.turn, step.told
    push = Push(vector(turn, FORCE), vector(turn, TORQUE), vector(turn, TORQUE))
    q, R, acting = state.halves[0] * body.inverse_ω, rows_in(turn, START), acting_on(table)
    begun = Begun(TAKEN, q, R, acting, step.changed)
    taken = end_free_step(body, loads, begun, step.changed, push, state, watch_at(table), bent)
    if taken.status == OTHERWISE:
        return False
    lost, stored = end_points(points, h, points.rows[:0])
    told[SQUARE], told[WITHIN] = taken.square + stored, taken.within
    told[SUPPLIED], told[DISSIPATED], told[BY_OTHERS] = taken.supplied, taken.dissipated + lost, h * turn[POWER]
    return True


@jit_apart
def undo_free(table: Array) -> None:
    """Puts a body where it was before the step that it took."""
    points = points_at(table)
    restore(state_at(table))
    copy_rows(points.beyond_before, points.beyond)
