"""The step of a linear body that a rigid base carries: `steppers.carried_frame`, compiled."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy_rows
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.mechanics.largest_turn import LARGEST_TURN
from fenics_rom.runtime.compiled.bent_frame import (
    FOLLOWED,
    Bending,
    end_shape,
    expect_carried,
    pressed_rims,
    remember_shape,
    restore_shape,
    twice_strained,
)
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.frame_tables import bent_at, body_at, keep_step, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import (
    ASKEW,
    AWAY,
    DRIFT,
    GIVEN,
    IS_SHAPE_KNOWN,
    MOMENT,
    MOMENTS,
    MOTION,
    MOVED,
    NOT_PUSHED,
    OTHERWISE,
    POSITION,
    REST,
    TAKEN,
    TURNED,
    TURNING,
    VELOCITY,
    WRENCH,
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
    combine,
    cross,
    dot,
    give,
    give_without_springs,
    inertia_in,
    length,
    look,
    mean,
    misfit_of,
    momenta_of,
    pairs,
    push_points,
    put,
    remember,
    rotated,
    rotated_back,
    rotation_in,
    rotation_of,
    seen,
    shape_at,
    torque_of,
    turned_along,
    vector,
)
from fenics_rom.runtime.compiled.small_matrices import dot as sum_of_products
from fenics_rom.runtime.compiled.small_matrices import multiply, square_by

OF_BASE, SPIN, MOMENTUM, ANGULAR_MOMENTUM = MOTION, MOTION + 3, MOTION + 6, MOTION + 9  # in `State.now`: v, ω, P and L
IS_COUPLING_KNOWN, IS_INVERSE_KNOWN, IS_COUPLED = 1, 2, 3  # in `State.kept`; from REST on the nine factors of A
NO_TURN = 1e-18  # rad: see `steppers.carried_balance`


class Begun(NamedTuple):
    """A step of a carried body that has begun."""

    status: int
    R: Rotation  # when it begins
    end: Rotation  # when it ends
    t: Vector  # by which the frame turns, in its axes
    v̂: Vector  # of the base in the frame's axes, m/s
    ω̂: Vector  # rad/s
    v_end: Vector  # the same when it ends
    ω_end: Vector
    acting: Acting
    modal: Array  # (m,) forces on the coordinates, but for contact
    rate: Array  # r̂ (m,) without contact


@jit_apart
def take_carried_step(table: Array, u: Array, base: Array) -> Step:
    """Takes a step of a body in a table (`frame_tables`) under u (p,).

    It ends with the base (13,): position, quaternion and twist in world axes.
    """
    return _take(table, u, base, None)


@jit_apart
def take_bent_carried_step(table: Array, u: Array, base: Array) -> Step:
    """The same of a body that deforms largely."""
    bent = bent_at(table)
    remember_shape(bent)
    step = _take(table, u, base, bent)
    if step.status == OTHERWISE:
        restore_shape(bent)
    return step


@jit_part
def _take(table: Array, u: Array, base: Array, bent: Bending | None) -> Step:
    """The same; of a linear body it has none."""
    body, loads, state, watch = body_at(table), loads_at(table), state_at(table), watch_at(table)
    begun = begin_carried_step(body, loads, u, base, state, bent, None)
    if begun.status == OTHERWISE:
        return Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    return end_carried_step(body, loads, begun, base, begun.rate, NOT_PUSHED, state, watch, bent)


@jit_part
def begin_carried_step(
    body: Body, loads: Loads, u: Array, base: Array, state: State, bent: Bending | None, points: Points | None
) -> Begun:
    """Begins a step; arguments as of `take_carried_step`. Nothing is changed but what is known of the state.

    `bent`: of a body that deforms largely; `points` where obstacles can touch that. Else there are none.
    """
    h, m, now, table = body.h, len(body.ω), state.now[0], state.table
    e, r = state.halves[0], state.halves[1]
    q, R, end = e * body.inverse_ω, rotation_of(*rotation_in(now)), rotation_of(*rotation_in(base))
    if not state.kept[IS_SHAPE_KNOWN]:
        shape_at(body, q, r, table, now)
        move_with(body.mass, R, now)
        state.kept[IS_SHAPE_KNOWN] = 1.0
    v, ω = vector(now, OF_BASE), vector(now, SPIN)
    v_end, ω_end = rotated_back(end, vector(base, VELOCITY)), rotated_back(end, vector(base, TURNING))
    v̂, ω̂ = mean(v, v_end), mean(ω, ω_end)
    t = (h * ω̂[0], h * ω̂[1], h * ω̂[2])
    acting, modal = act_on_carried(h, loads, u, q, R, end, t, table, bent)
    if not (h * length(ω) <= LARGEST_TURN and h * length(ω_end) <= LARGEST_TURN):
        return Begun(OTHERWISE, R, end, t, v̂, ω̂, v_end, ω_end, acting, modal, modal)
    if bent is None:
        give(body, modal, e, r, table)
        r̂ = _rate(body, now, table, state.kept, state.slopes, v_end, ω_end)
    else:
        give_without_springs(body, modal, np.zeros(m), r, table)
        right, coupled = _balance(body, now, table, v_end, ω_end)
        A, is_same = state.slopes[:m], _is_same(coupled, state.kept)
        combine(coupled, body.products, A.reshape(m * m))
        expect_carried(h, u, q, R, t, A, right, is_same, bent, points)
        state.kept[IS_COUPLED], state.kept[IS_INVERSE_KNOWN] = 1.0, 0.0
        r̂ = np.linalg.solve(A, right)
    return Begun(TAKEN, R, end, t, v̂, ω̂, v_end, ω_end, acting, modal, r̂)


@jit_part
def act_on_carried(
    h: float,
    loads: Loads,
    u: Array,
    q: Array,
    R: Rotation,
    end: Rotation,
    t: Vector,
    table: Array,
    bent: Bending | None,
) -> tuple[Acting, Array]:
    """What inputs u (p,) do in a step from q (m,); forces (m,) on the coordinates, but for what follows the shape."""
    acting = act(loads, u, len(q))
    if bent is not None:
        acting = pressed_rims(bent, u, q, h, acting)
    modal, pull = acting.modal.copy(), seen(R, t, acting.acceleration)
    for i in range(len(q)):
        for k in range(3):
            modal[i] += pull[k] * table[MOMENTS + k, i]
    if len(acting.at_points):
        pushed = np.empty(len(q))
        push_points(loads, acting.at_points, R, end, t, q, h, np.zeros(len(q)), pushed)
        modal += pushed
    return acting, modal


@jit_part
def end_carried_step(
    body: Body,
    loads: Loads,
    begun: Begun,
    base: Array,
    r̂: Array,
    push: Push,
    state: State,
    watch: Watch,
    bent: Bending | None,
) -> Step:
    """Takes a step that has begun with r̂ (m,), under contact forces that push; their work is not among what is told."""
    h, m, now = body.h, len(body.ω), state.now[0]
    v, ω = vector(now, OF_BASE), vector(now, SPIN)
    R, t, v̂, ω̂, v_end, ω_end = begun.R, begun.t, begun.v̂, begun.ω̂, begun.v_end, begun.ω_end
    before = vector(now, MOMENTUM), vector(now, ANGULAR_MOMENTUM), vector(now, MOMENT)
    remember(state)
    e, r = state.halves[0], state.halves[1]
    q = e * body.inverse_ω
    for i in range(m):
        e[i] += h * body.ω[i] * r̂[i]
        r[i] = 2 * r̂[i] - r[i]
    went = added(vector(base, POSITION), -1.0, vector(now, POSITION))
    away, askew = misfit_of(went, rotation_in(now), rotation_in(base), R, t, v̂, h, body.size)
    notes = watch.notes
    notes[AWAY], notes[ASKEW] = max(notes[AWAY], away), max(notes[ASKEW], askew)
    for k in range(len(base)):
        now[k] = base[k]
    after = e * body.inverse_ω
    shape_at(body, after, r, state.table, now)
    move_with(body.mass, begun.end, now)
    P, L = vector(now, MOMENTUM), vector(now, ANGULAR_MOMENTUM)
    ΔP, ΔL = added(P, -1.0, before[0]), added(L, -1.0, before[1])
    pushed = seen(R, t, push.force)
    of_modes = sum_of_products(begun.modal, r̂)
    supplied = dot(ΔP, v̂) + dot(ΔL, ω̂) + h * (of_modes - dot(pushed, v̂) - dot(push.turning, ω̂))
    _put_wrench(body, loads, begun, q, r̂, before, now, state.kept)
    if push.force != (0.0, 0.0, 0.0) or push.turning != (0.0, 0.0, 0.0):
        for first, of_contact in ((WRENCH, pushed), (WRENCH + 3, push.turning)):
            there = turned_along(R, begun.end, of_contact)
            put(state.kept, first, added(vector(state.kept, first), -1.0, there))
    carried = dot(P, v_end) + dot(L, ω_end) + dot(vector(now, DRIFT), v_end) + dot(vector(now, MOVED), ω_end)
    within = sum_of_products(r, r)
    if bent is None:
        within, heat = within + sum_of_products(e, e), h * square_by(body.D, r̂)
    else:
        heat, supplied = end_shape(bent, q, after, r̂), supplied + h * bent.vectors[FOLLOWED].dot(r̂)
        within += twice_strained(bent, after)
        a = added(cross(ω̂, v̂), 1 / h, added(v_end, -1.0, v))
        put(bent.felt, 0, added(a, -1.0, seen(R, t, begun.acting.acceleration)))
        put(bent.felt, 3, added((0.0, 0.0, 0.0), 1 / h, added(ω_end, -1.0, ω)))
        put(bent.felt, 6, ω̂)
    look(watch, e, within, length(ω_end))
    return Step(TAKEN, carried + within, within, supplied, heat)


@jit_part
def inverse_of_carried(body: Body, state: State) -> Array:
    """A⁻¹ (m, m) of the step that has begun."""
    m = len(body.ω)
    if not state.kept[IS_COUPLED]:
        return body.inverse
    inverse = state.slopes[m:]
    if not state.kept[IS_INVERSE_KNOWN]:
        copy_rows(np.linalg.inv(state.slopes[:m]), inverse)
        state.kept[IS_INVERSE_KNOWN] = 1.0
    return inverse


@jit_part
def move_with(mass: float, R: Rotation, now: Array) -> None:
    """Sets twist and momenta in the frame's axes, of the shape that is known."""
    v, ω = rotated_back(R, vector(now, VELOCITY)), rotated_back(R, vector(now, TURNING))
    shape = vector(now, MOVED), vector(now, MOMENT), vector(now, DRIFT)
    P, L = momenta_of(inertia_in(now), shape[0], shape[1], shape[2], v, ω, mass)
    put(now, OF_BASE, v)
    put(now, SPIN, ω)
    put(now, MOMENTUM, P)
    put(now, ANGULAR_MOMENTUM, L)


