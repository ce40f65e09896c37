"""The step of a held body whose strains are carried along, whole: `steppers.held`, compiled.

(2/h + matrix) v̂ = 2/h r - pull + G u + Sᵀ f,   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r
"""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.copying import copy
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
from fenics_rom.runtime.compiled.small_matrices import dot, factor, multiply, solve
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
    factor: Array  # of the step's matrix (m, m)


@jit_part
def motion_in(vectors: Array, factor: Array) -> Motion:
    """As parts of few arrays, (7, m) and (m, m)."""
    return Motion(vectors[0], vectors[1], vectors[2], vectors[3], vectors[4], vectors[5], vectors[6], factor)


class Step(NamedTuple):
    """What a step did."""

    is_taken: bool
    went_as_expected: bool
    supplied: float  # J
    dissipated: float  # J
    square: float  # twice the stored energy, J


@jit_part
def free_step(body: Body, u: Array, e: Array, r: Array, pushed: Array, strains: Strains, motion: Motion) -> bool:
    """Sets v̂ of a step under u (p,) from e and r (m,) without contact; whether there is one.

    `pushed` are generalized forces (m,) of contact in the step before.
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
    return True


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
    square += dot(motion.r, motion.r) + 2 * (strains.numbers[ENERGY] + strains.numbers[LEFT])
    return Step(math.isfinite(square), went_as_expected, law.h * dot(motion.force, v), heat, square)


@jit
def take_step(
    body: Body, u: Array, halves: Array, pushed: Array, memory: Memory, vectors: Array, matrix: Array
) -> Step:
    """A step under u (p,) from e and r (2, m) that nothing touches; `pushed` as in `free_step`.

    Where it is not taken, what strains are then is of no use.
    """
    e, r, strains, motion = halves[0], halves[1], strains_in(memory), motion_in(vectors, matrix)
    if not free_step(body, u, e, r, pushed, strains, motion):
        return Step(False, False, 0.0, 0.0, 0.0)
    return end_step(body, r, strains, motion)
