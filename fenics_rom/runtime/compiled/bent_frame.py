"""What a body in a moving frame that deforms largely has beside `frames.Body`, and how its steps are expected.

`steppers.free_balance._expect` and `steppers.carried_balance._strained`, compiled.

The law of `carried_strains` says f̂ = pull + matrix v̂ of a step once that is expected. What it says goes where a linear
body has its stiffness: `matrix` into the last of its products, `pull` into the row of the table that no rate changes.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import copy, copy_rows
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.branches import stored_in
from fenics_rom.runtime.compiled.carried_strains import (
    AHEAD,
    ENERGY,
    GAP,
    HAS_TANGENT,
    IS_AHEAD,
    IS_CARRIED,
    LEFT,
    MADE_TANGENT,
    VELOCITY,
    Law,
    Memory,
    Strains,
    add_force_ahead,
    add_inertia,
    close,
    expect,
    look_ahead,
    set_slope,
    strains_in,
)
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.following import Following, add_following
from fenics_rom.runtime.compiled.frames import (
    Acting,
    Body,
    Loads,
    State,
    added,
    cross,
    give_without_springs,
    mean,
    put,
    rotated,
    seen,
    vector,
)
from fenics_rom.runtime.compiled.free_balance import lack, set_slopes, turn_at
from fenics_rom.runtime.compiled.small_matrices import dot, factor, solve
from fenics_rom.runtime.steppers.elastic.carried_strains import TANGENT_RENEWAL

FOLLOWED, PULL, LACKED, WHOLE = range(4)  # rows of `Bending.vectors`
IS_INVERSE_KNOWN = 0  # in `Bending.kept`


class Rims(NamedTuple):
    """Edges of open surfaces under pressure, by G pieces: `rom.deformation.ReducedRim`."""

    columns: Array  # of the inputs (k,)
    starts: Array  # of their pieces (k + 1,)
    at_rest: Array  # points (2, G, 3) from the frame's origin, and pieces dy there, m
    shapes: Array  # (m, 2, G, 3) what they are with q


class Bending(NamedTuple):
    """What resists the shape of a body with m modes, and what follows it."""

    law: Law
    loads: Following
    rims: Rims
    memory: Memory  # whose T has the inertia 2/h, too
    # (4, m): of loads that follow, in the step; for what is found on the way; what the balance lacked where v̂ was
    # expected from, and v̂ that came of it.
    vectors: Array
    kept: Array  # (1,) whether the next two are known
    inverse: Array  # of T (m, m); of a carried body of T and its A
    slopes: Array  # inverse ones of a free body (3 + m, 3 + m) that steps are expected with; else (0, 0)
    guide: Array  # ω̂ and r̂ (3 + m,) of a free body from where the step was expected; else (0,)
    pressed: Array  # contact forces in the last step (P, 3), N
    velocity_before: Array  # v̂ (m,),
    carried_before: Array  # ε and C₀ε,
    numbers_before: Array  # numbers of `Strains`
    relaxed_before: Array  # and strains of branches before the last step
    felt: Array  # (9,): acceleration less gravity's, angular acceleration and spin in it, in the frame's axes


@jit_part
def pressed_rims(bent: Bending, u: Array, q: Array, h: float, acting: Acting) -> Acting:
    """What acts, with pressures on open surfaces where the shape q (m,) is in the middle if it moves on as it did."""
    rims, v, force, torque = bent.rims, bent.memory.vectors[VELOCITY], acting.force, acting.torque
    for k in range(len(rims.columns)):
        size = u[rims.columns[k]]
        if size == 0:
            continue
        for g in range(rims.starts[k], rims.starts[k + 1]):
            y, dy = vector(rims.at_rest[0, g], 0), vector(rims.at_rest[1, g], 0)
            for i in range(len(q)):
                there, rows = q[i] + h / 2 * v[i], rims.shapes[i]
                y, dy = added(y, there, vector(rows[0, g], 0)), added(dy, there, vector(rows[1, g], 0))
            square = y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
            force, torque = added(force, -size / 2, cross(y, dy)), added(torque, size / 2 * square, dy)
    return Acting(acting.modal, force, torque, acting.acceleration, acting.by_shape, acting.at_points)


@jit_part
def expect_free(
    body: Body,
    loads: Loads,
    acting: Acting,
    u: Array,
    q: Array,
    R: Rotation,
    x: Array,
    state: State,
    bent: Bending,
    points: Points | None,
) -> None:
    """Corrects ω̂ and r̂ of x (3 + m,) once, and has the body be held by what its law says of a step near that.

    What touched in the step before touches.
    """
    h, m, strains, table, now = body.h, len(q), strains_in(bent.memory), state.table, state.now[0]
    r, r̂, v, T, ρ = state.halves[1], x[3:], strains.velocity, strains.tangent, np.empty(len(x))
    pull, lacked, whole = bent.vectors[PULL], bent.vectors[LACKED], bent.vectors[WHOLE]
    _look(bent, strains, u, q, h)
    for i in range(m):
        r̂[i] = v[i]
        pull[i] += 2 / h * v[i] - dot(T[i], v)
    _hold_by(body, T)
    give_without_springs(body, acting.modal, pull, r, table)
    inertia, L_end = lack(body, loads, acting, q, R, x, now, table, ρ)
    if points is not None:
        (t, end), modal = turn_at(h, x, now), np.zeros(m)
        turning = _push_as_before(points, bent.pressed, R, end, t, q, r̂, h, modal)
        put(ρ, 0, added(vector(ρ, 0), -1.0, turning))
        for i in range(m):
            ρ[3 + i] -= modal[i]
    if not bent.kept[IS_INVERSE_KNOWN]:
        slopes = np.empty((3 + m, 3 + m))
        set_slopes(body, inertia, L_end, x, now, table, slopes)
        copy_rows(np.linalg.inv(slopes), bent.slopes)
        copy_rows(np.linalg.inv(T), bent.inverse)
        bent.kept[IS_INVERSE_KNOWN] = 1.0
    copy(x, bent.guide)
    for i in range(m):  # of the shape alone: next to nothing of it comes of how the frame turns
        lacked[i], whole[i] = ρ[3 + i], r̂[i] - dot(bent.inverse[i], ρ[3:])
    for k in range(3 + m):
        x[k] -= dot(bent.slopes[k], ρ)
    _expect(bent, strains, u, q)
    _hold_by(body, strains.matrix)
    give_without_springs(body, acting.modal, pull, r, table)


@jit_part
def expect_carried(
    h: float,
    u: Array,
    q: Array,
    R: Rotation,
    t: Vector,
    A: Array,
    right: Array,
    is_same: bool,
    bent: Bending,
    points: Points | None,
) -> None:
    """Adds to A (m, m) and to the right-hand side (m,) of a carried body what its law says of a step.

    They are without what resists the shape; `is_same`: A is that of the step before.
    """
    m, strains, kept = len(q), strains_in(bent.memory), bent.kept
    v, T, pull, lacked, whole = (
        strains.velocity,
        strains.tangent,
        bent.vectors[PULL],
        bent.vectors[LACKED],
        bent.vectors[WHOLE],
    )
    _look(bent, strains, u, q, h)
    modal = np.zeros(m)
    if points is not None:
        _push_as_before(points, bent.pressed, R, R, t, q, v, h, modal)
    for i in range(m):
        lacked[i] = dot(A[i], v) - right[i] + pull[i] - modal[i]
    if not (is_same and kept[IS_INVERSE_KNOWN]):
        slopes = A + T
        for i in range(m):
            slopes[i, i] -= 2 / h
        copy_rows(np.linalg.inv(slopes), bent.inverse)
        kept[IS_INVERSE_KNOWN] = 1.0
    for i in range(m):
        whole[i] = v[i] - dot(bent.inverse[i], lacked)
    _expect(bent, strains, u, q)
    for i in range(m):
        right[i] -= pull[i]
        for j in range(m):
            A[i, j] += strains.matrix[i, j]
        A[i, i] -= 2 / h


@jit_part
def solve_held(bent: Bending, given: Array, rate: Array) -> bool:
    """Sets r̂ (m,) where nothing but the law, inertia and given forces hold the shape; whether there is one."""
    strains = strains_in(bent.memory)
    copy(strains.matrix, strains.matrices)
    if not factor(strains.matrices):
        return False
    for i in range(len(rate)):
        rate[i] = -given[i]
    solve(strains.matrices, rate)
    return True


@jit_part
def end_shape(bent: Bending, q: Array, after: Array, v: Array) -> float:
    """Ends the law's step with v̂ from q to q⁺ (m,); what it dissipates, J."""
    strains, missed = strains_in(bent.memory), 0.0
    for i in range(len(v)):
        missed += (v[i] - strains.expected[i]) ** 2
    goes_as_expected = not missed > TANGENT_RENEWAL**2 * dot(v, v)
    heat = close(bent.law, strains, q, after, v)
    strains.numbers[HAS_TANGENT] = 1.0 if goes_as_expected else 0.0
    return heat


