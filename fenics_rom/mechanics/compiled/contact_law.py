"""The contact law of one step, as `mechanics.contact_solver` has it, compiled: what takes part, what it asks, forces.

Where it takes more than Newton's method and sweeps over pairs, as where W does not tell forces apart, it says so: NumPy
takes the step from its beginning.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_ahead, jit_apart, jit_part
from fenics_rom.compiled_arrays import unowned
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.braking import MOST_LOOKS, NEARLY_NONE
from fenics_rom.mechanics.compiled.copying import copy, fill, largest_of
from fenics_rom.mechanics.compiled.coulomb import (
    ACCURATE,
    STAGNATION,
    add_motion,
    frame_along,
    look_at,
    operator_among,
    yielding_of,
)
from fenics_rom.mechanics.compiled.linearised import Among, room_among
from fenics_rom.mechanics.compiled.newton import Inverse, find_with_operator
from fenics_rom.mechanics.compiled.obstacle_motion import Beside, row_of
from fenics_rom.mechanics.compiled.searches import find_among
from fenics_rom.mechanics.compiled.swinging import next_share, share_of
from fenics_rom.mechanics.compiled.work_space import (
    release,
    take,
    take_frames,
    take_integers,
    take_rows,
    taken,
    work_space,
)
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_search import PUSHING

NOTHING, FOUND, OTHERWISE = 0, 1, 2  # what came of it: nothing touches; forces; that it is to be found otherwise
MISSED = 3  # that more pairs take part
WORK_ROUND_OFF, BACK = 1e-12, 1 + 1e-9  # see `mechanics.braking` and `mechanics.contact_pairs`
# Of the velocities that forces stop; and unknown velocities, as a share of unknown forces: with more of them, forces as
# near to the law take less by forces.
NEAR, FEW = 1e-3, 2 / 3
EPS = float(np.finfo(float).eps)
MOST_ROUNDS = 60  # of forces for a set of pairs, and what it asks of them
# Numbers of the work space for each pair: 22, and of what swings 15 and the 9 of `find_change`, more than methods take
# that find forces. For each point: 4, and the 35 of `find_by_newton`.
OF_A_PAIR, OF_A_POINT = 22 + 15 + 9, 4 + 35


class Law(NamedTuple):
    """The law in steps of h s, as numbers."""

    h: float
    restitution: float
    friction: float  # of the pairs, at most
    rate: float  # by which a gap is closed, 1/s: -1/h, or -k/(k h/2 + d) of springs and dashpots
    compliance: float  # of each pair along its normal, m/s/N; 0 of the rigid law
    is_at_rest: bool  # without inertia
    swings: int  # steps in a row after which what friction did not stop is asked for a share: see `mechanics.braking`
    radius: float  # m, of the largest ball that each obstacle holds, at least: what would end deeper inside is NumPy's

    @staticmethod
    def of(law: ContactLaw, dt: float, quasi_static: bool, radius: float = math.inf) -> "Law":
        """The same as NumPy's, in steps of dt, s; radius as above."""
        given = float(law.restitution), float(law.friction)  # of whole ones loops would be compiled anew
        return Law(dt, *given, *law.in_steps(dt), quasi_static, braking.SWINGS, float(radius))


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


@jit_ahead
def ask(
    law: Law,
    gaps: Array,
    free: Array,
    velocity: Array,
    beside: Beside,
    before: Array,
    outwards: Array,
    pairs: Pairs,
    farthest: float,
) -> None:
    """Sets what the law says of every pair, obstacle after obstacle.

    Args:
        law: the law.
        gaps: of the pairs (N,), m.
        free, velocity: of the points (P, 3) in the middle of the step without contact and at its start, m/s.
        beside: how obstacles move.
        before: forces of the step before (N, 3), N.
        outwards: normal velocities (N,) that tell what leaves, m/s; (0,): those without contact.
        pairs: with normals, the first rows of frames, and forces to begin with; the rest is set.
        farthest: gap beyond which pairs are known to take no part, m; nothing else is said of them.
    """
    (w, w_before, first), P, turns = beside, len(free), len(beside.first) > 0
    slides = law.friction > 0 and not law.is_at_rest
    gap = math.inf
    for c in range(len(gaps)):
        gap = gaps[c] if gaps[c] < gap else gap
    least = PUSHING * largest_of(before)
    for c in range(len(gaps)):
        if gaps[c] > farthest:
            pairs.level[c], pairs.chosen[c], pairs.helped[c] = -math.inf, False, False
            continue
        o, p, axes, relative = row_of(w, c, len(gaps), P), c % P, pairs.axes[c], pairs.relative[c]
        frame_along(axes)
        # What keeps touching an obstacle that accelerates has its velocity between the steps.
        share = 0.5 if max(abs(before[c, 0]), abs(before[c, 1]), abs(before[c, 2])) > least else 0.0
        for k in range(3):
            pairs.free[c, k] = relative[k] = 0.0
            for j in range(3):
                pairs.free[c, k] += axes[k, j] * (free[p, j] - w[o, j])
                relative[k] += axes[k, j] * (velocity[p, j] - w[o, j] + share * (w[o, j] - w_before[o, j]))
        if turns and share > 0:  # as fast along n as it nears the obstacle when the step begins
            for k in range(3):
                relative[k] = 0.0
                for j in range(3):
                    along = first[c, j] if k == 0 else axes[k, j]
                    relative[k] += along * (velocity[p, j] - w_before[o, j])
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
            if gaps[c] + law.h * target < -law.radius:
                target = -math.inf
            elif turns:  # does not go farther
                target = max(target, min(closing, 0.0))
        pairs.level[c], pairs.target[c, 0] = level, target
        pairs.target[c, 1] = relative[1] / 2 if slides else 0.0
        pairs.target[c, 2] = relative[2] / 2 if slides else 0.0
        pairs.chosen[c], pairs.helped[c] = pairs.free[c, 0] < level, False


