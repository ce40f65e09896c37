"""The step of `linear_step` of a body whose arrays are in a table, as each that is handed over takes time.

What a step finds is in one array, a record: three numbers in place of eleven arrays.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.compiled_arrays import unowned
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Law, Pairs
from fenics_rom.mechanics.compiled.copying import are_equal, copy
from fenics_rom.mechanics.compiled.gas import blow_in, keep_gas
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, moving_in
from fenics_rom.mechanics.compiled.searched_forces import Actuators
from fenics_rom.mechanics.compiled.work_space import take, take_flags, take_frames, take_integers, take_rows, work_space
from fenics_rom.runtime.compiled.arrays_at import cube_at, integer_rows_at, integers_at, matrix_at, vector_at
from fenics_rom.runtime.compiled.block_products import Blocks
from fenics_rom.runtime.compiled.linear_actuators import Pulled, set_strokes
from fenics_rom.runtime.compiled.linear_step import Body, State, Step, restore, room_for, step_in
from fenics_rom.runtime.compiled.near_points import Yielding
from fenics_rom.runtime.compiled.touching import Begun, Clearance, StepContact, hand_on
from fenics_rom.runtime.steppers.clearance import stretch_of

OF_A_STEP = 11  # numbers that a record begins with: a `Step`, and how many pairs friction was not asked to stop
_STATE, _OTHERS, _PULLED = 19, 31, 36  # where a table has these after the body


class Taken(NamedTuple):
    """Of steps in a row, one row each."""

    works: Array  # (n, 5), J: supplied, dissipated, by obstacles, contact and friction, as in `Step`
    q: Array  # (n, m) after it
    carried: Array  # g (n, 3P) beyond the basis after it, N; (n, 0) where there is nothing


class Record(NamedTuple):
    """What a step did, and found of contact."""

    numbers: Array  # (11,)
    found: StepContact
    after: Begun  # what the next step begins with: forces are those of the pairs


class Clear(NamedTuple):
    """How far a body is from obstacles, and where it and they were when that was known."""

    clearance: Clearance
    left: Array  # e, r, rigid displacements, what is beyond the basis, and its branches; displacements of the obstacles


def arrays_of(body: Body, state: State, shapes: Array, friction: Array) -> tuple[Array, ...]:
    """What a table has, in its order; shapes (O, 17) and friction (O P,) are those of the obstacles and pairs."""
    left = sum(part.size for part in (*state[:3], state.relaxed_beyond)) + 3 * len(shapes)
    others = shapes, friction, np.zeros(4), stretch_of(body.points), np.zeros(left)
    of_body = *body[:10], body.branches, body.share, *body.yielding.blocks, *body.yielding[1:5]
    return *of_body, *state, *others, *body.pulled.actuators, *body.pulled[1:]


def numbers_of(law: Law, body: Body) -> Array:
    """What goes with a table: numbers of the law, and of the body."""
    return np.array([*law, *body[13:-1], *body.yielding[5:]], dtype=float)


def _places_in_record(N: int, P: int) -> list[slice]:
    """Of its parts, for N pairs at P points, as `_parts` takes them."""
    flags = N // 8 + 1
    sizes = np.array([OF_A_STEP, 3 * N, N, 9 * N, 3 * N, 3 * N, 3 * N, N, 12 * P, 3 * P, N, flags, flags])
    ends = 1 + sizes.cumsum()
    return [slice(*ends) for ends in zip((ends - sizes).tolist(), ends.tolist(), strict=True)]


def size_of_record(pairs: int, points: int) -> int:
    """How many numbers it has."""
    return _places_in_record(pairs, points)[-1].stop


def after_in_record(pairs: int, points: int) -> tuple[slice, slice]:
    """Where it has what the next step begins with: forces (3 pairs,), and whole numbers (pairs,)."""
    places = _places_in_record(pairs, points)
    return places[1], places[10]


def record_in(record: Array, pairs: int, points: int, friction: Array) -> Record:
    """The parts of a record."""
    numbers, forces, gaps, axes, free, relative, target, level, motion, at_points, swung, chosen, helped = (
        record[place] for place in _places_in_record(pairs, points)
    )
    vectors = free.reshape(-1, 3), relative.reshape(-1, 3), target.reshape(-1, 3)
    flags = chosen.view(bool)[:pairs], helped.view(bool)[:pairs]
    of_pairs = Pairs(axes.reshape(-1, 3, 3), *vectors, level, *flags, friction, forces.reshape(-1, 3))
    found = StepContact(of_pairs, gaps, motion.reshape(4, -1), at_points)
    return Record(numbers, found, Begun(of_pairs.forces, swung.view(np.int64)))


@jit_part
def _parts(record: Array, N: int, P: int, friction: Array) -> Record:
    """Those of a record for N pairs at P points."""
    record[0] = 1.0
    numbers, forces, gaps = take(record, OF_A_STEP), take_rows(record, N, 3), take(record, N)
    axes, free, relative = take_frames(record, N), take_rows(record, N, 3), take_rows(record, N, 3)
    target, level, motion = take_rows(record, N, 3), take(record, N), take_rows(record, 4, 3 * P)
    at_points, swung = take(record, 3 * P), take_integers(record, N)
    chosen, helped = take_flags(record, N), take_flags(record, N)
    pairs = Pairs(axes, free, relative, target, level, chosen, helped, friction, forces)
    return Record(numbers, StepContact(pairs, gaps, motion, at_points), Begun(forces, swung))


@jit_part
def _body_at(table: Array, numbers: Array) -> Body:
    blocks = Blocks(integers_at(table[12]), integer_rows_at(table[13]), vector_at(table[14]))
    kept = integers_at(table[16]), cube_at(table[17]), integers_at(table[18])
    yielding = Yielding(blocks, matrix_at(table[15]), kept[0], kept[1], kept[2], numbers[12], numbers[13])
    return Body(
        vector_at(table[0]),
        vector_at(table[1]),
        matrix_at(table[2]),
        matrix_at(table[3]),
        matrix_at(table[4]),
        matrix_at(table[5]),
        matrix_at(table[6]),
        matrix_at(table[7]),
        matrix_at(table[8]),
        matrix_at(table[9]),
        yielding,
        matrix_at(table[10]),
        matrix_at(table[11]),
        numbers[8],
        numbers[9],
        numbers[10],
        numbers[11],
        pulled_at(table[_PULLED:]),
    )


@jit_part
def pulled_at(t: Array) -> Pulled:
    """What ten rows have of it."""
    of = integers_at(t[0]), vector_at(t[1]), vector_at(t[2]), integer_rows_at(t[3]), vector_at(t[4])
    actuators = Actuators(of[0], of[1], of[2], of[3], of[4], matrix_at(t[5]))
    return Pulled(actuators, matrix_at(t[6]), matrix_at(t[7]), matrix_at(t[8]), matrix_at(t[9]))


@jit_part
def _state_at(table: Array) -> State:
    t = table[_STATE:]
    now = matrix_at(t[0]), vector_at(t[1]), matrix_at(t[2]), cube_at(t[3]), cube_at(t[4]), vector_at(t[5])
    before = matrix_at(t[6]), vector_at(t[7]), matrix_at(t[8]), cube_at(t[9]), cube_at(t[10]), vector_at(t[11])
    return State(*now, *before)


@jit_part
def _law_of(numbers: Array) -> Law:
    n = numbers
    return Law(n[0], n[1], n[2], n[3], n[4], n[5] != 0.0, int(n[6]), n[7])


@jit_part
def _clear_at(table: Array) -> Clear:
    t = table[_OTHERS:]
    known = vector_at(t[2])
    return Clear(Clearance(known[0:1], known[1:2], known[2:3], vector_at(t[3]), known[3:4], known[4:]), vector_at(t[4]))


@jit_part
def _parts_of(left: Array, state: State) -> tuple[Array, Array, Array, Array, Array]:
    """What was left of each part of a state, and of the obstacles."""
    a = state.halves.size
    b = a + len(state.rigid)
    c = b + state.beyond.size
    d = c + state.relaxed_beyond.size
    return left[:a], left[a:b], left[b:c], left[c:d], left[d:]


@jit_part
def _begin_clear(clear: Clear, state: State, start: Array) -> None:
    """Forgets what is known where the body or an obstacle was put elsewhere since."""
    left, gap, still = _parts_of(clear.left, state), clear.clearance.gap, clear.clearance.still
    if not (
        gap[0] > 0.0
        and are_equal(state.halves, left[0])
        and are_equal(state.rigid, left[1])
        and are_equal(state.beyond, left[2])
        and are_equal(state.relaxed_beyond, left[3])
        and are_equal(start, left[4])
    ):
        gap[0] = still[0] = 0.0


@jit_part
def _end_clear(clear: Clear, state: State, end: Array) -> None:
    """Notes where the body and the obstacles are."""
    if clear.clearance.gap[0] > 0.0:
        left = _parts_of(clear.left, state)
        copy(state.halves, left[0])
        copy(state.rigid, left[1])
        copy(state.beyond, left[2])
        copy(state.relaxed_beyond, left[3])
        copy(end, left[4])


@jit_part
def _tell(step: Step, begun: Begun, law: Law, record: Record) -> None:
    """Sets the numbers of a record, and what the next step begins with."""
    numbers, helped = record.numbers, 0
    numbers[0], numbers[1], numbers[2], numbers[3] = step.status, step.sweeps, step.square, step.supplied
    numbers[4], numbers[5], numbers[6] = step.dissipated, step.by_obstacles, step.contact
    numbers[7], numbers[8], numbers[9] = step.friction, step.normal_power, step.holding
    for each in record.found.pairs.helped:
        helped += each
    numbers[10] = helped
    hand_on(law, begun, step.status == FOUND, record.found.pairs, record.after)


@jit
def take_step_at(
    table: Array,
    numbers: Array,
    u: Array,
    start: Array,
    end: Array,
    w_before: Array,
    forces: Array,
    swung: Array,
    record: Array,
) -> None:
    """Takes a step, unless its status is OTHERWISE.

    Args:
        table: of `arrays_of`.
        numbers: of `numbers_of`.
        u: the input (p,).
        start, end, w_before: of the obstacles, as in `Moving`.
        forces, swung: what the step begins with, as in `Begun`.
        record: set.
    """
    body, law, state, clear = _body_at(table, numbers), _law_of(numbers), _state_at(table), _clear_at(table)
    shapes, friction = matrix_at(table[_OTHERS]), vector_at(table[_OTHERS + 1])
    moving, begun = Moving(unowned(start), unowned(end), unowned(w_before)), Begun(unowned(forces), unowned(swung))
    space = work_space(room_for(body, moving))
    told = _parts(unowned(record), len(forces), len(body.places), friction)
    _begin_clear(clear, state, start)
    step = step_in(space, body, law, shapes, unowned(u), moving, begun, state, told.found, clear.clearance)
    _tell(step, begun, law, told)
    if step.status != OTHERWISE:
        _end_clear(clear, state, end)


@jit
def take_steps_at(
    table: Array, numbers: Array, inputs: Array, path: Moving, records: Array, amounts: Array, told: Taken
) -> int:
    """Takes steps under inputs (n, p) among obstacles; how many.

    It ends before a step that is to be found otherwise, or whose energy is not finite.

    Args:
        table, numbers: as in `take_step_at`.
        inputs: (n, p); where there is gas they are changed, see `blow_in`.
        path: of the obstacles, as `moving_in` takes it.
        records: three, (3, size): step k is in that of number k mod 3, and the last of them has what the first step
            begins with. Set.
        amounts: (n,) of gas, changed.
        told: set.
    """
    body, state = _body_at(table, numbers), _state_at(table)
    pulled, strokes, stored = body.pulled, np.empty(len(amounts)), 0.0
    has_gas = len(pulled.actuators.gases) > 0
    ρ, N, friction = len(state.rigid), len(matrix_at(table[_OTHERS])) * len(body.places), vector_at(table[_OTHERS + 1])
    for count in range(len(inputs)):
        if has_gas:
            set_strokes(pulled, state.halves[0], state.rigid, body.inverse_ω, strokes)
            stored = blow_in(pulled.actuators, strokes, amounts, inputs[count], numbers[0])
            if not np.isfinite(stored):
                return count
        begun = _parts(unowned(records[(count + 2) % 3]), N, len(body.places), friction).after
        record = records[count % 3]
        start, end, before = moving_in(path, count)
        take_step_at(table, numbers, inputs[count], start, end, before, begun.forces, begun.swung, record)
        step = record[1 : 1 + OF_A_STEP]
        if step[0] == OTHERWISE:
            return count
        if not np.isfinite(step[2]):
            restore(state)
            return count
        copy(step[3:8], told.works[count])
        if has_gas:
            set_strokes(pulled, state.halves[0], state.rigid, body.inverse_ω, strokes)
            told.works[count, 0] += keep_gas(pulled.actuators, strokes, inputs[count], amounts) - stored
        for i in range(len(body.ω)):
            told.q[count, i] = state.rigid[i] if i < ρ else state.halves[0, i] * body.inverse_ω[i]
        if len(body.R) > 0:
            copy(state.beyond[0], told.carried[count])
    return len(inputs)
