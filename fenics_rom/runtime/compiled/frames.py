"""What steps of linear bodies in moving frames share: `steppers.frame_kernel`, compiled.

Vectors in space are three numbers; functions of these are those that NumPy's classes call, too.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.mechanics import base_fit, frame_motion
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.frame_motion import Quaternion, Rotation, Vector
from fenics_rom.runtime.compiled.small_matrices import dot as sum_of_products
from fenics_rom.runtime.steppers import frame_table, inertia
from fenics_rom.runtime.steppers.inertia import Inertia

added, cross, dot, length, mean = map(
    jit_shared, (frame_motion.added, frame_motion.cross, frame_motion.dot, frame_motion.length, frame_motion.mean)
)
rotated, rotated_back, seen, turned_along = map(
    jit_shared, (frame_motion.rotated, frame_motion.rotated_back, frame_motion.seen, frame_motion.turned_along)
)
rotation_of, turned, misfit_of = map(jit_shared, (frame_motion.rotation_of, frame_motion.turned, base_fit.misfit_of))
is_definite, momenta_of, pairs = map(jit_shared, (inertia.is_definite, inertia.momenta_of, inertia.pairs))
solved_inertia, times_inertia = jit_shared(inertia.solved_inertia), jit_shared(inertia.times_inertia)
turn_of_top = jit_shared(inertia.turn_of_top)

TAKEN, OTHERWISE = 0, 1  # what came of a step: it was taken; that it is to be taken otherwise, and nothing is changed
MOMENTS, BENT, COUPLED = frame_table.MOMENTS.start, frame_table.BENT.start, frame_table.COUPLED.start
GIVEN, TURNED, BY_RATE = frame_table.GIVEN, frame_table.TURNED.start, frame_table.BENT_BY_RATE.start
TURNED_BY_RATE, ROWS = frame_table.TURNED_BY_RATE.start, frame_table.ROWS
# In `State.now`: as `steppers.frame_state.FrameState`, as `Shape`, then how the frame moves, in its axes.
POSITION, ROTATION, VELOCITY, TURNING, INERTIA, MOVED, MOMENT, DRIFT, MOTION = 0, 3, 7, 10, 13, 19, 22, 25, 28
NUMBERS = MOTION + 12
IS_SHAPE_KNOWN, WRENCH, REST = 0, 4, 10  # in `State.kept`: whether motion and table are those of the state
BENDING, FASTEST, AWAY, ASKEW, LOOKED_AT = 0, 1, 2, 3, 4  # in `Watch.notes`


class Body(NamedTuple):
    """A linear body of m modes in steps of h s; h/2 I2, G and 2/h + h/2 γ + D are its ten products."""

    h: float
    mass: float
    couples: bool  # whether a change of shape changes I or b
    is_definite: float  # |e|² up to which its kinetic energy is positive definite for sure
    size: float  # m
    ω: Array  # (m,), 1/s
    inverse_ω: Array  # (m,), s
    D: Array  # (m, m)
    products: Array  # (10, m m)
    by_rate: Array  # (m, 10 m) what each part of a rate makes of them
    by_shape: Array  # (m, 9 m) the same of I2 and G
    inverse: Array  # of the last of the products (m, m)
    table: Array  # at rest (ROWS, m), see `steppers.frame_table`
    rigid: Array  # (9,) I0 and x̄


class Loads(NamedTuple):
    """What p inputs do, see `steppers.frame_loads`."""

    push: Array  # (p, m + 9) on the coordinates, as a whole, torque, and acceleration
    by_shape: Array  # (p, 3 m) torque that the shape adds; (0, 0) where nothing
    columns: Array  # (3 n,) those of forces on points
    rest: Array  # (n, 3) these
    rows: Array  # (m, 3 n)


class Acting(NamedTuple):
    """What acts in one step: `steppers.frame_loads.FrameForces`."""

    modal: Array
    force: Vector
    torque: Vector
    acceleration: Vector
    by_shape: Array  # (3, m), or (0, m)
    at_points: Array  # (n, 3)


class Push(NamedTuple):
    """What contact forces do: `mechanics.frame_geometry.Push`, but for the coordinates."""

    force: Vector  # all together, in world axes, N
    torque: Vector  # about the frame's origin, in world axes, N m
    turning: Vector  # R*ᵀ of it


NOT_PUSHED = Push((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Watch(NamedTuple):
    """What the model does not follow: `steppers.frame_watch`."""

    farthest: float
    limit: float  # m
    rows: Array  # (3 V, m)
    # How far it bent, m, turned, rad/s, and its base went otherwise than its twists say; then how far it was bent
    # where it was last looked at, m, and e there: (5 + m,).
    notes: Array


class State(NamedTuple):
    """What a step changes."""

    halves: Array  # e and r, (2, m)
    halves_before: Array  # the same before the step
    now: Array  # (2, 40) numbers of place, shape and motion; then those before the step
    table: Array  # (ROWS, m); of the shape that the body has
    kept: Array  # of the steps before, from which the next one begins; and the wrench of a base
    slopes: Array  # inverse slopes of a free body (3 + m, 3 + m); of a carried one A, then A⁻¹, (2 m, m)


class Step(NamedTuple):
    """What a step did."""

    status: int
    square: float  # twice the stored energy, J
    within: float  # what of this is in the shape and its rate, J
    supplied: float  # J
    dissipated: float  # J


class Taken(NamedTuple):
    """Of steps in a row, one row each."""

    works: Array  # (n, 2), J: supplied and dissipated
    q: Array  # (n, m) after it
    poses: Array  # (n, 7) after it, position and quaternion
    noted: Array  # (n, 11) of a body that deforms largely, see `bent_frame.note_shape`; else (n, 0)


@jit_part
def combine(factors: Array, rows: Array, total: Array) -> None:
    """Sets total (k,) to the sum of rows (n, k) by factors (n,)."""
    n, whole = len(factors), len(factors) // 4 * 4
    total[:] = 0.0
    for i in range(0, whole, 4):  # four at once, so that sums are loaded and stored less often
        a, b, c, d = factors[i], factors[i + 1], factors[i + 2], factors[i + 3]
        first, second, third, fourth = rows[i], rows[i + 1], rows[i + 2], rows[i + 3]
        for k in range(len(total)):
            total[k] += a * first[k] + b * second[k] + c * third[k] + d * fourth[k]
    for i in range(whole, n):
        factor, row = factors[i], rows[i]
        for k in range(len(total)):
            total[k] += factor * row[k]


@jit_part
def vector(numbers: Array, first: int) -> Vector:
    """Three of many numbers."""
    return numbers[first], numbers[first + 1], numbers[first + 2]


@jit_part
def rotation_in(numbers: Array) -> Quaternion:
    """The quaternion of a frame."""
    return numbers[3], numbers[4], numbers[5], numbers[6]


@jit_part
def put(numbers: Array, first: int, a: Vector) -> None:
    """Sets three of many numbers."""
    numbers[first], numbers[first + 1], numbers[first + 2] = a


@jit_part
def middle_of(R: Rotation, t: Vector) -> Rotation:
    """R* = R (1 + t~/2)."""
    a, b, c = R
    half = (-t[0] / 2, -t[1] / 2, -t[2] / 2)  # rows of R t~/2 are those of R, turned back
    return added(a, 1.0, cross(half, a)), added(b, 1.0, cross(half, b)), added(c, 1.0, cross(half, c))


@jit_part
def inertia_in(now: Array) -> Inertia:
    """The six entries of I."""
    return now[13], now[14], now[15], now[16], now[17], now[18]


@jit_part
def shape_at(body: Body, q: Array, r: Array, table: Array, now: Array) -> None:
    """Sets the inertia at q, moving with r, and the rows of the table that are of q."""
    m = len(q)
    if body.couples:
        shaped, unshaped = table[BENT:GIVEN].reshape(9 * m), body.table[BENT:GIVEN].reshape(9 * m)
        combine(q, body.by_shape, shaped)
        for k in range(9 * m):
            shaped[k] += unshaped[k]
    for k in range(6):
        now[INERTIA + k] = body.rigid[k] + sum_of_products(table[k], q) + sum_of_products(table[BENT + k], q)
    for k in range(3):
        now[MOVED + k] = sum_of_products(table[COUPLED + k], r)
        now[MOMENT + k] = body.rigid[6 + k] + sum_of_products(table[MOMENTS + k], q)
        now[DRIFT + k] = sum_of_products(table[MOMENTS + k], r)


@jit_part
def give(body: Body, modal: Array, e: Array, r: Array, table: Array) -> None:
    """Sets the rows of the table that do not change within a step, under forces (m,) on the coordinates."""
    for i in range(len(e)):
        table[GIVEN, i] = body.ω[i] * e[i] - 2 / body.h * r[i] - modal[i]
    _turn_by_rate(body, r, table)


@jit_part
def give_without_springs(body: Body, modal: Array, pull: Array, r: Array, table: Array) -> None:
    """The same where a pull (m,) is what resists the shape."""
    for i in range(len(r)):
        table[GIVEN, i] = pull[i] - 2 / body.h * r[i] - modal[i]
    _turn_by_rate(body, r, table)


@jit_part
def _turn_by_rate(body: Body, r: Array, table: Array) -> None:
    """Sets the rows T at r (m,)."""
    if body.couples:
        m = len(r)
        turned_, coupled = table[TURNED:BY_RATE].reshape(3 * m), table[COUPLED:GIVEN].reshape(3 * m)
        turned_[:] = 0.0
        for i in range(m):
            half, row = body.h / 2 * r[i], body.by_shape[i, 6 * m :]
            for k in range(3 * m):
                turned_[k] += half * row[k]
        for k in range(3 * m):
            turned_[k] += coupled[k]


@jit_part
def act(loads: Loads, u: Array, m: int) -> Acting:
    """What inputs u (p,) do."""
    pushed, by_shape = np.empty(m + 9), np.zeros((3 if len(loads.by_shape) else 0, m))
    combine(u, loads.push, pushed)
    if len(by_shape):
        combine(u, loads.by_shape, by_shape.reshape(3 * m))
    at_points = np.empty((len(loads.rest), 3))
    for k in range(len(loads.columns)):
        at_points[k // 3, k % 3] = u[loads.columns[k]]
    parts = vector(pushed, m), vector(pushed, m + 3), vector(pushed, m + 6)
    return Acting(pushed[:m], parts[0], parts[1], parts[2], by_shape, at_points)


@jit_part
def torque_of(acting: Acting, q: Array, h: float, rate: Array) -> Vector:
    """That of forces that turn with the frame, in a step of h s from q at a mid-step rate (m,)."""
    x, y, z = acting.torque
    if len(acting.by_shape):
        for i in range(len(q)):
            there = q[i] + h / 2 * rate[i]
            x += acting.by_shape[0, i] * there
            y += acting.by_shape[1, i] * there
            z += acting.by_shape[2, i] * there
    return x, y, z


@jit_part
def push_points(
    loads: Loads, forces: Array, R: Rotation, end: Rotation, t: Vector, q: Array, h: float, rate: Array, modal: Array
) -> tuple[Vector, Vector, Vector]:
    """Force, torque and R*ᵀ torque of forces (n, 3) on points, in world axes; sets theirs on the coordinates, (m,)."""
    force = torque = (0.0, 0.0, 0.0)
    width = loads.rows.shape[1]
    start, moved, inside = np.empty(width), np.empty(width), np.empty(width)
    combine(q, loads.rows, start)
    combine(rate, loads.rows, moved)
    for n in range(len(forces)):
        f = vector(forces[n], 0)
        y = added(vector(loads.rest[n], 0), 1.0, vector(start, 3 * n))
        arm = mean(rotated(R, y), rotated(end, added(y, h, vector(moved, 3 * n))))
        force, torque = added(force, 1.0, f), added(torque, 1.0, cross(arm, f))
        put(inside, 3 * n, seen(R, t, f))
    copy(np.dot(loads.rows, inside), modal)
    return force, torque, seen(R, t, torque)


@jit_part
def look(watch: Watch, e: Array, square: float, speed: float) -> None:
    """Notes how far a state e (m,) is bent, if it is too far, and how fast it turns, rad/s."""
    notes = watch.notes
    notes[FASTEST] = max(notes[FASTEST], speed)
    most = max(watch.limit, notes[BENDING])
    if not watch.farthest * square > most**2:
        return
    change = e - notes[LOOKED_AT + 1 :]
    if notes[LOOKED_AT] + (watch.farthest * change.dot(change)) ** 0.5 > most:
        moved, largest = np.dot(watch.rows, e), 0.0
        for n in range(len(moved) // 3):
            largest = max(largest, moved[3 * n] ** 2 + moved[3 * n + 1] ** 2 + moved[3 * n + 2] ** 2)
        notes[LOOKED_AT] = largest**0.5
        copy(e, notes[LOOKED_AT + 1 :])
        notes[BENDING] = max(notes[BENDING], largest**0.5)


@jit_part
def remember(state: State) -> None:
    """Notes what is there before a step."""
    copy(state.halves, state.halves_before)
    copy(state.now[:1], state.now[1:])


@jit_part
def restore(state: State) -> None:
    """Puts the body where it was before the last step."""
    copy(state.halves_before, state.halves)
    copy(state.now[1:], state.now[:1])
    state.kept[:WRENCH] = 0.0


@jit_part
def note(body: Body, state: State, step: Step, taken: Taken, count: int) -> None:
    """Writes a step into its row."""
    taken.works[count, 0], taken.works[count, 1] = step.supplied, step.dissipated
    for i in range(len(body.ω)):
        taken.q[count, i] = state.halves[0, i] * body.inverse_ω[i]
    for k in range(VELOCITY):
        taken.poses[count, k] = state.now[0, k]