@jit_part
def rubbed(law: Law, friction: float) -> Law:
    """The same law with another coefficient of friction."""
    numbers = law.rate, law.compliance, law.is_at_rest, law.swings, law.radius
    return Law(law.h, law.restitution, friction, *numbers)


@jit_apart
def find_forces(law: Law, W: Array, inverse: Inverse, P: int, swung: Array, pairs: Pairs) -> Found:
    """Contact forces of a step of which `ask`, or who knows it, has said what the law asks.

    Args:
        law: the law.
        W: the Delassus operator (3P, 3P), m/s/N; where it is not symmetric, its transpose.
        inverse: of it as it is given, or of what is nearly so.
        P: number of points; of pairs of two bodies each is a point.
        swung: (N,) in how many steps in a row friction did not stop a pair.
        pairs: what takes part, what is asked and forces are set; unless the status is OTHERWISE these are what came.
    """
    space = work_space(OF_A_PAIR * len(pairs.level) + OF_A_POINT * P + 3)
    return _find_forces(law, unowned(W), unowned(inverse), P, unowned(swung), unowned(pairs), space)


@jit_part
def _find_forces(law: Law, W: Array, inverse: Inverse, P: int, swung: Array, pairs: Pairs, space: Array) -> Found:
    """The same, with a work space."""
    sweeps = 0
    for _ in range(MOST_ROUNDS):
        release(space, 1.0)
        active = _chosen_among(pairs, space)
        if len(active) == 0:
            return Found(NOTHING, 0, 0.0)
        found = _find_of(law, W, inverse, P, swung, pairs, active, room_among(len(active)), space)
        sweeps += found.sweeps
        if found.status != MISSED:
            return Found(found.status, sweeps, found.normal_power)
    return Found(OTHERWISE, sweeps, 0.0)


