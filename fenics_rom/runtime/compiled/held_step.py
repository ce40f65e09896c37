"""The step of a held body that deforms largely, whole: `steppers.held`, compiled.

(2/h + matrix) v̂ = 2/h r - pull + G u + Sᵀ f,   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r

where strains are carried along; else by Newton's method (`newton_step.py`). See `held_touch.py` for what is None.
"""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.contact_law import NOTHING, OTHERWISE, Found
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.mechanics.compiled.obstacle_motion import Beside, begin_beside, room_beside, turn_too_far
from fenics_rom.mechanics.compiled.work_space import work_space
from fenics_rom.runtime.compiled.branches import add_row_of_pull, step_branches, stored_in
from fenics_rom.runtime.compiled.carried_strains import (
    ENERGY,
    HAS_TANGENT,
    IS_AHEAD,
    LEFT,
    MADE_TANGENT,
    Memory,
    Strains,
    add_force_ahead,
    add_inertia,
    close,
    expect,
    look_ahead,
    make_tangent,
    strains_in,
)
from fenics_rom.runtime.compiled.following import add_following
from fenics_rom.runtime.compiled.held_own import Own
from fenics_rom.runtime.compiled.held_touch import Among, Body, Motion, find_touching, motion_in
from fenics_rom.runtime.compiled.newton_step import find_by_newton
from fenics_rom.runtime.compiled.sampled_points import InStep, Sampled, close_points
from fenics_rom.runtime.compiled.small_matrices import dot, factor, multiply, solve
from fenics_rom.runtime.compiled.strokes import Pull, add_pull, aim, end_pull, set_pull
from fenics_rom.runtime.compiled.touching import FORGOTTEN, LOST, add_up_forces
from fenics_rom.runtime.compiled.yielding import set_yielding_of, step_beyond
from fenics_rom.runtime.steppers.elastic.carried_strains import TANGENT_RENEWAL


class Step(NamedTuple):
    """What a step did."""

    status: int  # of contact; where that is OTHERWISE no step was taken, and where it is LOST nothing is of use
    sweeps: int
    went_as_expected: bool
    square: float  # twice the stored energy, J
    supplied: float  # by inputs, J
    dissipated: float  # but for contact, J
    by_obstacles: float  # supplied, J
    contact: float  # dissipated in impacts, J
    friction: float  # dissipated, J
    normal_power: float  # Σ λ s of the pairs, W


