"""Contact of a linear body in a moving frame, compiled: what sweeps of `mechanics.frame_contact` share.

A sweep knows velocities of the step under forces f, and asks for those f' on points that would go by S v̂ - W f without
them. W guides it alone: it is that of the points within reach, of slopes that are kept. What sweeps decide of what
takes part, leaves and is stopped stays, as `contact_pairs.Settled` says.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, Found, Law, ask, find_forces
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE as UNKNOWN
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill, largest_of
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside, Moving, begin_beside, look, moving_in, room_beside
from fenics_rom.mechanics.compiled.springs import ask_springs, held_by
from fenics_rom.mechanics.compiled.work_space import work_space
from fenics_rom.mechanics.contact_pairs import FIRST
from fenics_rom.mechanics.frame_contact import PATIENCE, ROUND_OFF, TOLERANCE
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.bent_frame import Bending
from fenics_rom.runtime.compiled.contact_points import WHOLE, Points, arm_of, begin_points, end_points, see_forces
from fenics_rom.runtime.compiled.frame_tables import keep_step
from fenics_rom.runtime.compiled.frames import (
    OTHERWISE,
    TAKEN,
    Push,
    Step,
    Taken,
    added,
    cross,
    put,
    rotated,
    seen,
    vector,
)
from fenics_rom.runtime.compiled.touching import Begun, Last, StepContact, add_up_forces, hand_on, keep_found

MOST_SWEEPS = PATIENCE  # steps that take more are NumPy's
NO_PROGRESS = 1e-12  # of velocities: see `steppers.parted_kernel`
PLACE, VELOCITY, FREE, MOVED = range(4)  # rows of `StepContact.motion`; the last has velocities under the forces
OUTWARDS, CHOSEN, SHARES = range(3)  # rows of `Sweep.settled`


class Among(NamedTuple):
    """The obstacles that a body with P points is among in a step, and what it finds of N pairs with them."""

    law: Law
    shapes: Array  # of the obstacles, (O, 17)
    moving: Moving  # how they move
    begun: Begun
    points: Points
    at_rest: Array  # places of the points in world axes, (P, 3), m
    found: StepContact  # with forces to begin with; set
    W: Array  # that guides sweeps, m/s/N (3P, 3P)


@jit_part
def among_in(among: Among, path: Moving, step: int) -> Among:
    """The same obstacles in one of steps in a row; see `moving_in`."""
    law, shapes, _, begun, points, at_rest, found, W = among
    return Among(law, shapes, moving_in(path, step), begun, points, at_rest, found, W)


class Turn(NamedTuple):
    """How a frame turns in a step."""

    R: Rotation  # when it begins
    middle: Rotation  # R*
    end: Rotation
    t: Vector  # by which it turns, in its axes


class Sweep(NamedTuple):
    """What sweeps of a step go on with."""

    space: Array  # of the next ones
    beside: Beside  # how obstacles move
    settled: Array  # (3, N)
    is_near: Array  # whether W has a point (P,)
    kept: Array  # V r and rates of what points yield beyond the basis, (P, 3), m/s
    arms: Array  # (P, 3) in world axes, m


class Touched(NamedTuple):
    """What a step among obstacles did."""

    step: Step  # where that is OTHERWISE no step was taken
    contact: Found
    by_obstacles: float  # supplied, J
    lost: float  # dissipated in impacts, J
    friction: float  # dissipated, J


class TouchedTaken(NamedTuple):
    """Of steps in a row, one row each."""

    moved: Taken
    contact: Array  # (n, 3), J: by obstacles, lost in impacts, friction
    carried: Array  # g (n, 3P) beyond the basis after it, N; (n, 0) where there is nothing
    by_obstacle: Array  # forces of the obstacles in it (n, O, 3), N; (n, 0, 3) where nobody asks


@jit_part
def nothing_taken() -> Touched:
    """What there is of a step that was not taken."""
    return Touched(Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0), Found(UNKNOWN, 0, 0.0), 0.0, 0.0, 0.0)


@jit_part
def begin_sweeps(among: Among, h: float, q: Array, r: Array, R: Rotation, origin: Vector) -> Sweep:
    """Sets where points are at q (m,), how far from obstacles, and what they do beyond the basis, without forces."""
    points, (pairs, gaps, motion, _) = among.points, among.found
    P, N, n = len(points.rest), len(gaps), 3 * len(points.rest)
    begin_points(points, q, np.zeros(len(q)))
    kept, places = np.zeros((P, 3)), np.empty((P, 3))
    rates = kept.reshape(n)
    for i in range(len(r)):
        row, ri = points.rows[i], r[i]
        for k in range(n):
            rates[k] += row[k] * ri
    if len(points.R):
        for k in range(n):
            rates[k] += points.beyond[3, k]
    for p in range(P):
        put(places[p], 0, added(rotated(R, vector(points.start[p], 0)), 1.0, origin))
        for k in range(3):
            motion[PLACE, 3 * p + k] = places[p, k] - among.at_rest[p, k]
            points.forces[p, k] = points.seen[p, k] = 0.0
        points.pushed[p] = 0.0
    space = work_space(room_beside(among.moving, N))
    beside = begin_beside(among.moving, h, N, space)
    look(among.shapes, among.moving, h, places, gaps, pairs.axes[:, 0], beside)
    return Sweep(space, beside, np.zeros((3, N)), np.zeros(P, dtype=np.bool_), kept, np.empty((P, 3)))


@jit_part
def move_inside(points: Points, rate: Array) -> None:
    """Sets how points move in the frame at r̂ (m,), under the forces that it sees."""
    n = 3 * len(points.rest)
    inside = points.inside.reshape(n)
    copy(points.free, points.inside)
    for i in range(len(rate)):
        row, by = points.rows[i], rate[i]
        for k in range(n):
            inside[k] += row[k] * by
    if len(points.R):
        for p in range(len(points.rest)):
            if points.pushed[p]:
                for k in range(3):
                    add_row(points.R[points.slots[p], k], points.seen[p, k] / points.times[WHOLE], inside)


@jit_part
def set_arms(points: Points, turn: Turn, h: float, arms: Array) -> None:
    """Sets arms (P, 3) from the origin in the middle of the step."""
    for p in range(len(arms)):
        put(arms[p], 0, arm_of(points, p, turn.R, turn.end, h))


@jit_part
def set_modal(points: Points, modal: Array) -> None:
    """Sets what the forces that the frame sees do on the coordinates (m,)."""
    for i in range(len(modal)):
        modal[i] = 0.0
    for p in range(len(points.rest)):
        if points.pushed[p]:
            x, y, z = vector(points.seen[p], 0)
            for i in range(len(modal)):
                row = points.rows[i]
                modal[i] += row[3 * p] * x + row[3 * p + 1] * y + row[3 * p + 2] * z


@jit_part
def push_of(points: Points, turn: Turn, arms: Array) -> Push:
    """What the forces do, but on the coordinates."""
    force = torque = (0.0, 0.0, 0.0)
    for p in range(len(arms)):
        if points.pushed[p]:
            f = vector(points.forces[p], 0)
            force, torque = added(force, 1.0, f), added(torque, 1.0, cross(vector(arms[p], 0), f))
    return Push(force, torque, seen(turn.R, turn.t, torque))


@jit_part
def put_velocities(turn: Turn, origin: Vector, spin: Vector, arms: Array, inside: Array, row: Array) -> None:
    """Sets velocities (3P,) in world axes, of points that move by (P, 3) in a frame with those of origin and spin.

    `spin` is R* times that in the frame.
    """
    for p in range(len(arms)):
        moving = added(origin, 1.0, cross(spin, vector(arms[p], 0)))
        put(row, 3 * p, added(moving, 1.0, rotated(turn.middle, vector(inside[p], 0))))


@jit_part
def ask_in_sweep(among: Among, sweep: Sweep, count: int) -> None:
    """Has the law say what pairs are asked for in the sweep after so many, of velocities FREE and VELOCITY."""
    pairs, gaps, motion, _ = among.found
    free, velocity = motion[FREE].reshape(-1, 3), motion[VELOCITY].reshape(-1, 3)
    outwards = sweep.settled[OUTWARDS, : len(gaps) if count else 0]
    ask(among.law, gaps, free, velocity, sweep.beside, among.begun.forces, outwards, pairs, math.inf)
    ask_springs(among.law, gaps, math.inf, pairs)


@jit_part
def take_out_forces(among: Among) -> None:
    """Has FREE be without the forces of now, as W says."""
    points, free = among.points, among.found.motion[FREE]
    for p in range(len(points.rest)):
        if points.pushed[p]:
            for k in range(3):
                row, by = among.W[3 * p + k], points.forces[p, k]
                for j in range(len(free)):
                    free[j] -= row[j] * by


@jit_part
def find_in_sweep(among: Among, sweep: Sweep, count: int) -> Found:
    """Finds forces of what is asked in the sweep after so many, and takes note of what it decides."""
    pairs, settled, P = among.found.pairs, sweep.settled, len(among.points.rest)
    for c in range(len(pairs.chosen) if count else 0):
        pairs.chosen[c] = pairs.chosen[c] or settled[CHOSEN, c] != 0.0
        if count > FIRST and settled[SHARES, c] < 1:
            pairs.helped[c] = True
            pairs.target[c, 1] *= settled[SHARES, c]
            pairs.target[c, 2] *= settled[SHARES, c]
    unknown = in_one_piece(np.empty((0, 0)))
    found = find_forces(among.law, among.W, unknown, P, among.begun.swung, pairs)
    found = held_by(among.law, among.found.gaps, pairs, found)
    if found.status == UNKNOWN:
        return found
    for c in range(len(pairs.chosen)):
        if count == 0:
            settled[OUTWARDS, c] = pairs.free[c, 0]
        settled[CHOSEN, c], settled[SHARES, c] = 1.0 if pairs.chosen[c] else 0.0, 1.0
        if pairs.helped[c]:
            (_, x, y), (_, a, b) = pairs.relative[c], pairs.target[c]
            square = x * x + y * y
            settled[SHARES, c] = 2 * (a * x + b * y) / square if square > 0 else 0.0
    return found


@jit_part
def is_all_near(among: Among, sweep: Sweep) -> bool:
    """Whether W has all points that take part; where not, it is to have all from now on."""
    pairs, P = among.found.pairs, len(among.points.rest)
    for c in range(len(pairs.chosen)):
        if pairs.chosen[c] and not sweep.is_near[c % P]:
            sweep.is_near[:] = True
            return False
    return True


@jit_part
def note_near(among: Among, sweep: Sweep) -> None:
    """Notes the points that may need forces, or twice as fast: see `ContactSolver.within_reach`."""
    law, gaps, motion, P = among.law, among.found.gaps, among.found.motion, len(among.points.rest)
    fastest = 0.0
    for k in range(3 * P):
        fastest = max(fastest, 2 * abs(motion[FREE, k]) + abs(motion[VELOCITY, k]))
    w = max(largest_of(sweep.beside.w), largest_of(sweep.beside.before))
    reach = 2 * law.h * math.sqrt(3.0) * (fastest + 3 * w)
    for c in range(len(gaps)):
        if gaps[c] <= reach:
            sweep.is_near[c % P] = True


@jit_part
def set_operator(among: Among, sweep: Sweep, turn: Turn, inverse: Array, by_force: float) -> bool:
    """Sets W of the points that are near, by inverse slopes of r̂, or of ω̂ and r̂; by_force: how the origin moves."""
    points, W, P = among.points, among.W, len(among.points.rest)
    near, k = sweep.is_near.nonzero()[0], len(inverse)
    s, spins = len(near), k - len(points.rows)
    maps = np.empty((3 * s, k))
    for i in range(s):
        p = near[i]
        for j in range(spins):  # R* e_j × a
            axis = turn.middle[0][j], turn.middle[1][j], turn.middle[2][j]
            x, y, z = cross(axis, vector(sweep.arms[p], 0))
            maps[3 * i, j], maps[3 * i + 1, j], maps[3 * i + 2, j] = x, y, z
        for j in range(k - spins):
            x, y, z = rotated(turn.middle, vector(points.rows[j], 3 * p))
            maps[3 * i, spins + j], maps[3 * i + 1, spins + j], maps[3 * i + 2, spins + j] = x, y, z
    part = np.dot(np.dot(maps, inverse), maps.T)
    for i in range(s if len(points.R) else 0):
        for j in range(s):
            C = points.R[points.slots[near[i]]]
            _add_block(turn.middle, C, 3 * near[j], points.times[WHOLE], part, 3 * i, 3 * j)
    for i in range(3 * P):
        for j in range(3 * P):
            W[i, j] = 0.0
    for i in range(3 * s):
        for j in range(3 * s):
            there = by_force if i % 3 == j % 3 else 0.0
            W[3 * near[i // 3] + i % 3, 3 * near[j // 3] + j % 3] = (part[i, j] + part[j, i]) / 2 + there
    return True


@jit_part
def _add_block(R: Rotation, C: Array, to: int, whole: float, W: Array, i: int, j: int) -> None:
    """Adds R C Rᵀ/a of two points, one of which has the rows C (3, 3P)."""
    rows = rotated(R, vector(C[0], to)), rotated(R, vector(C[1], to)), rotated(R, vector(C[2], to))
    for k in range(3):
        x, y, z = rotated(R, (rows[0][k], rows[1][k], rows[2][k]))
        W[i, j + k] += x / whole
        W[i + 1, j + k] += y / whole
        W[i + 2, j + k] += z / whole


@jit_part
def has_ended(size: float, before: float, scale: float) -> bool:
    """Whether sweeps end with a change of this size, after one before."""
    if size <= ROUND_OFF * scale or (size < before and size * size <= TOLERANCE * scale * before):
        return True
    return size <= NO_PROGRESS * scale and size > before / 2 > 0


@jit_part
def act_on_points(among: Among, sweep: Sweep, contact: Found, turn: Turn) -> float:
    """Has the forces of pairs act on the points; their power on obstacles, W."""
    points, forces = among.points, among.found.forces
    power = add_up_forces(contact, sweep.beside.w, among.found)
    copy(forces, points.forces)
    see_forces(points, turn.R, turn.t)
    return power


@jit_part
def end_touched(among: Among, step: Step, contact: Found, by_obstacles: float) -> Touched:
    """Ends a step that was taken under forces with which points move by MOVED: what they yield, and what works did."""
    h, found, power = among.law.h, among.found, 0.0
    lost, stored = end_points(among.points, h, among.points.rows[:0])
    step = Step(step.status, step.square + stored, step.within, step.supplied, step.dissipated + lost)
    if contact.status == NOTHING:
        return Touched(step, contact, 0.0, 0.0, 0.0)
    for k in range(len(found.forces)):
        power += found.forces[k] * found.motion[MOVED, k]
    whole = power - by_obstacles
    normal = contact.normal_power if among.law.friction > 0 else whole
    return Touched(step, contact, h * by_obstacles, -h * normal, h * (normal - whole))


@jit_part
def keep_touched(
    table: Array, among: Among, touched: Touched, last: Last, taken: TouchedTaken, count: int, bent: Bending | None
) -> bool:
    """As `keep_step`; with what of contact the next step begins with."""
    points = among.points
    if not keep_step(table, touched.step, taken.moved, count, bent):
        if touched.step.status == TAKEN:
            copy(points.beyond_before, points.beyond)
        return False
    of_contact = taken.contact[count]
    of_contact[0], of_contact[1], of_contact[2] = touched.by_obstacles, touched.lost, touched.friction
    if len(points.R):
        copy(points.beyond[0], taken.carried[count])
    keep_found(among.begun, among.found, last.begun, last.found)
    touches, of_each, forces = touched.contact.status == FOUND, taken.by_obstacle[count], among.found.pairs.forces
    fill(of_each, 0.0)
    for c in range(len(forces) if touches and len(of_each) > 0 else 0):
        for k in range(3):
            of_each[c // len(points.rest), k] += forces[c, k]
    hand_on(among.law, among.begun, touches, among.found.pairs, among.begun)
    return True
