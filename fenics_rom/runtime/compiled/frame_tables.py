"""Linear bodies in moving frames whose arrays are in a table, as each that is handed over takes time."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.runtime.compiled.arrays_at import integers_at, matrix_at, vector_at
from fenics_rom.runtime.compiled.frames import TAKEN, Body, Loads, State, Step, Taken, Watch, note, restore

LOADS, STATE, WATCH, ROWS = 10, 15, 21, 24  # where a table has these after the body, and how many rows it has


def arrays_of(body: Body, loads: Loads, state: State, watch: Watch) -> tuple[Array, ...]:
    """What a table has, in its order."""
    numbers = np.array([body.h, body.mass, body.couples, body.is_definite, body.size])
    return numbers, *body[5:], *loads, *state, np.array([watch.farthest, watch.limit]), *watch[2:]


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
def keep_step(table: Array, step: Step, taken: Taken, count: int) -> bool:
    """Notes a step of steps in a row; False where it was not taken. One whose energy is not finite is taken back."""
    if step.status == TAKEN and math.isfinite(step.square):
        note(body_at(table), state_at(table), step, taken, count)
        return True
    if step.status == TAKEN:
        restore(state_at(table))
    return False