NOT_TAKEN = Step(OTHERWISE, 0, False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@jit_part
def free_step(
    body: Body, u: Array, r: Array, pushed: Array, strains: Strains, motion: Motion, pull: Pull | None
) -> bool:
    """Sets v̂ of a step under u (p,) from q and r (m,) without what is found of contact and cables; if there is one.

    `pushed` are generalized forces (m,) of
    contact in the step before.
    """
    law, numbers, v, m = body.law, strains.numbers, strains.velocity, len(r)
    q, residual, force, velocity = motion.q, motion.residual, motion.force, motion.velocity
    if not numbers[IS_AHEAD]:
        look_ahead(law, strains, q, v)
    multiply(body.dead, u, force)
    for i in range(m):
        velocity[i], strains.at[i] = force[i], q[i] + law.h / 2 * v[i]
    add_following(body.loads, u, strains.at, strains.products[0], velocity)
    for i in range(m):
        residual[i] = 2 / law.h * (v[i] - r[i]) - velocity[i] - pushed[i]
    if pull is not None:
        aim(pull, u, q, r, law.h)
        add_pull(pull, strains.at, -1.0, residual)
    add_force_ahead(law, strains, q, residual)
    numbers[MADE_TANGENT] = 1.0 - numbers[HAS_TANGENT]
    if not numbers[HAS_TANGENT]:
        make_tangent(law, strains, q)
        numbers[HAS_TANGENT] = 1.0
    for i in range(m):
        motion.whole[i] = v[i] - dot(strains.tangent[i], residual)
    expect(law, strains, q, motion.whole)
    add_following(body.loads, u, strains.at, strains.products[0], force)
    copy(strains.matrix, motion.factor)
    add_inertia(law, motion.factor)
    if not factor(motion.factor):
        return False
    for i in range(m):
        velocity[i] = 2 / law.h * r[i] - strains.pull[i] + force[i]
    solve(motion.factor, velocity)
    if pull is not None:
        set_pull(pull, strains.at, motion.factor)
    return True


@jit_part
def _end_step(
    body: Body,
    r: Array,
    strains: Strains,
    motion: Motion,
    sampled: Sampled | None,
    in_step: InStep | None,
    rubbed: float,
) -> Step:
    """Ends a step with v̂ of the motion, from r (m,); `in_step`: of Newton's method, `rubbed`: power of guides, W."""
    law, v, after, missed, square = body.law, motion.velocity, strains.pull, 0.0, 0.0
    numbers, went_as_expected = strains.numbers, True
    for i in range(len(v)):
        motion.e[i], motion.r[i] = (motion.q[i] + law.h * v[i]) * body.ω[i], 2 * v[i] - r[i]
        after[i] = motion.e[i] * body.inverse_ω[i]
        missed += (v[i] - strains.expected[i]) ** 2
    if sampled is None or in_step is None:
        went_as_expected = not missed > TANGENT_RENEWAL**2 * dot(v, v)
        heat = close(law, strains, motion.q, after, v)
        numbers[HAS_TANGENT] = 1.0 if went_as_expected else 0.0
    else:
        numbers[ENERGY], heat = close_points(sampled, law, in_step, strains.relaxed, v)
    for i in range(len(v)):
        square += after[i] * dot(law.springs[i], after)
    heat -= law.h * rubbed
    within = numbers[ENERGY] + numbers[LEFT] + stored_in(law.branches, strains.relaxed)
    square += dot(motion.r, motion.r) + 2 * within
    supplied, status = law.h * dot(motion.force, v), NOTHING if math.isfinite(square) else LOST
    return Step(status, 0, went_as_expected, square, supplied, heat, 0.0, 0.0, 0.0, 0.0)


@jit_part
def _end_touched(
    step: Step,
    contact: Found,
    branches: Array,
    pushed: Array,
    motion: Motion,
    among: Among,
    beside: Beside,
    own: Own | None,
) -> Step:
    """A step among obstacles with what these did, whose forces (m,) are set; `step` is what it did otherwise.

    `branches` (8, N): coefficients of those of the material.
    """
    touch, law, found, forces, v = among.touch, among.law, among.found, among.found.forces, motion.velocity
    h = law.h
    copy(motion.pushed, pushed)
    copy(among.beyond, among.beyond_before)
    copy(among.relaxed, among.relaxed_before)
    by_obstacles, power, stored, yields = 0.0, dot(pushed, v), 0.0, len(touch.R) > 0
    if own is None:
        by_obstacles = add_up_forces(contact, beside.w, found)
    dissipated = step.dissipated
    if yields:
        set_yielding_of(touch.R, forces, found.motion[3])
        given = among.beyond, among.pull, forces, found.motion[3], work_space(len(forces))
        lost, power_beyond, stored = step_beyond(touch, h, *given)
        if len(among.pull) > 0:
            lost += step_branches(branches, among.relaxed, among.pull[0], among.pull[1])
            stored += 2 * stored_in(branches, among.relaxed)
        dissipated, power = dissipated + lost, power + power_beyond
        if contact.status == NOTHING and stored < 2 * FORGOTTEN:
            stored = 0.0
            fill(among.beyond, 0.0)
            fill(among.relaxed, 0.0)
    square, whole = step.square + stored, power - by_obstacles
    normal = contact.normal_power if law.friction > 0 else whole
    if not math.isfinite(square):
        copy(among.beyond_before, among.beyond)
        copy(among.relaxed_before, among.relaxed)
    return Step(
        contact.status if math.isfinite(square) else LOST,
        contact.sweeps,
        step.went_as_expected,
        square,
        step.supplied,
        dissipated,
        h * by_obstacles,
        -h * normal,
        h * (normal - whole),
        contact.normal_power,
    )


@jit_part
def _take(
    body: Body,
    u: Array,
    r: Array,
    pushed: Array,
    strains: Strains,
    motion: Motion,
    among: Among | None,
    beside: Beside | None,
    pull: Pull | None,
    sampled: Sampled | None,
) -> Step:
    """As `take_step`, from q and r (m,), beside what moves so."""
    if sampled is None:
        if not free_step(body, u, r, pushed, strains, motion, pull):
            return NOT_TAKEN
        in_step, contact = None, find_touching(body.law.h, u, r, motion, among, beside, pull)
    else:
        contact, in_step = find_by_newton(body, sampled, u, r, strains, motion, among, beside, pull)
    if contact.status == OTHERWISE:
        return NOT_TAKEN
    rubbed = 0.0
    if pull is not None:
        rubbed = end_pull(pull, motion.velocity, motion.force)
    step = _end_step(body, r, strains, motion, sampled, in_step, rubbed)
    if among is None or beside is None:
        return step
    return _end_touched(step, contact, body.law.branches, pushed, motion, among, beside, among.own)


@jit_apart
def take_step(
    body: Body,
    u: Array,
    halves: Array,
    pushed: Array,
    memory: Memory,
    vectors: Array,
    matrix: Array,
    among: Among | None,
    pull: Pull | None,
) -> Step:
    """A step under u (p,) from e and r (2, m); `pushed` as in `free_step`, then those of this step.

    Where it is not taken, what is carried is as it was, but for numbers of the memory; where it is lost, it is not.
    """
    strains, motion = strains_in(memory), motion_in(vectors, matrix)
    for i in range(len(pushed)):
        motion.q[i] = halves[0, i] * body.inverse_ω[i]
    given = body, u, halves[1], pushed, strains, motion
    if among is None:
        return _take(*given, None, None, pull, body.sampled)
    if turn_too_far(among.moving):
        return NOT_TAKEN
    for row in range(len(among.pull)):
        fill(among.pull[row], 0.0)
        add_row_of_pull(body.law.branches, among.relaxed, row, among.pull[row])
    space = work_space(room_beside(among.moving, len(among.found.gaps)))
    beside = begin_beside(among.moving, body.law.h, len(among.found.gaps), space)
    return _take(*given, among, beside, pull, body.sampled)