@jit_part
def _balance(body: Body, now: Array, table: Array, v_end: Vector, ω_end: Vector) -> tuple[Array, Array]:
    """The right-hand side (m,) of what the table says, and the factors (10,) of the products whose sum is A."""
    h, v, ω = body.h, vector(now, OF_BASE), vector(now, SPIN)
    right, factors, coupled = np.empty(len(body.ω)), np.zeros(TURNED + 3 - MOMENTS), np.zeros(10)
    pulled = added(cross(ω, v_end), 1.0, cross(ω_end, v))
    xx, yy, zz, yz, xz, xy = pairs(ω, ω_end)
    put(factors, 0, added(added((0.0, 0.0, 0.0), -1 / h, added(v_end, -1.0, v)), -0.5, pulled))  # c
    put(factors, 3, (xx, yy, zz))
    put(factors, 6, (yz, xz, xy))  # S
    factors[GIVEN - MOMENTS] = -1.0  # f0
    put(factors, TURNED - MOMENTS, added((0.0, 0.0, 0.0), -1 / h, added(ω_end, -1.0, ω)))
    combine(factors, table[MOMENTS : TURNED + 3], right)
    if body.couples and h * (length(ω) + length(ω_end)) > NO_TURN:
        put(coupled, 0, (-xx, -yy, -zz))
        put(coupled, 3, (-yz, -xz, -xy))
        put(coupled, 6, added(ω, 1.0, ω_end))
    coupled[9] = 1.0
    return right, coupled