@jit_part
def twice_strained(bent: Bending, q: Array) -> float:
    """Twice what is stored at q (m,), where a step led, J."""
    numbers, square = bent.memory.numbers, 0.0
    for i in range(len(q)):
        square += q[i] * dot(bent.law.springs[i], q)
    within = numbers[ENERGY] + numbers[LEFT] + stored_in(bent.law.branches, bent.memory.relaxed)
    return square + 2 * within


@jit_part
def note_shape(bent: Bending, noted: Array) -> None:
    """Writes of a step in a row (11,): twice the energy of strains, J, the square of what is lacking, what was felt."""
    noted[0], noted[1] = 2 * bent.memory.numbers[AHEAD], bent.memory.numbers[GAP]
    for k in range(9):
        noted[2 + k] = bent.felt[k]


@jit_part
def remember_shape(bent: Bending) -> None:
    """Notes where the law is before a step."""
    numbers = bent.memory.numbers
    copy(numbers, bent.numbers_before)
    copy(bent.memory.vectors[VELOCITY], bent.velocity_before)
    copy(bent.memory.relaxed, bent.relaxed_before)
    if numbers[IS_CARRIED]:
        copy(bent.memory.carried, bent.carried_before)


@jit_part
def restore_shape(bent: Bending) -> None:
    """Has the law be where it was before the step; what is known ahead of it is found anew.

    T is what it was, if there was one: steps that have one do not change it.
    """
    numbers = bent.memory.numbers
    copy(bent.numbers_before, numbers)
    copy(bent.velocity_before, bent.memory.vectors[VELOCITY])
    copy(bent.relaxed_before, bent.memory.relaxed)
    numbers[IS_AHEAD] = 0.0
    if numbers[IS_CARRIED]:
        copy(bent.carried_before, bent.memory.carried)


