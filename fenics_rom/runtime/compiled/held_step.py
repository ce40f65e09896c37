"""The step of a held body whose strains are carried along, whole: `steppers.held`, compiled.

(2/h + matrix) v̂ = 2/h r - pull + G u + Sᵀ f,   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r

Where nothing can touch the body `among` is None, and numba makes the same functions without contact; where no stroke is
given `pull` is.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.actuator_forces import TOGETHER
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Found, find_forces
from fenics_rom.mechanics.compiled.contact_law import Law as ContactLaw
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside, Moving, begin_beside, room_beside, turn_too_far
from fenics_rom.mechanics.compiled.work_space import work_space
from fenics_rom.runtime.compiled.branches import stored_in
from fenics_rom.runtime.compiled.carried_strains import (
    ENERGY,
    HAS_TANGENT,
    IS_AHEAD,
    LEFT,
    MADE_TANGENT,
    Law,
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
from fenics_rom.runtime.compiled.following import Following, add_following
from fenics_rom.runtime.compiled.small_matrices import dot, factor, multiply, solve, solve_rows, squares
from fenics_rom.runtime.compiled.strokes import (
    Pull,
    add_pull,
    aim,
    end_pull,
    find_held,
    find_pull,
    hold,
    hold_back,
    is_settled,
    move_by,
)
from fenics_rom.runtime.compiled.touching import (
    FORGOTTEN,
    LOST,
    Begun,
    StepContact,
    add_up_forces,
    ask_points,
    look_around,
    step_beyond,
)
from fenics_rom.runtime.steppers.elastic.carried_strains import TANGENT_RENEWAL


class Body(NamedTuple):
    """What is held, with m modes and p inputs."""

    ω: Array  # (m,), 1/s
    inverse_ω: Array  # (m,), s
    dead: Array  # forces of inputs whose direction stays (m, p)
    loads: Following
    law: Law


class Motion(NamedTuple):
    """What a step sets beside what is strained, (m,) each but the last."""

    e: Array  # at its end
    r: Array
    q: Array  # at its start
    residual: Array  # forces out of balance there at v̂ of the step before
    whole: Array  # v̂ that these lead to, before it is made no longer than what was trained
    force: Array  # of inputs
    velocity: Array  # v̂
    pushed: Array  # generalized forces of contact
    factor: Array  # of the step's matrix (m, m)


@jit_part
def motion_in(vectors: Array, factor: Array) -> Motion:
    """As parts of few arrays, (8, m) and (m, m)."""
    first, second = (vectors[0], vectors[1], vectors[2], vectors[3]), (vectors[4], vectors[5], vectors[6], vectors[7])
    return Motion(*first, *second, factor)


class Touch(NamedTuple):
    """Where a body can be touched; see `touching.Touched`."""

    points: Array  # (m, 3P)
    places: Array  # (P, 3)
    R: Array  # (3P, 3P) or (0, 0)
    inertia: float
    whole: float
    lost: float
    τ: float


class Among(NamedTuple):
    """The obstacles that a body is among in a step, and what it finds of them."""

    touch: Touch
    law: ContactLaw
    shapes: Array  # of the obstacles, (O, 17)
    moving: Moving  # how they move
    begun: Begun
    beyond: Array  # g, y and their rates, (4, 3P), changed
    beyond_before: Array  # the same before the step
    found: StepContact  # with forces to begin with; set
    spread: Array  # for roots of W (m, 3P),
    W: Array  # and W, m/s/N (3P, 3P)


@jit_part
def among_in(among: Among, moving: Moving) -> Among:
    """The same obstacles, which move so."""
    touch, law, shapes, _, begun, beyond, beyond_before, found, spread, W = among
    return Among(touch, law, shapes, moving, begun, beyond, beyond_before, found, spread, W)


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
    body: Body, u: Array, e: Array, r: Array, pushed: Array, strains: Strains, motion: Motion, pull: Pull | None
) -> bool:
    """Sets v̂ of a step under u (p,) from e and r (m,) without contact and cables; whether there is one.

    Forces of cables are found that give their strokes where nothing touches. `pushed` are generalized forces (m,) of
    contact in the step before.
    """
    law, numbers, v, m = body.law, strains.numbers, strains.velocity, len(e)
    q, residual, force, velocity = motion.q, motion.residual, motion.force, motion.velocity
    for i in range(m):
        q[i] = e[i] * body.inverse_ω[i]
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
    return pull is None or find_pull(pull, strains.at, motion.factor, velocity)


@jit_part
def end_step(body: Body, r: Array, strains: Strains, motion: Motion) -> Step:
    """Ends a step with v̂ of the motion, from r (m,)."""
    law, v, after, missed, square = body.law, motion.velocity, strains.pull, 0.0, 0.0
    for i in range(len(v)):
        motion.e[i], motion.r[i] = (motion.q[i] + law.h * v[i]) * body.ω[i], 2 * v[i] - r[i]
        after[i] = motion.e[i] * body.inverse_ω[i]
        missed += (v[i] - strains.expected[i]) ** 2
    went_as_expected = not missed > TANGENT_RENEWAL**2 * dot(v, v)
    heat = close(law, strains, motion.q, after, v)
    strains.numbers[HAS_TANGENT] = 1.0 if went_as_expected else 0.0
    for i in range(len(v)):
        square += after[i] * dot(law.springs[i], after)
    within = strains.numbers[ENERGY] + strains.numbers[LEFT] + stored_in(law.branches, strains.relaxed)
    square += dot(motion.r, motion.r) + 2 * within
    supplied, status = law.h * dot(motion.force, v), NOTHING if math.isfinite(square) else LOST
    return Step(status, 0, went_as_expected, square, supplied, heat, 0.0, 0.0, 0.0, 0.0)


@jit_part
def _find_contact(r: Array, motion: Motion, among: Among, beside: Beside, pull: Pull | None) -> Found:
    """Finds contact forces at v̂ of the motion, and sets what they do (m,)."""
    touch, found = among.touch, among.found
    space = work_space(3 * len(touch.places))
    look_around(touch, among.shapes, among.moving, among.law.h, beside, motion.q, among.beyond, found, space)
    given = beside, among.begun.forces, r, motion.velocity, among.beyond, touch.R[:0]
    ask_points(touch, among.law, *given, found, math.inf, space)
    if found.pairs.chosen.any():
        _set_delassus(touch, motion.factor, among.spread, among.W)
        if pull is not None:
            hold_back(pull, touch.points, among.W)
    unknown, P = in_one_piece(np.empty((0, 0))), len(touch.places)
    contact = find_forces(among.law, among.W, unknown, P, among.begun.swung, found.pairs)
    add_up_forces(contact, beside.w, found)
    for i in range(len(motion.pushed)):
        motion.pushed[i] = dot(touch.points[i], found.forces) if contact.status == FOUND else 0.0
    return contact


@jit_part
def _end_touched(
    body: Body, r: Array, pushed: Array, strains: Strains, motion: Motion, among: Among, pull: Pull | None, space: Array
) -> Step:
    """Ends a step among obstacles from r (m,), with v̂ of the motion without contact; sets forces of contact (m,).

    `space` has room for what `begin_beside` takes.
    Cables hold their strokes under contact forces, too, or are slack.
    """
    touch, law, found, forces, v = among.touch, among.law, among.found, among.found.forces, motion.velocity
    h, beside = law.h, begin_beside(among.moving, law.h, len(found.gaps), space)
    contact, answer = Found(OTHERWISE, 0, 0.0), motion.pushed.copy()
    for count in range(TOGETHER if pull is not None else 1):
        if pull is not None:
            if count > 0 and not find_held(pull, v):
                return NOT_TAKEN
            move_by(pull, 1.0, v)
        contact = _find_contact(r, motion, among, beside, pull)
        if contact.status == OTHERWISE:
            return NOT_TAKEN
        if pull is not None:
            hold(pull, motion.pushed, v)
        copy(motion.pushed, answer)
        solve(motion.factor, answer)
        for i in range(len(v)):
            v[i] += answer[i]
        if pull is not None:
            if is_settled(pull, v):
                break
            for i in range(len(v)):
                v[i] -= answer[i]
            move_by(pull, -1.0, v)
            contact = Found(OTHERWISE, 0, 0.0)
    if contact.status == OTHERWISE:
        return NOT_TAKEN
    if pull is not None:
        end_pull(pull, motion.force)
    copy(motion.pushed, pushed)
    copy(among.beyond, among.beyond_before)
    by_obstacles, power, stored, yields = add_up_forces(contact, beside.w, found), dot(pushed, v), 0.0, len(touch.R) > 0
    step = end_step(body, r, strains, motion)
    dissipated = step.dissipated
    if yields:
        lost, power_beyond, stored = step_beyond(touch, h, among.beyond, touch.R[:0], forces, found.motion[3])
        dissipated, power = dissipated + lost, power + power_beyond
        if contact.status == NOTHING and stored < 2 * FORGOTTEN:
            stored = 0.0
            for k in range(len(forces)):
                for j in range(4):
                    among.beyond[j, k] = 0.0
    square, whole = step.square + stored, power - by_obstacles
    normal = contact.normal_power if law.friction > 0 else whole
    if not math.isfinite(square):
        copy(among.beyond_before, among.beyond)
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
def _pull_alone(pull: Pull, motion: Motion) -> bool:
    """Has cables go as they are to, or be slack, where nothing touches; whether forces are found."""
    v = motion.velocity
    for count in range(TOGETHER):
        if count > 0 and not find_held(pull, v):
            return False
        move_by(pull, 1.0, v)
        if is_settled(pull, v):
            end_pull(pull, motion.force)
            return True
        move_by(pull, -1.0, v)
    return False


@jit_part
def _set_delassus(touch: Touch, factor: Array, spread: Array, W: Array) -> None:
    """Sets W = S A⁻¹ Sᵀ + R/a by the factor of A."""
    copy(touch.points, spread)
    solve_rows(factor, spread)
    squares(spread, W)
    if len(touch.R) > 0:
        for i in range(len(W)):
            for j in range(len(W)):
                W[i, j] += touch.R[i, j] / touch.whole


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
    if not free_step(body, u, halves[0], halves[1], pushed, strains, motion, pull):
        return NOT_TAKEN
    if among is not None:
        if turn_too_far(among.moving):
            return NOT_TAKEN
        space = work_space(room_beside(among.moving, len(among.found.gaps)))
        return _end_touched(body, halves[1], pushed, strains, motion, among, pull, space)
    if pull is not None and not _pull_alone(pull, motion):
        return NOT_TAKEN
    return end_step(body, halves[1], strains, motion)
