"""Many held bodies that deform largely: the step of each is that of `held_step`, to the bit; see `linear_bodies`."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Law, rubbed
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.mechanics.compiled.gas import Filled
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, moving_in
from fenics_rom.runtime.compiled.carried_strains import AHEAD, GAP, IS_AHEAD, IS_CARRIED, VELOCITY, Memory
from fenics_rom.runtime.compiled.held_step import Step, take_step
from fenics_rom.runtime.compiled.held_touch import Among, Body, Motion, Touch, motion_in
from fenics_rom.runtime.compiled.linear_bodies import Told, contact_of, tell_contact
from fenics_rom.runtime.compiled.linear_step import State
from fenics_rom.runtime.compiled.strokes import Pull, blow_at, keep_at, own_pull, set_chamber_strokes
from fenics_rom.runtime.compiled.touching import Begun


class Carried(NamedTuple):
    """What steps of B bodies carry along, as they have it in their memories, and what it was before the step."""

    vectors: Array  # (B, 9, m)
    tangent: Array  # (B, m, m)
    strained: Array  # (B, 2, n - 1)
    numbers: Array  # (B, NUMBERS)
    relaxed: Array  # strains of branches, and C₀ times them (B, branches, 2, n - 1)
    stressed: Array  # (B, 2, N)
    pushed: Array  # generalized forces of contact in the last step (B, m)
    reactions: Array  # forces of strokes in it (B, n)
    velocity_before: Array  # (B, m)
    strained_before: Array
    numbers_before: Array
    relaxed_before: Array
    pushed_before: Array
    reactions_before: Array
    noted: Array  # (B, 3): as in `held_steps.Taken`, and |q|²


@jit
def step_bodies(
    body: Body,
    touch: Touch | None,
    pull: Pull | None,
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
    carried: Carried,
    told: Told,
) -> None:
    """Takes a step of some bodies. Arguments as in `linear_bodies.step_bodies`, but for:

    Args:
        touch: where they can be touched; None: nowhere.
        pull: cables and chambers whose strokes are given; None: there are none. What is found is not set here.
        carried: changed as states are.
        filled: as there.
    """
    m, N = len(body.ω), begun.forces.shape[1]
    n, r = 3 * told.forces.shape[1], carried.stressed.shape[2]
    within, products, vectors, factor = np.zeros((4, m, m)), np.zeros((4, r)), np.zeros((8, m)), np.zeros((m, m))
    motion, found, spread, W = motion_in(vectors, factor), contact_of(N, n // 3), np.empty((m, n)), np.empty((n, n))
    by_branches = np.empty((2 if states.relaxed_beyond.size > 0 else 0, n))
    for b in bodies:
        memory = Memory(
            carried.vectors[b],
            carried.tangent[b],
            carried.strained[b],
            carried.numbers[b],
            carried.stressed[b],
            carried.relaxed[b],
            within,
            products,
        )
        pushed = carried.pushed[b]
        _remember(b, states, carried)
        pulled, e = _pull_of(pull, carried.reactions[b]), states.halves[b, 0]
        stored = blow_at(pulled, e, body.inverse_ω, filled.amounts[b], inputs[b], body.law.h)
        if not np.isfinite(stored):
            told.status[b] = OTHERWISE
            continue
        if touch is None:
            step = take_step(body, inputs[b], states.halves[b], pushed, memory, vectors, factor, None, pulled)
        else:
            copy(begun.forces[b], found.pairs.forces)
            fill(found.pairs.friction, friction[b])
            own, moving = rubbed(law, friction[b]), moving_in(obstacles, b)
            past, beyond = Begun(begun.forces[b], begun.swung[b]), (states.beyond[b], states.beyond_before[b])
            relaxed = states.relaxed_beyond[b], states.relaxed_beyond_before[b]
            among = Among(touch, own, shapes, moving, past, *beyond, *relaxed, by_branches, found, spread, W, None)
            step = take_step(body, inputs[b], states.halves[b], pushed, memory, vectors, factor, among, pulled)
        told.status[b] = step.status
        if step.status >= OTHERWISE:
            restore(b, states, carried)
            continue
        _end(body, b, step, motion, states, carried, told)
        copy(filled.amounts[b], filled.before[b])
        told.works[b, 0] += keep_at(pulled, e, body.inverse_ω, inputs[b], filled.amounts[b]) - stored
        if touch is not None:
            tell_contact(law, step.status == FOUND, found, past, Begun(after.forces[b], after.swung[b]), told, b)


@jit_part
def _pull_of(pull: Pull | None, forces: Array) -> Pull | None:
    """As `own_pull`, where anything pulls."""
    if pull is None:
        return None
    return own_pull(pull, forces)


@jit_part
def _remember(b: int, states: State, carried: Carried) -> None:
    """Notes what a body is before a step."""
    copy(states.halves[b], states.halves_before[b])
    copy(states.beyond[b], states.beyond_before[b])
    copy(states.relaxed_beyond[b], states.relaxed_beyond_before[b])
    copy(carried.numbers[b], carried.numbers_before[b])
    copy(carried.relaxed[b], carried.relaxed_before[b])
    copy(carried.pushed[b], carried.pushed_before[b])
    copy(carried.reactions[b], carried.reactions_before[b])
    copy(carried.vectors[b, VELOCITY], carried.velocity_before[b])
    if carried.numbers[b, IS_CARRIED]:
        copy(carried.strained[b], carried.strained_before[b])


@jit_part
def restore(b: int, states: State, carried: Carried) -> None:
    """Puts a body where it was before the last step; what is known ahead of it is found anew.

    T is what it was, if there was one: steps that have one do not change it.
    """
    copy(states.halves_before[b], states.halves[b])
    copy(states.beyond_before[b], states.beyond[b])
    copy(states.relaxed_beyond_before[b], states.relaxed_beyond[b])
    copy(carried.numbers_before[b], carried.numbers[b])
    copy(carried.relaxed_before[b], carried.relaxed[b])
    copy(carried.pushed_before[b], carried.pushed[b])
    copy(carried.reactions_before[b], carried.reactions[b])
    copy(carried.velocity_before[b], carried.vectors[b, VELOCITY])
    carried.numbers[b, IS_AHEAD] = 0.0
    if carried.numbers[b, IS_CARRIED]:
        copy(carried.strained_before[b], carried.strained[b])


@jit
def set_strokes_of(pull: Pull, halves: Array, inverse_ω: Array, strokes: Array) -> None:
    """Sets strokes of chambers (B, n) of bodies whose e and r are halves (B, 2, m)."""
    q = np.empty(len(inverse_ω))
    for b in range(len(halves)):
        for i in range(len(q)):
            q[i] = halves[b, 0, i] * inverse_ω[i]
        set_chamber_strokes(pull, q)
        copy(pull.strokes, strokes[b])


@jit
def restore_bodies(bodies: Array, states: State, carried: Carried) -> None:
    """Puts bodies where they were before the last step."""
    for b in bodies:
        restore(b, states, carried)


@jit_part
def _end(body: Body, b: int, step: Step, motion: Motion, states: State, carried: Carried, told: Told) -> None:
    """Has a body be where its step led."""
    works, noted = told.works[b], carried.noted[b]
    copy(motion.e, states.halves[b, 0])
    copy(motion.r, states.halves[b, 1])
    works[0], works[1], works[2] = step.supplied, step.dissipated, step.by_obstacles
    works[3], works[4] = step.contact, step.friction
    noted[0], noted[1], noted[2] = 2 * carried.numbers[b, AHEAD], carried.numbers[b, GAP], 0.0
    for i in range(len(motion.e)):
        noted[2] += (motion.e[i] * body.inverse_ω[i]) ** 2