@jit_part
def _is_same(coupled: Array, kept: Array) -> bool:
    """Whether these factors are those of the step before; they are kept."""
    is_same = kept[IS_COUPLING_KNOWN] != 0.0
    for k in range(9):
        is_same = is_same and coupled[k] == kept[REST + k]
        kept[REST + k] = coupled[k]
    kept[IS_COUPLING_KNOWN] = 1.0
    return is_same


@jit_part
def _rate(body: Body, now: Array, table: Array, kept: Array, slopes: Array, v_end: Vector, ω_end: Vector) -> Array:
    """r̂ (m,), of what the table says."""
    m, (right, coupled) = len(body.ω), _balance(body, now, table, v_end, ω_end)
    kept[IS_COUPLED] = coupled[:9].any()
    if not kept[IS_COUPLED]:
        return _product(body.inverse, right)
    A, inverse = slopes[:m], slopes[m:]
    if not _is_same(coupled, kept):
        combine(coupled, body.products, A.reshape(m * m))
        kept[IS_INVERSE_KNOWN] = 0.0
        return np.linalg.solve(A, right)
    if not kept[IS_INVERSE_KNOWN]:  # of a base that turns steadily
        copy_rows(np.linalg.inv(A), inverse)
        kept[IS_INVERSE_KNOWN] = 1.0
    return _product(inverse, right)


