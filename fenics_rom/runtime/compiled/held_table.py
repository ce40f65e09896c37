"""The step of `held_step` of a body that nothing touches or pulls by strokes, and all that is noted of it.

Its arrays are in a table, as each that is handed over takes time.
"""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.arrays_at import cube_at, integers_at, matrix_at, vector_at
from fenics_rom.runtime.compiled.carried_strains import (
    AHEAD,
    GAP,
    HAS_TANGENT,
    IS_CARRIED,
    MADE_TANGENT,
    VELOCITY,
    Law,
    Memory,
)
from fenics_rom.runtime.compiled.following import Following
from fenics_rom.runtime.compiled.held_step import take_step
from fenics_rom.runtime.compiled.held_touch import Body, motion_in
from fenics_rom.runtime.compiled.material_points import Points


class Noted(NamedTuple):
    """What is kept of a body that moves, and looked at in every step."""

    halves: Array  # e and r (2, m),
    velocity: Array  # v̂ (m,),
    carried: Array  # ε and C₀ε (2, n - 1)
    numbers: Array  # the numbers of `Strains`
    relaxed: Array  # and strains of branches, all before the last step
    inverse_limits: Array  # of inputs (p,)
    scale: Array  # of each mode, in what is `near` (m,)
    looked_at: Array  # a shape (m,)
    limits: Array  # (4,): of |u / limits|², |scale (q - looked_at)|, |q|, and of twice the energy of strains, J


def arrays_of(
    body: Body, memory: Memory, motion: tuple[Array, Array], pushed: Array, noted: Noted
) -> tuple[Array, ...]:
    """What a table has, in its order."""
    law = body.law
    return (*body[:3], *body.loads, *law[6:-1], *law.points, *memory, *motion, pushed, *noted)


@jit_part
def law_at(numbers: Array, table: Array) -> Law:
    """What eleven rows have of a law, with its numbers (6,)."""
    n, of_fibres = numbers, (integers_at(table[9]), matrix_at(table[10]))
    points = Points(matrix_at(table[6]), matrix_at(table[7]), integers_at(table[8]), of_fibres[0], of_fibres[1])
    D, K, steady = matrix_at(table[0]), matrix_at(table[1]), matrix_at(table[2])
    stiffness, gram, branches = matrix_at(table[3]), matrix_at(table[4]), matrix_at(table[5])
    return Law(n[0], n[1], n[2], n[3], n[4], n[5], D, K, steady, stiffness, gram, branches, points)


@jit_part
def memory_at(table: Array) -> Memory:
    """What eight rows have of a memory."""
    vectors, T, carried, numbers = matrix_at(table[0]), matrix_at(table[1]), matrix_at(table[2]), vector_at(table[3])
    rest = matrix_at(table[4]), cube_at(table[5]), cube_at(table[6]), matrix_at(table[7])
    return Memory(vectors, T, carried, numbers, rest[0], rest[1], rest[2], rest[3])


@jit
def take_step_at(table: Array, numbers: Array, u: Array, halves: Array) -> tuple[float, float, float, bool]:
    """Has e and r (2, m) be those after a step: twice the energy stored, supplied and dissipated, J, and if it is new.

    It is where it goes beyond a limit, and where T or the strains that are carried along change. Where no step is taken
    the first is NaN, and all but numbers is as it was. Numbers are those of the law, (6,).
    """
    following = Following(
        integers_at(table[3]), cube_at(table[4]), integers_at(table[5]), matrix_at(table[6]), cube_at(table[7])
    )
    law, memory = law_at(numbers, table[8:]), memory_at(table[19:])
    body = Body(vector_at(table[0]), vector_at(table[1]), matrix_at(table[2]), following, law, None)
    rest = table[27:]
    vectors, factor, pushed = matrix_at(rest[0]), matrix_at(rest[1]), vector_at(rest[2])
    noted = Noted(
        matrix_at(rest[3]),
        vector_at(rest[4]),
        matrix_at(rest[5]),
        vector_at(rest[6]),
        cube_at(rest[7]),
        vector_at(rest[8]),
        vector_at(rest[9]),
        vector_at(rest[10]),
        vector_at(rest[11]),
    )
    velocity, carried, now = memory.vectors[VELOCITY], memory.carried, memory.numbers
    copy(halves, noted.halves)
    copy(velocity, noted.velocity)
    copy(now, noted.numbers)
    copy(memory.relaxed, noted.relaxed)
    if now[IS_CARRIED]:
        copy(carried, noted.carried)
    step = take_step(body, u, halves, pushed, memory, vectors, factor, None, None)
    if step.status >= OTHERWISE:
        copy(noted.velocity, velocity)
        copy(noted.numbers, now)
        copy(noted.relaxed, memory.relaxed)
        if now[IS_CARRIED]:
            copy(noted.carried, carried)
        copy(halves[0], motion_in(vectors, factor).e)
        return math.nan, 0.0, 0.0, True
    motion = motion_in(vectors, factor)
    copy(motion.e, halves[0])
    copy(motion.r, halves[1])
    loaded, near, far = 0.0, 0.0, 0.0
    for k in range(len(u)):
        loaded += (u[k] * noted.inverse_limits[k]) ** 2
    for i in range(len(velocity)):
        q = motion.e[i] * body.inverse_ω[i]
        near += (noted.scale[i] * (q - noted.looked_at[i])) ** 2
        far += q * q
    limits = noted.limits
    is_near = loaded <= limits[0] and math.sqrt(near) <= limits[1] and math.sqrt(far) <= limits[2]
    is_old = is_near and 2 * now[AHEAD] <= limits[3] and now[GAP] == 0 and now[IS_CARRIED] == 0
    is_same = now[HAS_TANGENT] == 1 and now[MADE_TANGENT] == 0
    return step.square, step.supplied, step.dissipated, not (is_old and is_same)
