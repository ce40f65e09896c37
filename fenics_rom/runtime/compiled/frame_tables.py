"""Linear bodies in moving frames whose arrays are in a table, as each that is handed over takes time."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.runtime.compiled.arrays_at import cube_at, integers_at, matrix_at, vector_at
from fenics_rom.runtime.compiled.bent_frame import Bending, Rims, note_shape, restore_shape
from fenics_rom.runtime.compiled.following import Following
from fenics_rom.runtime.compiled.frames import TAKEN, Body, Loads, State, Step, Taken, Watch, note, restore
from fenics_rom.runtime.compiled.held_table import law_at, memory_at

LOADS, STATE, WATCH, ROWS = 10, 15, 21, 24  # where a table has these after the body, and how many rows it has
# Of a body that deforms largely: what its law carries along, and `Bending` after edges of open surfaces.
MEMORY, OF_STEP = 41, 53
HALVES, NOW, KEPT, NOTES = STATE, STATE + 2, STATE + 4, WATCH + 2  # rows of what a body has for itself: its state,
VECTORS, CARRIED, STRAINED, RELAXED, IS_KNOWN = MEMORY, MEMORY + 2, MEMORY + 3, MEMORY + 5, OF_STEP + 1
BEFORE = OF_STEP + 6  # v̂, what is carried, its numbers and branches before the last step: four rows
OWN = *range(STATE, STATE + 6), NOTES
BENT = *range(MEMORY, MEMORY + 6), IS_KNOWN, OF_STEP + 2, OF_STEP + 3, *range(OF_STEP + 5, OF_STEP + 10)
# Rows of what a step of such a body needs for itself alone; and of products that a free one makes anew in each.
IN_A_STEP, REMADE = (MEMORY + 6, MEMORY + 7, OF_STEP, OF_STEP + 4, OF_STEP + 10), (4, 5)


def arrays_of(body: Body, loads: Loads, state: State, watch: Watch, bent: Bending | None = None) -> tuple[Array, ...]:
    """What a table has, in its order."""
    numbers = np.array([body.h, body.mass, body.couples, body.is_definite, body.size])
    arrays = numbers, *body[5:], *loads, *state, np.array([watch.farthest, watch.limit]), *watch[2:]
    if bent is None:
        return arrays
    law, rims = bent.law, (*bent.rims[:3], bent.rims.shapes.reshape(len(bent.rims.shapes), -1, 3))
    return *arrays, np.array(law[:6]), *bent.loads, *law[6:-1], *law.points, *bent.memory, *rims, *bent[4:]


@jit_part
def body_at(table: Array) -> Body:
    """What a table has of a body."""
    n = vector_at(table[0])
    arrays = vector_at(table[1]), vector_at(table[2]), matrix_at(table[3]), matrix_at(table[4]), matrix_at(table[5])
    rest = matrix_at(table[6]), matrix_at(table[7]), matrix_at(table[8]), vector_at(table[9])
    ω, inverse_ω, D, products, by_rate = arrays
    by_shape, inverse, of_rest, rigid = rest
    is_coupled = n[2] != 0.0
    return Body(
        n[0], n[1], is_coupled, n[3], n[4], ω, inverse_ω, D, products, by_rate, by_shape, inverse, of_rest, rigid
    )


@jit_part
def loads_at(table: Array) -> Loads:
    """The same of its loads."""
    t = table[LOADS:]
    return Loads(matrix_at(t[0]), matrix_at(t[1]), integers_at(t[2]), matrix_at(t[3]), matrix_at(t[4]))


@jit_part
def state_at(table: Array) -> State:
    """The same of its state."""
    t = table[STATE:]
    return State(matrix_at(t[0]), matrix_at(t[1]), matrix_at(t[2]), matrix_at(t[3]), vector_at(t[4]), matrix_at(t[5]))


@jit_part
def watch_at(table: Array) -> Watch:
    """The same of what looks at it."""
    t = table[WATCH:]
    numbers = vector_at(t[0])
    return Watch(numbers[0], numbers[1], matrix_at(t[1]), vector_at(t[2]))


@jit_part
def bent_at(table: Array) -> Bending:
    """The same of what a body has that deforms largely."""
    t = table[ROWS:]
    n, following = (
        vector_at(t[0]),
        (integers_at(t[1]), cube_at(t[2]), integers_at(t[3]), matrix_at(t[4]), cube_at(t[5])),
    )
    law = law_at(n, t[6:])
    memory, rest = memory_at(t[17:]), t[29:]
    edges = integers_at(t[25]), integers_at(t[26]), cube_at(t[27]), cube_at(t[28])
    of_step = matrix_at(rest[0]), vector_at(rest[1]), matrix_at(rest[2]), matrix_at(rest[3]), vector_at(rest[4])
    before = vector_at(rest[6]), matrix_at(rest[7]), vector_at(rest[8]), cube_at(rest[9])
    loads = Following(following[0], following[1], following[2], following[3], following[4])
    rims = Rims(edges[0], edges[1], edges[2], edges[3].reshape(edges[3].shape[0], 2, edges[3].shape[1] // 2, 3))
    return Bending(
        law,
        loads,
        rims,
        memory,
        of_step[0],
        of_step[1],
        of_step[2],
        of_step[3],
        of_step[4],
        matrix_at(rest[5]),
        before[0],
        before[1],
        before[2],
        before[3],
        vector_at(rest[10]),
    )


@jit_part
def keep_step(table: Array, step: Step, taken: Taken, count: int, bent: Bending | None) -> bool:
    """Notes a step of steps in a row; False where it was not taken. One whose energy is not finite is taken back."""
    if step.status == TAKEN and math.isfinite(step.square):
        note(body_at(table), state_at(table), step, taken, count)
        if bent is not None:
            note_shape(bent, taken.noted[count])
        return True
    if step.status == TAKEN:
        restore(state_at(table))
        if bent is not None:
            restore_shape(bent)
    return False