@jit_part
def _product(A: Array, x: Array) -> Array:
    made = np.empty(len(A))
    multiply(A, x, made)
    return made


@jit_part
def _put_wrench(
    body: Body,
    loads: Loads,
    begun: Begun,
    q: Array,
    r̂: Array,
    before: tuple[Vector, Vector, Vector],
    now: Array,
    kept: Array,
) -> None:
    """Sets force and torque of the base in world axes, but for contact; P, L and x̄ + c q are those before the step."""
    h, (P, L, moment), R, end, t = body.h, before, begun.R, begun.end, begun.t
    v̂, ω̂, acting = begun.v̂, begun.ω̂, begun.acting
    P_end, L_end = vector(now, MOMENTUM), vector(now, ANGULAR_MOMENTUM)
    P̂, L̂ = mean(P, P_end), mean(L, L_end)
    force = added(cross(ω̂, P̂), 1 / h, added(P_end, -1.0, P))
    torque = added(added(cross(ω̂, L̂), 1.0, cross(v̂, P̂)), 1 / h, added(L_end, -1.0, L))
    force = added(added(force, -1.0, acting.force), -body.mass, seen(R, t, acting.acceleration))
    arm = mean(rotated(R, moment), rotated(end, vector(now, MOMENT)))
    torque = added(torque, -1.0, torque_of(acting, q, h, r̂))
    torque = added(torque, -1.0, seen(R, t, cross(arm, acting.acceleration)))
    if len(acting.at_points):
        pulled, _, turning = push_points(loads, acting.at_points, R, end, t, q, h, r̂, np.empty(len(q)))
        force, torque = added(force, -1.0, seen(R, t, pulled)), added(torque, -1.0, turning)
    put(kept, WRENCH, turned_along(R, end, force))
    put(kept, WRENCH + 3, turned_along(R, end, torque))


@jit
def take_carried_steps(table: Array, inputs: Array, bases: Array, taken: Taken) -> tuple[int, Step]:
    """Takes steps under inputs (n, p) that end with bases (n, 13): how many, and the last one.

    It ends before a step that is to be taken otherwise, or whose energy is not finite; `taken` is set.
    """
    last = Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    for count in range(len(inputs)):
        step = take_carried_step(table, inputs[count], bases[count])
        if not keep_step(table, step, taken, count, None):
            return count, last
        last = step
    return len(inputs), last


@jit
def take_bent_carried_steps(table: Array, inputs: Array, bases: Array, taken: Taken) -> tuple[int, Step]:
    """The same of a body that deforms largely."""
    last = Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)
    for count in range(len(inputs)):
        step = take_bent_carried_step(table, inputs[count], bases[count])
        if not keep_step(table, step, taken, count, bent_at(table)):
            return count, last
        last = step
    return len(inputs), last
