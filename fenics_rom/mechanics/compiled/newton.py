"""Forces of pairs under Coulomb's law by Newton's method in velocities, where an inverse of W is kept.

Forces are f = W⁻¹ (u - q). What z = f - ρ u of a pair tells, as in `complementarity.frictional`, leaves few velocities
unknown, in its frame [n, t1, t2]:

    z_n <= 0:           open,   f = 0                              three
    |z_t| <= μ z_n:     sticks, u = 0                              none
    else:               slips,  u_n = 0,  f_t = μ z_n z_t/|z_t|    two

Of the last one Newton's method has (I - B) f_t - μ d f_n + ρ B u_t = 0, with the direction d of z_t and
B = μ z_n/|z_t| (I - d dᵀ). It begins with the forces of the step before, or as if all pairs stuck: with what is nearer
to the law. Two to five solves follow.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill, largest_of
from fenics_rom.mechanics.compiled.coulomb import ACCURATE, SOLVED, add_motion, in_space, look_at, sum_of
from fenics_rom.mechanics.compiled.elimination import matrix_in, numbers_for, solve
from fenics_rom.mechanics.compiled.work_space import release, take, take_frames, take_integers, take_rows, taken
from fenics_rom.mechanics.frame_motion import Vector

OPEN, SLIPS, STICKS, NO_PAIR = range(4)
MOST_SEARCHES = 6  # where W is not quite what the inverse is of
MOST_SOLVES = 12  # where they suffice they are rarely more than six
SURE_SOLVES = 5  # before all is given up at the first one that does not halve what is missed


class Inverse(NamedTuple):
    """W⁻¹ as `whole` - `left`ᵀ `right`, N s/m; where it is not symmetric, its transpose."""

    whole: Array  # (3P, 3P); (0, 0) where it is not known
    left: Array  # (k, 3P)
    right: Array  # (k, 3P)


@jit_part
def in_one_piece(inverse: Array) -> Inverse:
    """W⁻¹ (3P, 3P), or (0, 0) where it is not known."""
    return Inverse(inverse, inverse[:0], inverse[:0])


@jit_part
def find_by_newton(
    inverse: Inverse,
    points: Array,
    axes: Array,
    q: Array,
    friction: Array,
    yielding: Array,
    f: Array,
    u: Array,
    missed: float,
    space: Array,
) -> tuple[int, bool]:
    """Forces of C pairs: how many solves they took, and whether they are found.

    Args:
        inverse: W⁻¹ of P points.
        points: (C,) that of each pair, all different; those of none are open.
        axes: (C, 3, 3) frames, rows n, t1 and t2.
        q: (C, 3) free velocities less targets, in these, m/s.
        friction: μ (C,).
        yielding: (C,) 1/ρ of each pair, m/s/N.
        f: (C, 3) in the frames, to begin with; set if they are found.
        u: (C, 3) W f + q; set if they are found.
        missed: how far these are from the law, m/s.
        space: with room for 35 numbers of each point and 3 more; not given back.
    """
    P, C, speed = len(inverse.whole) // 3, len(points), largest_of(q)
    kinds, frames, ρ, μ = take_integers(space, P), take_frames(space, P), take(space, P), take(space, P)
    v, z, as_if_stuck = take_rows(space, P, 3), take_rows(space, P, 3), take_rows(space, P, 3)
    stuck, forces, right = take_rows(space, P, 3), take_rows(space, P, 3), take(space, 3 * P + 3)
    places, begins, moved = take_integers(space, P), take_integers(space, P), take(space, 3 * P)
    for p in range(P):
        kinds[p], ρ[p], μ[p] = NO_PAIR, 1.0, 0.0
        for a in range(3):
            v[p, a] = z[p, a] = 0.0
            for b in range(3):
                frames[p, a, b] = 1.0 if a == b else 0.0
    for c in range(C):
        p = points[c]
        kinds[p], ρ[p], μ[p] = OPEN, 1 / yielding[c], friction[c]
        copy(axes[c], frames[p])
        for k in range(3):
            v[p, k] = -q[c, k]
            z[p, k] = f[c, k] - ρ[p] * u[c, k]
    _answer(inverse, frames, v, stuck, moved)  # the forces that all need to stick
    fill(v, 0.0)
    if _look(kinds, ρ, μ, stuck, v, as_if_stuck) < missed:
        copy(as_if_stuck, z)
    numbers, before = numbers_for(3 * P), np.inf
    for count in range(1, MOST_SOLVES + 1):
        moving, n = 0, 0  # points with unknown velocities, and how many these are
        for p in range(P):
            if kinds[p] != NO_PAIR:
                length, cone = math.sqrt(z[p, 1] ** 2 + z[p, 2] ** 2), μ[p] * z[p, 0]
                kinds[p] = OPEN if z[p, 0] <= 0 else SLIPS if length > cone else STICKS
            if kinds[p] != STICKS:
                places[moving], begins[moving] = p, n
                moving, n = moving + 1, n + (2 if kinds[p] == SLIPS else 3)
        places_now, begins_now = places[:moving], begins[:moving]
        matrix = matrix_in(numbers, n)
        _set_up(inverse, frames, stuck, kinds, ρ, μ, z, places_now, begins_now, matrix, right)
        if not solve(matrix, right, n):
            return count, False
        fill(v, 0.0)
        for i in range(moving):
            p, k = places[i], begins[i]
            if kinds[p] == SLIPS:
                v[p, 1], v[p, 2] = right[k], right[k + 1]
            else:
                for a in range(3):
                    v[p, a] = (
                        frames[p, a, 0] * right[k] + frames[p, a, 1] * right[k + 1] + frames[p, a, 2] * right[k + 2]
                    )
        _answer(inverse, frames, v, forces, moved)
        for p in range(P):
            is_open = kinds[p] == OPEN or kinds[p] == NO_PAIR
            for a in range(3):
                forces[p, a] = 0.0 if is_open else forces[p, a] + stuck[p, a]
        missed = _look(kinds, ρ, μ, forces, v, z)
        if missed <= ACCURATE * speed or (missed <= SOLVED * speed and missed >= before / 2):
            break
        if count > SURE_SOLVES and not missed < before / 2:
            return count, False
        before = missed
    if not missed <= SOLVED * speed:
        return count, False
    for c in range(C):
        p = points[c]
        f[c, 0], cone = max(forces[p, 0], 0.0), friction[c] * max(forces[p, 0], 0.0)
        length = math.sqrt(forces[p, 1] ** 2 + forces[p, 2] ** 2)
        share = cone / length if length > cone else 1.0
        f[c, 1], f[c, 2] = share * forces[p, 1], share * forces[p, 2]
        for k in range(3):
            u[c, k] = v[p, k]
    return count, True


@jit_part
def find_with_operator(
    inverse: Inverse,
    W: Array,
    points: Array,
    axes: Array,
    q: Array,
    friction: Array,
    compliance: float,
    yielding: Array,
    f: Array,
    u: Array,
    moved: Array,
    missed: float,
    space: Array,
) -> tuple[int, bool, float]:
    """Forces by Newton's method: how many solves, whether it found some, and how far these are from the law, m/s.

    The inverse may be that of a matrix that is only nearly W, as where W is not symmetric. Then what W f is beyond that
    is among the free velocities of a further search, which takes a solve. Arguments as of `look_at`; missed: before;
    space: with room for 35 numbers of each point, 3 of each pair and 3 more.
    """
    begun, shifted = taken(space), take_rows(space, len(q), 3)
    solves, before, error, enough = 0, np.inf, missed, SOLVED * largest_of(q)
    copy(q, shifted)
    for _ in range(MOST_SEARCHES):
        within = taken(space)
        count, is_found = find_by_newton(inverse, points, axes, shifted, friction, yielding, f, u, error, space)
        release(space, within)
        solves += count
        for c in range(len(q)):
            for k in range(3):
                shifted[c, k] -= u[c, k]
        error = look_at(W, points, axes, q, friction, compliance, yielding, f, u, moved)
        if not is_found or error <= enough or not error < before / 2:
            break
        before = error
        for c in range(len(q)):
            for k in range(3):
                shifted[c, k] += u[c, k]
    release(space, begun)
    return solves, is_found, error


@jit_part
def _answer(inverse: Inverse, frames: Array, x: Array, y: Array, moved: Array) -> None:
    """Sets y (P, 3) to the forces that velocities x (P, 3) ask for, both in frames.

    moved: (3P,) to work in, as y is.
    """
    operator, along = inverse.whole, flat(y)
    fill(moved, 0.0)
    for p in range(len(x)):
        y[p, 0], y[p, 1], y[p, 2] = in_space(frames[p], x[p, 0], x[p, 1], x[p, 2])
    if len(inverse.left):
        shares = np.dot(inverse.left, along)
        for a in range(len(shares)):
            add_row(inverse.right[a], -shares[a], moved)
    for p in range(len(x)):
        if x[p, 0] != 0.0 or x[p, 1] != 0.0 or x[p, 2] != 0.0:
            add_motion(operator, p, y[p, 0], y[p, 1], y[p, 2], moved)
    for p in range(len(x)):
        frame, vx, vy, vz = frames[p], moved[3 * p], moved[3 * p + 1], moved[3 * p + 2]
        for k in range(3):
            y[p, k] = frame[k, 0] * vx + frame[k, 1] * vy + frame[k, 2] * vz


@jit_part
def _look(kinds: Array, ρ: Array, μ: Array, forces: Array, v: Array, z: Array) -> float:
    """Sets z (P, 3), N, of forces and velocities; how far the pairs are from the law, m/s."""
    worst = 0.0
    for p in range(len(z)):
        if kinds[p] == NO_PAIR:
            continue
        for k in range(3):
            z[p, k] = forces[p, k] - ρ[p] * v[p, k]
        n, first, second = max(z[p, 0], 0.0), z[p, 1], z[p, 2]
        length = math.sqrt(first * first + second * second)
        if length > μ[p] * n:
            first, second = first * (μ[p] * n / length), second * (μ[p] * n / length)
        off = max(abs(forces[p, 0] - n), abs(forces[p, 1] - first), abs(forces[p, 2] - second))
        worst = max(worst, off / ρ[p])
    return worst


@jit_part
def _between(inverse: Inverse, p: int, q: int) -> tuple[Vector, Vector, Vector]:
    """The rows of the block (3, 3) of W⁻¹ between two points, along the axes of space."""
    whole, less, right, x, y, z = inverse.whole, inverse.left, inverse.right, 3 * q, 3 * q + 1, 3 * q + 2
    a, b, c = 3 * p, 3 * p + 1, 3 * p + 2
    ax, bx, cx = whole[x, a], whole[x, b], whole[x, c]
    ay, by, cy = whole[y, a], whole[y, b], whole[y, c]
    az, bz, cz = whole[z, a], whole[z, b], whole[z, c]
    for i in range(len(less)):
        by_a, by_b, by_c, to_x, to_y, to_z = right[i, a], right[i, b], right[i, c], less[i, x], less[i, y], less[i, z]
        ax, ay, az = ax - by_a * to_x, ay - by_a * to_y, az - by_a * to_z
        bx, by, bz = bx - by_b * to_x, by - by_b * to_y, bz - by_b * to_z
        cx, cy, cz = cx - by_c * to_x, cy - by_c * to_y, cz - by_c * to_z
    return (ax, ay, az), (bx, by, bz), (cx, cy, cz)


@jit_part
def _put(row: Vector, frame: Array, slips: bool, to: Array, m: int) -> None:
    """Sets what a row has of the velocity of a point, from m on: of one that slips along its tangents."""
    x, y, z = row
    if slips:
        to[m] = x * frame[1, 0] + y * frame[1, 1] + z * frame[1, 2]
        to[m + 1] = x * frame[2, 0] + y * frame[2, 1] + z * frame[2, 2]
    else:
        to[m], to[m + 1], to[m + 2] = x, y, z


@jit_part
def _set_up(
    inverse: Inverse,
    frames: Array,
    stuck: Array,
    kinds: Array,
    ρ: Array,
    μ: Array,
    z: Array,
    places: Array,
    begins: Array,
    matrix: Array,
    right: Array,
) -> None:
    """Sets the linear equations for the velocities of points at places, which begin there among the unknowns.

    Those of a point that slips are along its tangents, others along the axes of space.
    """
    for i in range(len(places)):
        p, k = places[i], begins[i]
        frame, (n, x, y) = frames[p], stuck[p]
        if kinds[p] != SLIPS:
            right[k], right[k + 1], right[k + 2] = in_space(frame, -n, -x, -y)
            for j in range(len(places)):
                q, m, rows = places[j], begins[j], _between(inverse, p, places[j])
                _put(rows[0], frames[q], kinds[q] == SLIPS, matrix[k], m)
                _put(rows[1], frames[q], kinds[q] == SLIPS, matrix[k + 1], m)
                _put(rows[2], frames[q], kinds[q] == SLIPS, matrix[k + 2], m)
            continue
        length = math.sqrt(z[p, 1] ** 2 + z[p, 2] ** 2)
        first, second, share = z[p, 1] / length, z[p, 2] / length, μ[p] * z[p, 0] / length
        B11, B12, B22 = share * second * second, -share * first * second, share * first * first
        C11, C22, n1, n2 = 1 - B11, 1 - B22, μ[p] * first, μ[p] * second
        one, other = in_space(frame, -n1, C11, -B12), in_space(frame, -n2, -B12, C22)
        for j in range(len(places)):
            q, m, rows = places[j], begins[j], _between(inverse, p, places[j])
            _put(sum_of(one, rows), frames[q], kinds[q] == SLIPS, matrix[k], m)
            _put(sum_of(other, rows), frames[q], kinds[q] == SLIPS, matrix[k + 1], m)
        right[k], right[k + 1] = n1 * n - C11 * x + B12 * y, n2 * n - C22 * y + B12 * x
        matrix[k, k] += ρ[p] * B11
        matrix[k, k + 1] += ρ[p] * B12
        matrix[k + 1, k] += ρ[p] * B12
        matrix[k + 1, k + 1] += ρ[p] * B22