@jit_part
def _find_of(
    law: Law, W: Array, inverse: Inverse, P: int, swung: Array, pairs: Pairs, active: Array, room: Among, space: Array
) -> Found:
    """The same where some pairs (C,) take part; the status is MISSED where others are to, which are chosen then."""
    N, C, sweeps, any_helped, among = len(pairs.level), len(active), 0, False, unowned(room)
    for c in range(N):
        any_helped = any_helped or pairs.helped[c]
    slides = law.friction > 0 and not law.is_at_rest
    share = share_of(pairs.helped, pairs.relative, pairs.target)
    below, above, looks = 0.0, 1.0, MOST_LOOKS  # bounds of the share, σ of `mechanics.braking`
    points, axes, yielding, friction = take_integers(space, C), take_frames(space, C), take(space, C), take(space, C)
    q, f, u = take_rows(space, C, 3), take_rows(space, C, 3), take_rows(space, C, 3)
    for i in range(C):
        c = active[i]
        points[i], friction[i] = c % P, pairs.friction[c]
        copy(pairs.axes[c], axes[i])
        yielding[i] = yielding_of(W, points[i], law.compliance)
        for k in range(3):
            f[i, k] = 0.0
            for j in range(3):
                f[i, k] += axes[i, k, j] * pairs.forces[c, j]
    has_newton = len(inverse.whole) > 0 and slides and law.compliance == 0 and _are_apart(points, P, space)
    are_known, begun = 2 * C <= P, taken(space)  # where more take part, one look at all may do
    if are_known:
        operator_among(W, points, axes, law.compliance, among.V)
    for _ in range(MOST_ROUNDS):
        release(space, begun)
        speed = 0.0
        for i in range(C):
            if pairs.target[active[i], 0] == -math.inf:
                return Found(OTHERWISE, sweeps, 0.0)
            for k in range(3):
                q[i, k] = pairs.free[active[i], k] - pairs.target[active[i], k]
                speed = max(speed, abs(q[i, k]))
        error, is_found, given = math.inf, False, (q, friction, yielding, f, u)
        if not are_known:
            at, moved = (W, points, axes, q, friction, law.compliance, yielding, f, u), take(space, len(W))
            error = look_at(*at, moved)
            is_found = error <= ACCURATE * speed
            most = 1.0 if error > NEAR * speed else FEW
            if not is_found and has_newton and _velocities(P, friction, yielding, f, u) <= most:
                count, is_found, error = find_with_operator(inverse, *at, moved, error, space)
                sweeps += count
        if not (is_found and error <= STAGNATION * speed):
            if not are_known:
                operator_among(W, points, axes, law.compliance, among.V)
                are_known = True
            count, error = find_among(among, *given, speed, space)
            sweeps += count
        if not error <= STAGNATION * speed:
            return Found(OTHERWISE, sweeps, 0.0)
        fill(pairs.forces, 0.0)
        largest = 0.0
        for i in range(C):
            for j in range(3):
                pairs.forces[active[i], j] = axes[i, 0, j] * f[i, 0] + axes[i, 1, j] * f[i, 1] + axes[i, 2, j] * f[i, 2]
                largest = max(largest, abs(f[i, j]))
        if EPS * largest * largest_of(yielding) > STAGNATION * speed:  # what they do is round-off, as of none there are
            return Found(OTHERWISE, sweeps, 0.0)
        if C < N and _choose_missed(W, pairs, points, active, space):
            for c in range(N if slides else 0):  # the power of friction is that of all pairs
                pairs.helped[c] = False
                pairs.target[c, 1], pairs.target[c, 2] = pairs.relative[c, 1] / 2, pairs.relative[c, 2] / 2
            return Found(MISSED, sweeps, 0.0)
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
            for i in range(C):
                swings = swings or (pairs.helped[active[i]] and swung[active[i]] >= law.swings)
            if swings and not repeat:  # as `Braking` does
                whole, moves, along = take_rows(space, C, 3), take_rows(space, C, 3), 0.0  # c_t at σ = 1; u + c_t
                for i in range(C):
                    c = active[i]
                    whole[i, 0] = whole[i, 1] = whole[i, 2] = 0.0
                    moves[i, 0] = u[i, 0]
                    moves[i, 1], moves[i, 2] = u[i, 1] + pairs.target[c, 1], u[i, 2] + pairs.target[c, 2]
                    if pairs.helped[c] and swung[c] >= law.swings:
                        whole[i, 1], whole[i, 2] = pairs.relative[c, 1] / 2, pairs.relative[c, 2] / 2
                        along += abs(f[i, 1] * whole[i, 1]) + abs(f[i, 2] * whole[i, 2])
                if power > negligible:
                    above = share
                else:
                    below = share
                enough, ahead = max(negligible, NEARLY_NONE * along), share
                stays = power <= negligible and (looks == 0 or (share > 0 and power >= -enough))
                if not stays and looks == 0:
                    ahead = below if below < share else 0.0
                elif not stays:
                    looks -= 1
                    if not are_known:
                        operator_among(W, points, axes, law.compliance, among.V)
                        are_known = True
                    of_law = among, whole, friction, yielding, f, u
                    ahead = next_share(*of_law, moves, share, below, above, negligible, enough, space)
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
def _choose_missed(W: Array, pairs: Pairs, points: Array, active: Array, space: Array) -> bool:
    """Whether forces of some pairs (C,) have others take part, which are chosen."""
    moved, missed = take(space, len(W)), False
    fill(moved, 0.0)
    for i in range(len(active)):
        x, y, z = pairs.forces[active[i]]
        if x != 0.0 or y != 0.0 or z != 0.0:
            add_motion(W, points[i], x, y, z, moved)
    for c in range(len(pairs.level)):
        if not pairs.chosen[c] and pairs.level[c] > -math.inf:
            n, at = pairs.axes[c, 0], 3 * (c % (len(W) // 3))
            outwards = n[0] * moved[at] + n[1] * moved[at + 1] + n[2] * moved[at + 2] + pairs.free[c, 0]
            if outwards < pairs.level[c]:
                pairs.chosen[c] = missed = True
    return missed


@jit_part
def _chosen_among(pairs: Pairs, space: Array) -> Array:
    """Which pairs (C,) take part, in order."""
    active, C = take_integers(space, len(pairs.chosen)), 0
    for c in range(len(active)):
        if pairs.chosen[c]:
            active[C] = c
            C += 1
    return active[:C]


@jit_part
def _are_apart(points: Array, P: int, space: Array) -> bool:
    """Whether pairs are at points, of P, that are all different."""
    touched, are_apart = take_integers(space, P), True
    for p in range(P):
        touched[p] = 0
    for p in points:
        are_apart = are_apart and touched[p] == 0
        touched[p] = 1
    return are_apart


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