@jit_part
def _look(bent: Bending, strains: Strains, u: Array, q: Array, h: float) -> None:
    """Sets what resists the shape and follows it in the middle of the step, if v̂ stays; T, if there is none."""
    law, numbers, v, pull, followed = (
        bent.law,
        strains.numbers,
        strains.velocity,
        bent.vectors[PULL],
        bent.vectors[FOLLOWED],
    )
    if not numbers[IS_AHEAD]:
        look_ahead(law, strains, q, v)
    numbers[MADE_TANGENT] = 1.0 - numbers[HAS_TANGENT]
    if not numbers[HAS_TANGENT]:
        set_slope(law, strains, q, strains.tangent)
        numbers[HAS_TANGENT], bent.kept[IS_INVERSE_KNOWN] = 1.0, 0.0
    for i in range(len(q)):
        pull[i], followed[i], strains.at[i] = 0.0, 0.0, q[i] + h / 2 * v[i]
    add_force_ahead(law, strains, q, pull)
    add_following(bent.loads, u, strains.at, strains.products[0], followed)
    for i in range(len(q)):
        pull[i] -= followed[i]


@jit_part
def _expect(bent: Bending, strains: Strains, u: Array, q: Array) -> None:
    """Sets what the law says of a step that is expected, less loads that follow; its matrix with inertia."""
    pull, followed = bent.vectors[PULL], bent.vectors[FOLLOWED]
    expect(bent.law, strains, q, bent.vectors[WHOLE])
    add_inertia(bent.law, strains.matrix)
    for i in range(len(q)):
        followed[i] = 0.0
    add_following(bent.loads, u, strains.at, strains.products[0], followed)
    for i in range(len(q)):
        pull[i] = strains.pull[i] - followed[i]


@jit_part
def _hold_by(body: Body, matrix: Array) -> None:
    """Has a matrix (m, m) be what r̂ itself is held by."""
    m = len(matrix)
    for i in range(m):
        for j in range(m):
            body.products[9, m * i + j] = body.by_rate[i, 9 * m + j] = matrix[i, j]


@jit_part
def _push_as_before(
    points: Points, forces: Array, R: Rotation, end: Rotation, t: Vector, q: Array, rate: Array, h: float, modal: Array
) -> Vector:
    """Adds what forces (P, 3) on contact points do on the coordinates (m,) at r̂; R*ᵀ of their torque."""
    torque = (0.0, 0.0, 0.0)
    for p in range(len(forces)):
        f = vector(forces[p], 0)
        if f == (0.0, 0.0, 0.0):
            continue
        y, moved, g = vector(points.rest[p], 0), (0.0, 0.0, 0.0), seen(R, t, f)
        if len(points.R):
            y = added(y, 1.0, vector(points.beyond[1], 3 * p))
        for i in range(len(q)):
            row = vector(points.rows[i], 3 * p)
            y, moved = added(y, q[i], row), added(moved, rate[i], row)
            modal[i] += g[0] * row[0] + g[1] * row[1] + g[2] * row[2]
        torque = added(torque, 1.0, cross(mean(rotated(R, y), rotated(end, added(y, h, moved))), f))
    return seen(R, t, torque)
