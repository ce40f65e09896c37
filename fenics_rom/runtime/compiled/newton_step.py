"""The mid-step velocity of a held body that deforms largely by Newton's method, compiled: `steppers.held`.

What touches, and what holds strokes, is found in every iteration. The slope is found where a step begins, and anew
where what is out of balance shrinks slowly.
"""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, Found
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.runtime.compiled.carried_strains import Strains, add_inertia
from fenics_rom.runtime.compiled.following import add_following, add_following_slope
from fenics_rom.runtime.compiled.held_touch import NOT_FOUND, Among, Body, Motion, find_touching
from fenics_rom.runtime.compiled.sampled_points import (
    InStep,
    Sampled,
    begin_points,
    set_resistance,
    set_slope_of_points,
)
from fenics_rom.runtime.compiled.small_matrices import factor, multiply, solve
from fenics_rom.runtime.compiled.strokes import Pull, add_pull_slope, aim, set_pull
from fenics_rom.runtime.steppers.convergence import (
    CONVERGENCE_TOLERANCE,
    FAST_CONTRACTION,
    MAX_ITERATIONS,
    STAGNATION_TOLERANCE,
)


@jit_part
def find_by_newton(
    body: Body,
    sampled: Sampled,
    u: Array,
    r: Array,
    strains: Strains,
    motion: Motion,
    among: Among | None,
    beside: Beside | None,
    pull: Pull | None,
) -> tuple[Found, InStep]:
    """Sets v̂ of a step under u (p,) from q and r (m,), the force of inputs, and what touches; OTHERWISE: none."""
    law, m, q, lack, force, v = body.law, len(r), motion.q, motion.residual, motion.force, strains.velocity
    step, before, is_fresh = begin_points(sampled, law, strains.relaxed, q), math.inf, True
    copy(r, v)
    if pull is not None:
        aim(pull, u, q, r, law.h)
    for count in range(MAX_ITERATIONS):
        for i in range(m):
            strains.at[i] = q[i] + law.h / 2 * v[i]
        multiply(body.dead, u, force)
        add_following(body.loads, u, strains.at, strains.products[0], force)
        set_resistance(sampled, law, step, q, v, strains.pull)
        scale, total = 0.0, 0.0
        for i in range(m):
            lack[i] = 2 / law.h * (v[i] - r[i]) + strains.pull[i] - force[i]
            of_motion = 2 / law.h * max(abs(r[i]), abs(v[i]))
            scale, total = max(scale, of_motion, abs(strains.pull[i]), abs(force[i])), total + lack[i]
        if not math.isfinite(total):
            return NOT_FOUND, step
        if count == 0 and not _take_slope(body, sampled, u, step, strains, motion, pull):
            return NOT_FOUND, step
        _correct(v, lack, motion)
        if pull is not None:
            set_pull(pull, strains.at, motion.factor)
        found = find_touching(law.h, u, r, motion, among, beside, pull)
        if found.status == OTHERWISE:
            return NOT_FOUND, step
        error = 0.0
        for i in range(m):
            if among is not None:
                lack[i] -= motion.pushed[i]
            if pull is not None:
                for k in range(len(pull.found)):
                    lack[i] -= pull.found[k] * pull.lines[k, i]
            error = max(error, abs(lack[i]))
        stagnates = error > before / 2 and error <= max(STAGNATION_TOLERANCE * scale, sampled.round_off)
        if stagnates or error <= CONVERGENCE_TOLERANCE * max(scale, sampled.round_off):
            copy(v, motion.velocity)
            return found, step
        is_slow = error > FAST_CONTRACTION * before and not is_fresh
        if is_slow:
            if not _take_slope(body, sampled, u, step, strains, motion, pull):
                return NOT_FOUND, step
            _correct(v, lack, motion)
        is_fresh, before = is_slow, error
        copy(motion.velocity, v)
    return NOT_FOUND, step


@jit_part
def _correct(v: Array, lack: Array, motion: Motion) -> None:
    """Sets v̂ of the motion to where v (m,) leads with what is out of balance."""
    copy(lack, motion.velocity)
    solve(motion.factor, motion.velocity)
    for i in range(len(v)):
        motion.velocity[i] = v[i] - motion.velocity[i]


@jit_part
def _take_slope(
    body: Body, sampled: Sampled, u: Array, step: InStep, strains: Strains, motion: Motion, pull: Pull | None
) -> bool:
    """Factors the slope at v̂, of the loads, too, without what makes it indefinite; whether it is definite then."""
    law, K, loads = body.law, motion.factor, strains.matrices
    set_slope_of_points(sampled, law, step, True, strains.K)
    loads[:] = 0.0
    add_following_slope(body.loads, u, strains.at, -law.h / 2, loads)
    if pull is not None:
        add_pull_slope(pull, strains.at, -law.h / 2, loads)
    for attempt in range(3):
        if attempt == 2:
            set_slope_of_points(sampled, law, step, False, strains.K)
        for i in range(len(K)):
            for j in range(len(K)):
                K[i, j] = (strains.K[i, j] + strains.K[j, i]) / 2
                if attempt == 0:
                    K[i, j] += (loads[i, j] + loads[j, i]) / 2
        add_inertia(law, K)
        if factor(K):
            return True
    return False
