"""Many linear bodies among obstacles: the step of each is that of `linear_step`, to the bit.

Arrays are those of one body, stacked: bodies first. Loops over some of the bodies run in threads beside others.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.compiled_arrays import unowned
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Law, Pairs, rubbed
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.mechanics.compiled.gas import Filled, blow_in, keep_gas
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, moving_in
from fenics_rom.mechanics.compiled.shapes import measure
from fenics_rom.mechanics.compiled.work_space import release, taken, work_space
from fenics_rom.runtime.compiled.linear_actuators import set_strokes
from fenics_rom.runtime.compiled.linear_step import Body, State, restore, room_for, step_in
from fenics_rom.runtime.compiled.touching import LOST, Begun, Clearance, StepContact, Touched, hand_on, is_settled


class Told(NamedTuple):
    """Of the last step of B bodies."""

    status: Array  # (B,) of contact, or LOST
    works: Array  # (B, 5), J: supplied, dissipated, by obstacles, contact and friction, as in `Step`
    forces: Array  # on the points (B, P, 3), N
    resultants: Array  # of each obstacle (B, O, 3), N
    pressing: Array  # of all obstacles along their normals (B, P), N


@jit
def step_bodies(
    body: Body,
    law: Law,
    friction: Array,
    shapes: Array,
    bodies: Array,
    inputs: Array,
    obstacles: Moving,
    begun: Begun,
    after: Begun,
    states: State,
    filled: Filled,
    clearance: Clearance,
    told: Told,
) -> None:
    """Takes a step of some bodies.

    Args:
        body, law, shapes: as in `take_step`, of all bodies but for friction.
        friction: μ of each (B,).
        bodies: (n,) which of the B.
        inputs: (B, p); where there is gas they are changed, see `blow_in`.
        obstacles: of all: as in `Moving`, bodies first.
        begun, after: what the step begins with of the past, and what the next one does, which is set.
        states: changed of those that take the step: not where its status is OTHERWISE or LOST.
        filled: their gas, changed likewise.
        clearance: with numbers (B,), changed; of bodies whose obstacles are out of reach nothing is asked of these.
        told: set.
    """
    P, N = len(body.places), begun.forces.shape[1]
    found, space = contact_of(N, P), work_space(room_for(body, moving_in(obstacles, 0)))
    given = unowned(body), law, unowned(friction), unowned(shapes), unowned(bodies), unowned(inputs)
    known = unowned(obstacles), unowned(begun), unowned(after), unowned(states), unowned(filled)
    last = unowned(clearance), unowned(told)
    _step_bodies(*given, *known, *last, found, space)


@jit_part
def contact_of(N: int, P: int) -> StepContact:
    """For what N pairs do at P points."""
    vectors, flags = np.empty((3, N, 3)), np.empty((2, N), dtype=np.bool_)
    asked = vectors[0], vectors[1], vectors[2], np.empty(N), flags[0], flags[1], np.empty(N), np.empty((N, 3))
    return StepContact(Pairs(np.empty((N, 3, 3)), *asked), np.empty(N), np.zeros((4, 3 * P)), np.empty(3 * P))


@jit_part
def _step_bodies(
    body: Body,
    law: Law,
    friction: Array,
    shapes: Array,
    bodies: Array,
    inputs: Array,
    obstacles: Moving,
    begun: Begun,
    after: Begun,
    states: State,
    filled: Filled,
    clearance: Clearance,
    told: Told,
    kept: StepContact,
    space: Array,
) -> None:
    """The same; kept: for what the step of a body finds."""
    found, begin, of, stored = unowned(kept), taken(space), body.pulled, 0.0
    strokes, has_gas = np.empty(len(of.lines)), len(of.actuators.gases) > 0
    for i in range(len(bodies)):
        b = bodies[i]
        release(space, begin)
        fill(found.pairs.friction, friction[b])
        own, moving = rubbed(law, friction[b]), moving_in(obstacles, b)
        state = _of_one(states, b)
        past = Begun(begun.forces[b], begun.swung[b])
        own_numbers = clearance.gap[b : b + 1], clearance.untouched[b : b + 1], clearance.still[b : b + 1]
        near = Clearance(*own_numbers, clearance.stretch, clearance.gone[b : b + 1], clearance.pairs[b])
        if has_gas:
            set_strokes(of, state.halves[0], state.rigid, body.inverse_ω, strokes)
            stored = blow_in(of.actuators, strokes, filled.amounts[b], inputs[b], law.h)
            if not np.isfinite(stored):
                told.status[b] = OTHERWISE
                continue
        step = step_in(space, body, own, shapes, inputs[b], moving, past, state, found, near)
        told.status[b] = step.status
        if step.status != OTHERWISE and not np.isfinite(step.square):
            restore(state)
            told.status[b] = LOST
        if told.status[b] >= OTHERWISE:
            near.gap[0] = near.untouched[0] = near.still[0] = 0.0
            continue
        works, touched = told.works[b], step.status == FOUND
        works[0], works[1], works[2] = step.supplied, step.dissipated, step.by_obstacles
        if has_gas:
            set_strokes(of, state.halves[0], state.rigid, body.inverse_ω, strokes)
            copy(filled.amounts[b], filled.before[b])
            works[0] += keep_gas(of.actuators, strokes, inputs[b], filled.amounts[b]) - stored
        works[3], works[4] = step.contact, step.friction
        if not touched and is_settled(near.untouched):
            continue
        near.untouched[0] = 0.0 if touched else near.untouched[0] + 1
        tell_contact(law, touched, found, past, Begun(after.forces[b], after.swung[b]), told, b)


@jit_part
def _of_one(states: State, b: int) -> State:
    """That of a body."""
    now = states.halves[b], states.rigid[b], states.beyond[b], states.relaxed[b], states.relaxed_beyond[b]
    before = states.halves_before[b], states.rigid_before[b], states.beyond_before[b]
    relaxed = states.relaxed_before[b], states.relaxed_beyond_before[b]
    return State(*now, states.reactions[b], *before, *relaxed, states.reactions_before[b])


@jit_part
def tell_contact(law: Law, touches: bool, found: StepContact, past: Begun, after: Begun, told: Told, b: int) -> None:
    """Tells what a body found of contact, and what its next step begins with."""
    pairs, resultants, pressing, P = found.pairs, told.resultants[b], told.pressing[b], told.forces.shape[1]
    fill(resultants, 0.0)
    fill(pressing, 0.0)
    copy(found.forces, told.forces[b])
    hand_on(law, past, touches, pairs, after)
    for o in range(len(resultants) if touches else 0):
        for p in range(P):
            c = o * P + p
            if pairs.chosen[c]:
                for k in range(3):
                    resultants[o, k] += pairs.forces[c, k]
                    pressing[p] += pairs.forces[c, k] * pairs.axes[c, 0, k]


@jit
def look_at_bodies(
    body: Touched,
    inverse_ω: Array,
    shapes: Array,
    bodies: Array,
    start: Array,
    states: State,
    displacement: Array,
    nearest: Array,
) -> None:
    """Sets displacements of the points (B, P, 3), m, and their gaps to the nearest obstacle (B, P), m, of some bodies.

    Arguments as in `step_bodies`; inverse_ω: (m,), s; start: of the obstacles, (B, O, 3) or (B, O, 7).
    """
    P, count, ρ = len(body.places), len(shapes), states.rigid.shape[1]
    gaps, normals = np.empty(count * P), np.empty((count * P, 3))
    for b in bodies:
        moved = displacement[b].reshape(3 * P)
        moved[:] = 0.0
        if len(body.R) > 0:
            copy(states.beyond[b, 1], moved)
        for i in range(len(inverse_ω)):
            q = states.rigid[b, i] if i < ρ else states.halves[b, 0, i] * inverse_ω[i]
            for k in range(3 * P):
                moved[k] += body.points[i, k] * q
        measure(shapes, start[b], body.places + displacement[b], gaps, normals)
        for p in range(P):
            nearest[b, p] = gaps[p]
            for o in range(1, count):
                nearest[b, p] = min(nearest[b, p], gaps[o * P + p])
