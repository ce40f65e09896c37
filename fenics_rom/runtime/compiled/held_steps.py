"""Steps in a row of a held body that deforms largely, each that of `held_step`, for rollouts."""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, moving_in
from fenics_rom.runtime.compiled.carried_strains import AHEAD, GAP, Memory
from fenics_rom.runtime.compiled.held_own import keep_opposite
from fenics_rom.runtime.compiled.held_step import NOT_TAKEN, Step, take_step
from fenics_rom.runtime.compiled.held_touch import Among, Body, among_in, motion_in
from fenics_rom.runtime.compiled.strokes import Pull, blow_at, keep_at
from fenics_rom.runtime.compiled.touching import Last, hand_on, keep_found


class Taken(NamedTuple):
    """Of steps in a row, one row each."""

    works: Array  # (n, 5), J: supplied, dissipated, by obstacles, contact and friction, as in `Step`
    q: Array  # (n, m) after it
    noted: Array  # (n, 2): twice the energy of the strains after it, J, and the square of what those carried lack
    carried: Array  # g (n, 3P) beyond the basis after it, N; (n, 0) where there is nothing
    by_obstacle: Array  # forces of the obstacles in it (n, O, 3), N
    reactions: Array  # forces of strokes in it (n, k), N


@jit
def take_steps(
    body: Body,
    inputs: Array,
    halves: Array,
    pushed: Array,
    memory: Memory,
    vectors: Array,
    matrix: Array,
    among: Among | None,
    pull: Pull | None,
    path: Moving | None,
    last: Last | None,
    amounts: Array,
    taken: Taken,
) -> tuple[int, Step]:
    """Takes steps under inputs (n, p) among obstacles: how many, and the last one.

    It ends before a step that is to be found otherwise. Where a state is not finite nothing that was given is of use,
    and the status of the last step is LOST.

    Args:
        body, halves, pushed, memory, vectors, matrix: as in `take_step`; e and r are changed, too.
        inputs: (n, p); where there is gas they are changed, see `blow_in`.
        among, pull: as there; what a step begins with is changed. None: nothing can touch the body, or is pulled.
        path: of the obstacles, as `moving_in` takes it, where something can.
        last: set, where something can.
        amounts: of gas (n,), changed.
        taken: set.
    """
    motion, numbers, step, m = motion_in(vectors, matrix), memory.numbers.copy(), NOT_TAKEN, len(body.ω)
    for count in range(len(inputs)):
        stored = blow_at(pull, halves[0], body.inverse_ω, amounts, inputs[count], body.law.h)
        if not math.isfinite(stored):
            return count, step
        copy(memory.numbers, numbers)
        given = body, inputs[count], halves, pushed, memory, vectors, matrix
        if among is None or path is None:
            after = take_step(*given, None, pull)
        else:
            copy(among.begun.forces, among.found.pairs.forces)
            after = take_step(*given, among_in(among, moving_in(path, count)), pull)
        if after.status == OTHERWISE:
            copy(numbers, memory.numbers)
            return count, step
        step = after
        if after.status > OTHERWISE:
            return count, step
        copy(motion.e, halves[0])
        copy(motion.r, halves[1])
        for i in range(m):
            taken.q[count, i] = motion.e[i] * body.inverse_ω[i]
        works, noted = taken.works[count], taken.noted[count]
        works[0], works[1], works[2] = step.supplied, step.dissipated, step.by_obstacles
        works[3], works[4] = step.contact, step.friction
        noted[0], noted[1] = 2 * memory.numbers[AHEAD], memory.numbers[GAP]
        if pull is not None:
            copy(pull.forces, taken.reactions[count])
        works[0] += keep_at(pull, halves[0], body.inverse_ω, inputs[count], amounts) - stored
        if among is not None and last is not None:
            _keep_contact(among, step.status == FOUND, last, taken, count)
    return len(inputs), step


@jit_part
def _keep_contact(among: Among, touches: bool, last: Last, taken: Taken, count: int) -> None:
    """Notes what a step found, and what the next one begins with."""
    pairs, P = among.found.pairs, len(among.touch.places)
    keep_found(among.begun, among.found, last.begun, last.found)
    keep_opposite(among.own)
    hand_on(among.law, among.begun, touches, pairs, among.begun)
    if len(among.touch.R) > 0:
        copy(among.beyond[0], taken.carried[count])
    of_each = taken.by_obstacle[count]
    for o in range(len(of_each)):
        for k in range(3):
            of_each[o, k] = 0.0
    for c in range(P * len(of_each) if touches else 0):
        for k in range(3):
            of_each[c // P, k] += pairs.forces[c, k]
