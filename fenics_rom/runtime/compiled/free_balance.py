"""What the step of a free linear body balances, and the velocities that do: `steppers.free_balance`, compiled.

Unknowns are ω̂ and r̂; Newton's method keeps its slopes while they pay, as `steppers.kept_newton` does.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.frames import (
    BENT,
    BY_RATE,
    COUPLED,
    GIVEN,
    INERTIA,
    MOTION,
    MOVED,
    REST,
    ROWS,
    TURNED,
    TURNED_BY_RATE,
    TURNING,
    Acting,
    Body,
    Loads,
    State,
    added,
    combine,
    cross,
    dot,
    inertia_in,
    is_definite,
    mean,
    pairs,
    push_points,
    put,
    rotated_back,
    rotation_in,
    rotation_of,
    solved_inertia,
    times_inertia,
    torque_of,
    turned,
    vector,
)
from fenics_rom.runtime.compiled.kept_slopes import SCALE, begin_search, has_ended, keep_inverse, lacks_slopes
from fenics_rom.runtime.steppers.inertia import MOST_ITERATIONS, Inertia

SPIN, MOMENTUM = MOTION, MOTION + 3  # in `State.now`: ω and L
IS_PASSED, LENGTH, PASSED = 1, REST + 1, REST + 2  # in `State.kept`: whether the step before is known; its h, ω̂ and r̂


@jit_part
def find_motion(most: float, e: Array, table: Array, now: Array) -> bool:
    """Sets how the frame moves, of the shape that is known; whether its kinetic energy is positive definite.

    It is for sure up to |e|² = `most`.
    """
    inertia = inertia_in(now)
    if not e.dot(e) <= most:
        squares = np.empty((3, 3))
        for k in range(3):
            for n in range(3):
                squares[k, n] = table[COUPLED + k].dot(table[COUPLED + n])
        if not is_definite(inertia, squares):
            return False
    L = rotated_back(rotation_of(*rotation_in(now)), vector(now, TURNING))
    put(now, SPIN, solved_inertia(inertia, added(L, -1.0, vector(now, MOVED))))
    put(now, MOMENTUM, L)
    return True


@jit_part
def turn_at(h: float, x: Array, now: Array) -> tuple[Vector, Rotation]:
    """By how much the frame turns in a step, and R at its end."""
    t = (h * x[0], h * x[1], h * x[2])
    return t, rotation_of(*turned(rotation_in(now), t))


@jit_part
def lack(
    body: Body, loads: Loads, acting: Acting, q: Array, R: Rotation, x: Array, now: Array, table: Array, ρ: Array
) -> tuple[Inertia, Vector]:
    """Sets what the balances lack at x, (3 + m,); I and L at the end."""
    h, m, r̂ = body.h, len(q), x[3:]
    ω, ω̂, L = vector(now, SPIN), vector(x, 0), vector(now, MOMENTUM)
    (A, B, C), (a, b, c) = ω, ω̂
    ω_end = 2 * a - A, 2 * b - B, 2 * c - C
    rated, bent = table[BY_RATE:].reshape(10 * m), table[BENT:COUPLED].reshape(6 * m)
    combine(r̂, body.by_rate, rated)
    for k in range(6 * m):
        rated[k] += bent[k]
    xx, yy, zz, yz, xz, xy = pairs(ω, ω_end)
    factors = np.empty(ROWS - GIVEN)
    factors[0], factors[-1] = 1.0, 1.0  # f0, and what r̂ itself is held by
    put(factors, 1, (2 / h * (a - A), 2 / h * (b - B), 2 / h * (c - C)))  # T
    put(factors, 4, (-xx, -yy, -zz))
    put(factors, 7, (-yz, -xz, -xy))  # S
    put(factors, 10, (2 * a, 2 * b, 2 * c))  # G r̂
    combine(factors, table[GIVEN:], ρ[3:])
    gained = np.dot(table[TURNED:TURNED_BY_RATE], r̂)
    inertia = (
        now[INERTIA] + 2 * h * gained[3],
        now[INERTIA + 1] + 2 * h * gained[4],
        now[INERTIA + 2] + 2 * h * gained[5],
        now[INERTIA + 3] + 2 * h * gained[6],
        now[INERTIA + 4] + 2 * h * gained[7],
        now[INERTIA + 5] + 2 * h * gained[8],
    )
    L_end = added(added(times_inertia(inertia, ω_end), 2.0, vector(gained, 0)), -1.0, vector(now, MOVED))
    torque = torque_of(acting, q, h, r̂)
    if len(acting.at_points):
        modal, (t, end) = np.empty(m), turn_at(h, x, now)
        _, _, turning = push_points(loads, acting.at_points, R, end, t, q, h, r̂, modal)
        torque = added(torque, 1.0, turning)
        for i in range(m):
            ρ[3 + i] -= modal[i]
    turned_on = added(added((0.0, 0.0, 0.0), 0.5, cross(ω̂, added(L, 1.0, L_end))), -1.0, torque)
    put(ρ, 0, added(turned_on, 1 / h, added(L_end, -1.0, L)))
    return inertia, L_end


@jit_part
def set_slopes(body: Body, inertia: Inertia, L_end: Vector, x: Array, now: Array, table: Array, slopes: Array) -> None:
    """Those of what the balances lack with ω̂ and r̂ (3 + m, 3 + m), at x, of which the table is; forces stay."""
    h, m, ω, (a, b, c) = body.h, len(body.ω), vector(now, SPIN), vector(x, 0)
    ω_end = 2 * a - ω[0], 2 * b - ω[1], 2 * c - ω[2]
    u, v, w = mean(vector(now, MOMENTUM), L_end)
    xx, yy, zz, yz, xz, xy = inertia
    columns = (2 * xx, 2 * xy, 2 * xz), (2 * xy, 2 * yy, 2 * yz), (2 * xz, 2 * yz, 2 * zz)
    put(slopes[0], 0, added(_carried(columns[0], (a, b, c), h), -1.0, (0.0, w, -v)))
    put(slopes[1], 0, added(_carried(columns[1], (a, b, c), h), -1.0, (-w, 0.0, u)))
    put(slopes[2], 0, added(_carried(columns[2], (a, b, c), h), -1.0, (v, -u, 0.0)))
    for k in range(3):
        for n in range(k):
            slopes[k, n], slopes[n, k] = slopes[n, k], slopes[k, n]
    factors, of_shape = np.empty(10), np.empty(m * m)
    xx, yy, zz, yz, xz, xy = pairs(ω, ω_end)
    put(factors, 0, (-xx, -yy, -zz))
    put(factors, 3, (-yz, -xz, -xy))
    put(factors, 6, (2 * a, 2 * b, 2 * c))
    factors[9] = 1.0
    combine(factors, body.products, of_shape)
    for i in range(m):
        turned_on, by_rate = vector(table[TURNED:BY_RATE, i], 0), vector(table[TURNED_BY_RATE:, i], 0)
        bent = _contracted(table[BY_RATE:TURNED_BY_RATE, i], ω_end)
        along = added(added(turned_on, 2 * h, bent), -h, _contracted(table[BENT:COUPLED, i], ω_end))
        across = added(added(turned_on, h, by_rate), -h, _contracted(table[BY_RATE:TURNED_BY_RATE, i], ω))
        x_, y_, z_ = _carried(along, (a, b, c), h)
        slopes[0, 3 + i], slopes[1, 3 + i], slopes[2, 3 + i] = 2 * x_, 2 * y_, 2 * z_
        put(slopes[3 + i], 0, added((0.0, 0.0, 0.0), 2 / h, across))
        for j in range(m):
            slopes[3 + i, 3 + j] = of_shape[m * i + j]


@jit_part
def _carried(a: Vector, ω̂: Vector, h: float) -> Vector:
    """(1/h + ω̂~/2) a."""
    return added(added((0.0, 0.0, 0.0), 1 / h, a), 0.5, cross(ω̂, a))


@jit_part
def _contracted(entries: Array, ω: Vector) -> Vector:
    """Σ_l ω_l X_kl of the six entries of a symmetric X."""
    x, y, z = ω
    return (
        x * entries[0] + z * entries[4] + y * entries[5],
        y * entries[1] + z * entries[3] + x * entries[5],
        z * entries[2] + y * entries[3] + x * entries[4],
    )


@jit_part
def size_of(weight: float, x: Array) -> float:
    """Of velocities, as √(2 J)."""
    r̂ = x[3:]
    return math.sqrt(weight * (x[0] ** 2 + x[1] ** 2 + x[2] ** 2) + r̂.dot(r̂))


@jit_part
def keep_slopes(body: Body, inertia: Inertia, L_end: Vector, x: Array, state: State) -> None:
    """Keeps the inverse slopes at x, of which the table is; I and L at the end are those that `lack` gives."""
    slopes = np.empty((len(x), len(x)))
    set_slopes(body, inertia, L_end, x, state.now[0], state.table, slopes)
    keep_inverse(slopes, state)


@jit_part
def speed_at(body: Body, x: Array, state: State) -> float:
    """Of the velocities of the step at its start and at x, but for translation."""
    weight, ω, r = weight_of(body), vector(state.now[0], SPIN), state.halves[1]
    return size_of(weight, x) + math.sqrt(weight * dot(ω, ω) + r.dot(r))


@jit_part
def weight_of(body: Body) -> float:
    """By which ω̂ counts among velocities: that of a mean inertia."""
    return (body.rigid[0] + body.rigid[1] + body.rigid[2]) / 3


@jit_part
def correct(body: Body, x: Array, ρ: Array, state: State) -> float:
    """Corrects x by what the balances lack; the size of the correction."""
    change = np.dot(state.slopes, ρ)
    for k in range(len(x)):
        x[k] -= change[k]
    return size_of(weight_of(body), change)


@jit_part
def solve(body: Body, loads: Loads, acting: Acting, q: Array, R: Rotation, x: Array, state: State) -> bool:
    """Corrects x until nothing changes; whether that ended."""
    search, ρ = begin_search(state), np.empty(len(x))
    for _ in range(MOST_ITERATIONS):
        inertia, L_end = lack(body, loads, acting, q, R, x, state.now[0], state.table, ρ)
        if lacks_slopes(state, search):
            keep_slopes(body, inertia, L_end, x, state)
        size = correct(body, x, ρ, state)
        if search[SCALE] == 0.0:
            search[SCALE] = speed_at(body, x, state)
        if has_ended(size, state, search):
            return True
        if not math.isfinite(size):
            return False
    return False
