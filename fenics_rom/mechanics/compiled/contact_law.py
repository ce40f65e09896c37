"""The contact law of one step, as `mechanics.contact_solver` has it, compiled: what takes part, what it asks, forces.

Where it takes more than Newton's method and sweeps over pairs, as where W does not tell forces apart, it says so: NumPy
takes the step from its beginning.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part, jit_shared
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.braking import LEAST_SHARE, MOST_LOOKS, NEARLY_NONE
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.coulomb import ACCURATE, add_motion, frame_along, look_at, yielding_of
from fenics_rom.mechanics.compiled.linearised import add_change, find_by_steps
from fenics_rom.mechanics.compiled.newton import find_with_operator
from fenics_rom.mechanics.compiled.sweeps import MOST_SWEEPS, find_by_sweeps
from fenics_rom.mechanics.contact_search import PUSHING

NOTHING, FOUND, OTHERWISE = 0, 1, 2  # what came of it: nothing touches; forces; that it is to be found otherwise
STAGNATION = 1e-9 / 100  # of the velocities that forces stop: see `complementarity.solution`
WORK_ROUND_OFF, BACK = 1e-12, 1 + 1e-9  # see `mechanics.braking` and `mechanics.contact_pairs`
# Of the velocities that forces stop; and unknown velocities, as a share of unknown forces: with more of them, forces as
# near to the law take fewer sweeps than solves.
NEAR, FEW = 1e-3, 2 / 3
FEW_SWEEPS = 8  # before steps of Newton's method are tried
MOST_ROUNDS = 60  # of forces for a set of pairs, and what it asks of them

root_of = jit_shared(braking.root_of)


class Law(NamedTuple):
    """The law in steps of h s, as numbers."""

    h: float
    restitution: float
    friction: float  # of the pairs, at most
    rate: float  # by which a gap is closed, 1/s: -1/h, or -k/(k h/2 + d) of springs and dashpots
    compliance: float  # of each pair along its normal, m/s/N; 0 of the rigid law
    is_at_rest: bool  # without inertia
    swings: int  # steps in a row after which what friction did not stop is asked for a share: see `mechanics.braking`


class Pairs(NamedTuple):
    """What the law says of N pairs in a step, and found; set by `find_forces`."""

    axes: Array  # (N, 3, 3) frames: rows n, t1 and t2
    free: Array  # (N, 3) relative mid-step velocities without contact, in the frames, m/s
    relative: Array  # (N, 3) those at the start of the step
    target: Array  # (N, 3): c, then c_t, m/s
    level: Array  # (N,) normal velocities below which a pair takes part, m/s
    chosen: Array  # (N,) whether it does
    helped: Array  # (N,) whether friction is not asked to stop it
    friction: Array  # μ (N,)
    forces: Array  # (N, 3) along the axes of space, N


def pairs_from(forces: Array, friction: float | Array) -> Pairs:
    """Of N pairs with friction μ, of all or of each, whose search begins with forces (N, 3)."""
    N = len(forces)
    vectors = np.empty((3, N, 3))
    flags = np.empty((2, N), dtype=bool)
    axes = np.empty((N, 3, 3))
    asked = vectors[0], vectors[1], vectors[2], np.empty(N), flags[0], flags[1], np.full(N, friction)
    return Pairs(axes, *asked, forces.copy())


class Found(NamedTuple):
    """What came of a search."""

    status: int
    sweeps: int
    normal_power: float  # Σ λ s, W


@jit_part
def largest(forces: Array) -> float:
    """Component of forces (N, 3), N."""
    size = 0.0
    for c in range(len(forces)):
        for k in range(3):
            size = max(size, abs(forces[c, k]))
    return size


@jit
def ask(
    law: Law,
    gaps: Array,
    free: Array,
    velocity: Array,
    w: Array,
    w_before: Array,
    before: Array,
    outwards: Array,
    pairs: Pairs,
) -> None:
    """Sets what the law says of every pair, obstacle after obstacle.

    Args:
        law: the law.
        gaps: of the pairs (N,), m.
        free, velocity: of the points (P, 3) in the middle of the step without contact and at its start, m/s.
        w, w_before: of the obstacles (O, 3) in this step and in the one before, m/s.
        before: forces of the step before (N, 3), N.
        outwards: normal velocities (N,) that tell what leaves, m/s; (0,): those without contact.
        pairs: with normals, the first rows of frames, and forces to begin with; the rest is set.
    """
    P = len(free)
    slides = law.friction > 0 and not law.is_at_rest
    gap = gaps.min()
    least = PUSHING * largest(before)
    for c in range(len(gaps)):
        o, p, axes, relative = c // P, c % P, pairs.axes[c], pairs.relative[c]
        frame_along(axes)
        # What keeps touching an obstacle that accelerates has its velocity between the steps.
        share = 0.5 if max(abs(before[c, 0]), abs(before[c, 1]), abs(before[c, 2])) > least else 0.0
        for k in range(3):
            pairs.free[c, k] = relative[k] = 0.0
            for j in range(3):
                pairs.free[c, k] += axes[k, j] * (free[p, j] - w[o, j])
                relative[k] += axes[k, j] * (velocity[p, j] - w[o, j] + share * (w[o, j] - w_before[o, j]))
        approach, leaving = relative[0], outwards[c] if len(outwards) else pairs.free[c, 0]
        closing = gaps[c] * law.rate
        if law.compliance > 0:
            level = target = closing
        elif law.is_at_rest:
            level = target = min(closing, 0.0)
        else:
            stopped = approach / 2
            later = (closing + stopped) / 2
            level, target = max(closing, later), min(stopped, later)
            bounces = law.restitution == 1.0 or leaving >= approach * BACK * (1 + law.restitution)
            if law.restitution > 0 and bounces:
                target = approach * (1 - law.restitution) / 2
            if gap < 0:
                speed = math.sqrt(w[o, 0] ** 2 + w[o, 1] ** 2 + w[o, 2] ** 2)
                if closing > abs(approach) + abs(leaving) + speed:
                    target = 0.0
            target = min(target, 0.0)
        pairs.level[c], pairs.target[c, 0] = level, target
        pairs.target[c, 1] = relative[1] / 2 if slides else 0.0
        pairs.target[c, 2] = relative[2] / 2 if slides else 0.0
        pairs.chosen[c], pairs.helped[c] = pairs.free[c, 0] < level, False


@jit
def find_forces(law: Law, W: Array, inverse: Array, P: int, swung: Array, pairs: Pairs) -> Found:
    """Contact forces of a step of which `ask`, or who knows it, has said what the law asks.

    Args:
        law: the law.
        W: the Delassus operator (3P, 3P), m/s/N; where it is not symmetric, its transpose.
        inverse: of it as it is given, or of what is nearly so; (0, 0) where it is not known.
        P: number of points; of pairs of two bodies each is a point.
        swung: (N,) in how many steps in a row friction did not stop a pair.
        pairs: what takes part, what is asked and forces are set; unless the status is OTHERWISE these are what came.
    """
    N, sweeps, any_helped = len(pairs.level), 0, bool(pairs.helped.any())
    slides = law.friction > 0 and not law.is_at_rest
    share, below, above, looks = _share_of(pairs), 0.0, 1.0, MOST_LOOKS  # σ of `mechanics.braking`, and its bounds
    has_newton = len(inverse) > 0 and slides and law.compliance == 0
    for _ in range(MOST_ROUNDS):
        active = pairs.chosen.nonzero()[0]
        C = len(active)
        if C == 0:
            return Found(NOTHING, 0, 0.0)
        touched = np.zeros(P, dtype=np.bool_)
        for c in active:
            touched[c % P] = True
        few = touched.nonzero()[0]
        among, part = np.arange(P), W
        if 2 * len(few) <= P:
            part = part_of(W, few)
            for i in range(len(few)):
                among[few[i]] = i
        points, axes, yielding = np.empty(C, dtype=np.int64), np.empty((C, 3, 3)), np.empty(C)
        friction = pairs.friction[active]
        q, f, u, speed = np.empty((C, 3)), np.empty((C, 3)), np.empty((C, 3)), 0.0
        for i in range(C):
            c = active[i]
            points[i] = among[c % P]
            copy(pairs.axes[c], axes[i])
            yielding[i] = yielding_of(part, points[i], law.compliance)
            for k in range(3):
                q[i, k] = pairs.free[c, k] - pairs.target[c, k]
                f[i, k] = 0.0
                for j in range(3):
                    f[i, k] += axes[i, k, j] * pairs.forces[c, j]
                speed = max(speed, abs(q[i, k]))
        moved = np.empty(len(part))
        given = part, points, axes, q, friction, law.compliance
        error = look_at(*given, yielding, f, u, moved)
        if not error <= ACCURATE * speed:
            is_found = False
            is_fit, most = has_newton and len(part) == len(W) and len(few) == C, 1.0 if error > NEAR * speed else FEW
            if is_fit and _velocities(P, friction, yielding, f, u) <= most:
                count, is_found, error = find_with_operator(inverse, *given, yielding, f, u, moved, error)
                sweeps += count
            if not (is_found and error <= STAGNATION * speed):
                sweeps += find_by_sweeps(*given, f, moved, FEW_SWEEPS)
                error = look_at(*given, yielding, f, u, moved)
            if not error <= STAGNATION * speed:
                count, is_found = find_by_steps(*given, yielding, f, u, moved)
                sweeps += count
                error = look_at(*given, yielding, f, u, moved)
                if not is_found:
                    sweeps += find_by_sweeps(*given, f, moved, MOST_SWEEPS - FEW_SWEEPS)
                    error = look_at(*given, yielding, f, u, moved)
        if not error <= STAGNATION * speed:
            return Found(OTHERWISE, sweeps, 0.0)
        pairs.forces[:] = 0.0
        largest = 0.0
        for i in range(C):
            for j in range(3):
                pairs.forces[active[i], j] = axes[i, 0, j] * f[i, 0] + axes[i, 1, j] * f[i, 1] + axes[i, 2, j] * f[i, 2]
                largest = max(largest, abs(f[i, j]))
        missed = False
        if C < N:
            if len(part) < len(W):
                moved = np.zeros(len(W))
                for i in range(C):
                    c = active[i]
                    add_motion(W, c % P, pairs.forces[c, 0], pairs.forces[c, 1], pairs.forces[c, 2], moved)
            for c in range(N):
                if not pairs.chosen[c]:
                    n, at = pairs.axes[c, 0], 3 * (c % P)
                    outwards = n[0] * moved[at] + n[1] * moved[at + 1] + n[2] * moved[at + 2] + pairs.free[c, 0]
                    if outwards < pairs.level[c]:
                        pairs.chosen[c] = missed = True
        if missed:  # the power of friction is that of all pairs: what it is not to stop is decided anew
            any_helped, share, below, above, looks = False, 1.0, 0.0, 1.0, MOST_LOOKS
            for c in range(N if slides else 0):
                pairs.helped[c] = False
                pairs.target[c, 1], pairs.target[c, 2] = pairs.relative[c, 1] / 2, pairs.relative[c, 2] / 2
            continue
        repeat, negligible, asked, power = False, WORK_ROUND_OFF * largest * speed, 0.0, 0.0
        if slides:
            for i in range(C):
                c = active[i]
                asked += f[i, 1] * pairs.target[c, 1] + f[i, 2] * pairs.target[c, 2]
                power += f[i, 1] * (u[i, 1] + pairs.target[c, 1]) + f[i, 2] * (u[i, 2] + pairs.target[c, 2])
            if (any_helped or asked > negligible) and power > negligible and (share == 0.0 or share == 1.0):
                for i in range(C):
                    c = active[i]
                    first, second = pairs.target[c, 1], pairs.target[c, 2]
                    work = f[i, 1] * (u[i, 1] + first) + f[i, 2] * (u[i, 2] + second)
                    if work > negligible and (first != 0 or second != 0):
                        pairs.helped[c], any_helped, repeat = True, True, True
                        pairs.target[c, 1] = pairs.target[c, 2] = 0.0
                share = 0.0 if repeat else share
            swings = False
            for c in active:
                swings = swings or (pairs.helped[c] and swung[c] >= law.swings)
            if swings and not repeat:  # as `Braking` does
                whole, moves = np.zeros((C, 3)), u.copy()  # c_t of what swings at σ = 1; u + c_t
                for i in range(C):
                    c = active[i]
                    moves[i, 1], moves[i, 2] = u[i, 1] + pairs.target[c, 1], u[i, 2] + pairs.target[c, 2]
                    if pairs.helped[c] and swung[c] >= law.swings:
                        whole[i, 1], whole[i, 2] = pairs.relative[c, 1] / 2, pairs.relative[c, 2] / 2
                if power > negligible:
                    above = share
                else:
                    below = share
                enough, ahead = max(negligible, NEARLY_NONE * np.abs(f * whole).sum()), share
                stays = power <= negligible and (looks == 0 or (share > 0 and power >= -enough))
                if not stays and looks == 0:
                    ahead = below if below < share else 0.0
                elif not stays:
                    looks -= 1
                    of_law = part, points, axes, whole, friction, law.compliance, yielding
                    ahead = _next_share(*of_law, f, u, moves, share, below, above, negligible)
                repeat = ahead != share
                for i in range(C if repeat else 0):
                    c = active[i]
                    pairs.target[c, 1] += (ahead - share) * whole[i, 1]
                    pairs.target[c, 2] += (ahead - share) * whole[i, 2]
                share = ahead
        if not repeat:
            power = 0.0
            for i in range(C):
                c = active[i]
                power += f[i, 0] * (u[i, 0] + pairs.target[c, 0] - law.compliance * f[i, 0])
            return Found(FOUND, sweeps, power)
    return Found(OTHERWISE, sweeps, 0.0)


@jit_part
def is_out_of_reach(
    law: Law, gap: float, free: Array, velocity: Array, w: Array, w_before: Array, pairs: Pairs
) -> bool:
    """Whether no pair takes part for sure, as the smallest gap, m, is wide for a step; the rest is as of `ask`.

    A pair takes part below -g/h or (-g/h + a/2)/2, the larger one; where all velocities are within s and g >= 2.5 h s
    both are below -s.
    """
    if law.compliance > 0 or law.is_at_rest:
        return False
    fastest = obstacles = 0.0
    for p in range(len(free)):
        square = free[p, 0] ** 2 + free[p, 1] ** 2 + free[p, 2] ** 2
        fastest = max(fastest, square, velocity[p, 0] ** 2 + velocity[p, 1] ** 2 + velocity[p, 2] ** 2)
    for o in range(len(w)):
        obstacles = max(obstacles, w[o, 0] ** 2 + w[o, 1] ** 2 + w[o, 2] ** 2)
        obstacles = max(obstacles, w_before[o, 0] ** 2 + w_before[o, 1] ** 2 + w_before[o, 2] ** 2)
    if not gap > 2.5 * law.h * (math.sqrt(fastest) + 2 * math.sqrt(obstacles)):
        return False
    for c in range(len(pairs.chosen)):
        pairs.chosen[c] = pairs.helped[c] = False
    return True


@jit_part
def _velocities(P: int, friction: Array, yielding: Array, f: Array, u: Array) -> float:
    """How many velocities of P points Newton's method does not know, as a share of forces of pairs; see `look_at`."""
    velocities, forces = 3 * (P - len(f)), 0
    for c in range(len(f)):
        n, a, b = f[c, 0] - u[c, 0] / yielding[c], f[c, 1] - u[c, 1] / yielding[c], f[c, 2] - u[c, 2] / yielding[c]
        if n <= 0:
            velocities += 3
        elif a * a + b * b > (friction[c] * n) ** 2:
            velocities, forces = velocities + 2, forces + 2
        else:
            forces += 3
    return velocities / forces if forces else np.inf


