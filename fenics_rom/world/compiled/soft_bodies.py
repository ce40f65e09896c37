"""Linear soft bodies of a world in a step: those that are held or carried, as arrays in tables.

A held body is carried by what stands still. Its step is begun, answers forces exactly, and is taken under those that
were found: `runtime.compiled.carried_step`, with contact points of `runtime.compiled.contact_points`.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.arrays_at import (
    cube_at,
    integer_cube_at,
    integer_rows_at,
    integers_at,
    matrix_at,
    vector_at,
)
from fenics_rom.runtime.compiled.bent_frame import Bending, pressed_rims, remember_shape
from fenics_rom.runtime.compiled.carried_step import (
    IS_COUPLED,
    IS_INVERSE_KNOWN,
    OF_BASE,
    SPIN,
    Begun,
    begin_carried_step,
    end_carried_step,
    inverse_of_carried,
)
from fenics_rom.runtime.compiled.contact_points import (
    Points,
    answer,
    begin_points,
    end_points,
    place_points,
    see_forces,
    spread_some,
)
from fenics_rom.runtime.compiled.frame_tables import ROWS as FRAME_ROWS
from fenics_rom.runtime.compiled.frame_tables import bent_at, body_at, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import (
    IS_SHAPE_KNOWN,
    OTHERWISE,
    POSITION,
    TAKEN,
    TURNING,
    VELOCITY,
    Push,
    act,
    added,
    cross,
    dot,
    mean,
    middle_of,
    put,
    rotated,
    rotation_in,
    rotation_of,
    seen,
    vector,
)
from fenics_rom.world.compiled.relaxing_bodies import (
    Relaxed,
    draw_back,
    draw_points_back,
    relax,
    relax_points,
    relaxed_in,
)

# Rows of the table of a body: after those of `frame_tables`, of `contact_points.Points`, then of `Step`, then what one
# has that deforms largely, that relaxes, and that is pulled by strokes or rubs at guides: addresses of others are 0.
POINTS, STEP, BENT, RELAXED, PULLED, ROWS = FRAME_ROWS, 39, 53, 93, 99, 112
SQUARE, WITHIN, SUPPLIED, DISSIPATED, BY_OTHERS = range(5)  # in `Step.told`
START, END, MIDDLE, TURN, V, Ω, V_END, Ω_END, ORIGIN, SPUN = 0, 9, 18, 27, 30, 33, 36, 39, 42, 45  # in `Step.turn`
CENTRE, FORCE, TORQUE, POWER, RIMS, TURNS = 48, 51, 54, 57, 58, 64  # there, of free bodies


class Step(NamedTuple):
    """What is known of the step of a body that has begun."""

    u: Array  # input (p,)
    mount: Array  # (13,) of the frame: on what carries it, or of a held body in world axes
    base: Array  # (13,) at the end
    # (64,): R, R⁺ and R*, then t, v̂, ω̂, v⁺, ω⁺ as in `carried_step.Begun`; R* v̂ and R* ω̂. Of free bodies as they were
    # tried last, without v̂ to ω⁺, with v̂ in world axes; then p̂, and force, torque about it and power of contact,
    # force and torque of pressures on open surfaces.
    turn: Array
    modal: Array  # (m,)
    rate: Array  # r̂ (m,) without contact
    changed: Array  # r̂ (m,) under the forces of now; of free bodies ω̂ and r̂ (3 + m,)
    places: Array  # of the points when it begins, (P, 3) in world axes, m
    velocities: Array  # (P, 3), m/s
    told: Array  # (5,): twice the stored energy, and within, supplied and dissipated, and by others, J
    triangles: Array  # of the contact surface, (T, 3) rows of points, counterclockwise from outside
    radii: Array  # (P,), and
    nodes: Array  # (T, c), and
    around: Array  # (T, m, 4) of its `Rounding`


@jit_part
def points_at(table: Array) -> Points:
    """The same of its contact points."""
    t = table[POINTS:]
    given = matrix_at(t[0]), matrix_at(t[1]), cube_at(t[2]), vector_at(t[3]), matrix_at(t[4]), matrix_at(t[5])
    rest, rows, R, times, beyond, before = given
    moved = matrix_at(t[6]), matrix_at(t[7]), matrix_at(t[8]), matrix_at(t[9]), matrix_at(t[10])
    start, free, inside, forces, seen_ = moved
    known = vector_at(t[11]), matrix_at(t[12]), vector_at(t[13]), integers_at(t[14])
    return Points(rest, rows, R, times, beyond, before, start, free, inside, forces, seen_, *known)


@jit_part
def step_at(table: Array) -> Step:
    """The same of its step."""
    t = table[STEP:]
    given = vector_at(t[0]), vector_at(t[1]), vector_at(t[2]), vector_at(t[3]), vector_at(t[4])
    u, mount, base, turn, modal = given
    found = vector_at(t[5]), vector_at(t[6]), matrix_at(t[7]), matrix_at(t[8]), vector_at(t[9])
    rate, changed, places, velocities, told = found
    surface = integer_rows_at(t[10]), vector_at(t[11]), integer_rows_at(t[12]), integer_cube_at(t[13])
    return Step(u, mount, base, turn, modal, rate, changed, places, velocities, told, *surface)


@jit_part
def turn_at(table: Array) -> Array:
    """How its frame turns, `Step.turn`."""
    return vector_at(table[STEP + 3])


@jit_part
def has_residual(table: Array) -> bool:
    """Whether its points yield by themselves."""
    return table[POINTS + 2, 1] > 0


@jit_part
def rows_in(turn: Array, first: int) -> Rotation:
    """A matrix (3, 3) among many numbers."""
    return vector(turn, first), vector(turn, first + 3), vector(turn, first + 6)


@jit_part
def put_rows(turn: Array, first: int, rows: Rotation) -> None:
    """Sets it."""
    put(turn, first, rows[0])
    put(turn, first + 3, rows[1])
    put(turn, first + 6, rows[2])


@jit_part
def bends(table: Array) -> bool:
    """Whether it deforms largely."""
    return table[BENT, 0] != 0


@jit_part
def relaxes(table: Array) -> bool:
    """Whether its strains are small, and its material relaxes."""
    return table[RELAXED, 0] != 0


@jit_part
def is_pulled(table: Array) -> bool:
    """Whether it has strokes that are given, or guides that rub."""
    return table[PULLED, 0] != 0


@jit_part
def bending_of(table: Array) -> Bending:
    """What such a body has."""
    return bent_at(table[BENT - FRAME_ROWS :])


@jit_apart
def begin_soft(table: Array, h: float, travel: Array) -> bool:
    """Begins the step of a linear body whose base is set; whether it could. Sets how far it goes, (4,)."""
    return _begin(table, h, travel, None, None, None)


@jit_apart
def begin_bent(table: Array, h: float, travel: Array) -> bool:
    """The same of one that deforms largely."""
    bent = bending_of(table)
    remember_shape(bent)
    return _begin(table, h, travel, bent, points_at(table), None)


@jit_apart
def begin_relaxing(table: Array, h: float, travel: Array) -> bool:
    """The same of one whose material relaxes, of small strains."""
    return _begin(table, h, travel, None, None, relaxed_in(table[RELAXED:]))


@jit_part
def _begin(
    table: Array, h: float, travel: Array, bent: Bending | None, touched: Points | None, relaxed: Relaxed | None
) -> bool:
    """The same."""
    body, state, points, step = body_at(table), state_at(table), points_at(table), step_at(table)
    kept, now = state.kept, state.now[0]
    was_known, was_coupled = kept[IS_SHAPE_KNOWN], kept[IS_COUPLED]
    begun = begin_carried_step(body, loads_at(table), step.u, step.base, state, bent, touched)
    if begun.status == OTHERWISE:
        return False
    if not was_known or was_coupled != kept[IS_COUPLED] or (kept[IS_COUPLED] and not kept[IS_INVERSE_KNOWN]):
        points.is_spread[:] = 0.0
    turn, R, middle = step.turn, begun.R, middle_of(begun.R, begun.t)
    put_rows(turn, START, R)
    put_rows(turn, END, begun.end)
    put_rows(turn, MIDDLE, middle)
    put(turn, TURN, begun.t)
    put(turn, V, begun.v̂)
    put(turn, Ω, begun.ω̂)
    put(turn, V_END, begun.v_end)
    put(turn, Ω_END, begun.ω_end)
    put(turn, ORIGIN, rotated(middle, begun.v̂))
    put(turn, SPUN, rotated(middle, begun.ω̂))
    copy(begun.modal, step.modal)
    copy(begun.rate, step.rate)
    if relaxed is not None:
        draw_back(relaxed, body.inverse, body.ω, step.rate)
    copy(step.rate, step.changed)
    r = state.halves[1]
    begin_points(points, state.halves[0] * body.inverse_ω, step.rate)
    if relaxed is not None:
        draw_points_back(relaxed, points)
    points.pushed[:] = 0.0
    points.seen[:] = 0.0
    copy(points.free, points.inside)
    v, ω = vector(now, OF_BASE), vector(now, SPIN)
    place_points(points, r, R, vector(now, POSITION), v, ω, step.places, step.velocities)
    look_at_travel(h, step.velocities, travel)
    return bool(np.isfinite(step.rate.sum() + points.free.sum()))


@jit_part
def look_at_travel(h: float, velocities: Array, travel: Array) -> None:
    """Sets how far a body goes as a whole, (3,), and a point beside, m, from velocities (P, 3)."""
    P = len(velocities)
    for k in range(3):
        travel[k] = 0.0
        for p in range(P):
            travel[k] += velocities[p, k] / P
    largest = 0.0
    for p in range(P):
        beside = added(vector(velocities[p], 0), -1.0, vector(travel, 0))
        largest = max(largest, dot(beside, beside))
    for k in range(3):
        travel[k] *= h
    travel[3] = 2 * h * largest**0.5


@jit_part
def try_soft(table: Array) -> None:
    """Finds how a body moves under the forces on its points."""
    body, state, points, step = body_at(table), state_at(table), points_at(table), step_at(table)
    see_forces(points, rows_in(step.turn, START), vector(step.turn, TURN))
    if points.pushed.any():
        spread_some(points, inverse_of_carried(body, state))
        answer(points, step.rate, step.changed)
    else:
        copy(step.rate, step.changed)
        copy(points.free, points.inside)


class Moving(NamedTuple):
    """How the frame of a body moves points in a step: v = origin + turned y + outward û, of y when it begins."""

    origin: Vector
    turned: Rotation
    outward: Rotation


@jit_part
def moving_of(turn: Array, h: float) -> Moving:
    """In world axes: with R* v̂ + (R* ω̂) × (R y + R⁺ (y + h û))/2 + R* û."""
    a, b, c = rows_in(turn, START)
    d, e, f = rows_in(turn, END)
    x, y, z = vector(turn, SPUN)
    first, second, third = mean(a, d), mean(b, e), mean(c, f)
    none = (0.0, 0.0, 0.0)
    turned = (
        added(added(none, -z, second), y, third),
        added(added(none, z, first), -x, third),
        added(added(none, -y, first), x, second),
    )
    return Moving(vector(turn, ORIGIN), turned, outward_of(turn, h))


@jit_part
def velocity_at(moving: Moving, y: Vector, û: Vector) -> Vector:
    """Of a point in the middle of the step, in world axes, m/s."""
    return added(added(moving.origin, 1.0, rotated(moving.turned, y)), 1.0, rotated(moving.outward, û))


@jit_part
def outward_of(turn: Array, h: float) -> Rotation:
    """What motions in the frame move points by in world axes: R* + h/2 (R* ω̂)~ R⁺."""
    a, b, c = rows_in(turn, END)
    x, y, z = vector(turn, SPUN)
    first, second, third = rows_in(turn, MIDDLE)
    first = added(added(first, -h / 2 * z, b), h / 2 * y, c)
    second = added(added(second, h / 2 * z, a), -h / 2 * x, c)
    third = added(added(third, -h / 2 * y, a), h / 2 * x, b)
    return first, second, third


@jit_apart
def end_soft(table: Array, h: float) -> None:
    """Takes the step of a linear body under the forces that were tried last."""
    _end(table, h, None, None)


@jit_apart
def end_relaxing(table: Array, h: float) -> None:
    """The same of one whose material relaxes, of small strains."""
    _end(table, h, None, relaxed_in(table[RELAXED:]))


@jit_apart
def end_bent(table: Array, h: float) -> None:
    """The same of one that deforms largely."""
    bent = bending_of(table)
    _end(table, h, bent, None)
    copy(points_at(table).forces, bent.pressed)


@jit_part
def _end(table: Array, h: float, bent: Bending | None, relaxed: Relaxed | None) -> None:
    """The same."""
    body, loads, state, points, step = (
        body_at(table), loads_at(table), state_at(table), points_at(table), step_at(table),
    )  # fmt: skip
    turn, told = step.turn, step.told
    force = torque = (0.0, 0.0, 0.0)
    power = 0.0
    R, t, end, moving = rows_in(turn, START), vector(turn, TURN), rows_in(turn, END), moving_of(turn, h)
    for p in range(len(points.rest)):
        if points.pushed[p]:
            f, y, û = vector(points.forces[p], 0), vector(points.start[p], 0), vector(points.inside[p], 0)
            force = added(force, 1.0, f)
            torque = added(torque, 1.0, cross(mean(rotated(R, y), rotated(end, added(y, h, û))), f))
            power += dot(f, velocity_at(moving, y, û))
    acting, q = act(loads, step.u, len(body.ω)), state.halves[0] * body.inverse_ω
    if bent is not None:
        acting = pressed_rims(bent, step.u, q, h, acting)
    twist = vector(turn, V), vector(turn, Ω), vector(turn, V_END), vector(turn, Ω_END)
    begun = Begun(
        TAKEN, R, rows_in(turn, END), t, twist[0], twist[1], twist[2], twist[3], acting, step.modal, step.rate
    )
    push = Push(force, torque, seen(R, t, torque))
    watch = watch_at(table)
    taken = end_carried_step(body, loads, begun, step.base, step.changed, push, state, watch, bent)
    if relaxed is None:
        lost, stored = end_points(points, h, points.rows[:0])
    else:
        of_points, within = relax_points(relaxed, points, h), relax(relaxed, body.ω, step.changed)
        lost, stored = of_points[0] + within[0], of_points[1] + within[1]
    told[SQUARE], told[WITHIN] = taken.square + stored, taken.within
    told[SUPPLIED], told[DISSIPATED], told[BY_OTHERS] = taken.supplied, taken.dissipated + lost, h * power


@jit_part
def mount_on(carrier: Array, table: Array) -> None:
    """Sets the base of a body from what carries it (13,): `world.driven.mounted`."""
    mount, base = vector_at(table[STEP + 1]), vector_at(table[STEP + 2])
    R = rotation_of(*rotation_in(carrier))
    arm, ω = rotated(R, vector(mount, POSITION)), vector(carrier, TURNING)
    put(base, POSITION, added(vector(carrier, POSITION), 1.0, arm))
    (s, t, u, v), (w, x, y, z) = rotation_in(carrier), rotation_in(mount)
    a, b = s * w - t * x - u * y - v * z, s * x + t * w + u * z - v * y
    c, d = s * y + u * w + v * x - t * z, s * z + v * w + t * y - u * x
    size = (a * a + b * b + c * c + d * d) ** 0.5
    base[3], base[4], base[5], base[6] = a / size, b / size, c / size, d / size
    put(base, VELOCITY, added(vector(carrier, VELOCITY), 1.0, cross(ω, arm)))
    put(base, TURNING, ω)