@jit_part
def _share_of(pairs: Pairs) -> float:
    """The share of its velocity that what swings is asked for, 1 where nothing does."""
    share = 1.0
    for c in range(len(pairs.helped)):
        if pairs.helped[c]:
            (_, x, y), (_, a, b) = pairs.relative[c], pairs.target[c]
            if a != 0 or b != 0:
                return 2 * (a * x + b * y) / (x * x + y * y)
            share = 0.0
    return share


@jit_part
def _next_share(
    W: Array,
    points: Array,
    axes: Array,
    whole: Array,
    friction: Array,
    compliance: float,
    yielding: Array,
    f: Array,
    u: Array,
    moves: Array,
    share: float,
    below: float,
    above: float,
    negligible: float,
) -> float:
    """The share that is to be looked at next, between two that are known to be too little and too much.

    Arguments as of `look_at`, but for whole (C, 3), c_t of what swings at σ = 1, and moves (C, 3), u + c_t, m/s.
    """
    z, by_f, by_moves, moved = f.copy(), np.zeros(f.shape), np.empty(f.shape), np.empty(len(W))
    for c in range(len(points)):
        for k in range(3):
            z[c, k] -= u[c, k] / yielding[c]
    if not add_change(W, points, axes, friction, compliance, yielding, z, -whole, by_f):
        return (below + above) / 2
    look_at(W, points, axes, np.zeros(f.shape), friction, compliance, yielding, by_f, by_moves, moved)
    square = slope = power = 0.0
    for c in range(len(points)):
        for k in range(1, 3):
            square += by_f[c, k] * by_moves[c, k]
            slope += by_f[c, k] * moves[c, k] + f[c, k] * by_moves[c, k]
            power += f[c, k] * moves[c, k]
    root = share + root_of(square, slope, power + negligible / 2)
    if below + LEAST_SHARE < root < above:
        return root
    if share == 0.0 and power >= -negligible and slope >= 0:
        return 0.0  # a little would be too much
    return (below + above) / 2


@jit_part
def part_of(W: Array, few: Array) -> Array:
    """What is of some points (s,) in an operator (3P, 3P), (3s, 3s)."""
    part = np.empty((3 * len(few), 3 * len(few)))
    for i in range(len(few)):
        for k in range(3):
            row = W[3 * few[i] + k]
            for j in range(len(few)):
                for m in range(3):
                    part[3 * i + k, 3 * j + m] = row[3 * few[j] + m]
    return part
