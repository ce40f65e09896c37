"""Coulomb's law of many pairs linearised, by forces: `complementarity.linearised`, compiled.

Where few points take part, or W⁻¹ is not known, Newton's method goes by it to forces that sweeps come near to too
slowly; and what forces change by, where all pairs do what they do, follows from it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import copy, fill, largest_of, put
from fenics_rom.mechanics.compiled.coulomb import ACCURATE, SOLVED, look_among, sum_of
from fenics_rom.mechanics.compiled.elimination import matrix_in, numbers_for, solve
from fenics_rom.mechanics.compiled.work_space import release, take, take_integers, take_rows, taken
from fenics_rom.mechanics.frame_motion import Vector

MOST_STEPS = 8  # of Newton's method: where they suffice they are rarely more than four


class Among(NamedTuple):
    """The pairs' own operator, and room for equations of them."""

    V: Array  # (3C, 3C), of `coulomb.operator_among`
    numbers: Array  # of `elimination.numbers_for`


@jit_part
def room_among(C: int) -> Among:
    """For C pairs."""
    return Among(np.empty((3 * C, 3 * C)), numbers_for(3 * C))


@jit_part
def find_change(
    among: Among, friction: Array, yielding: Array, f: Array, u: Array, v: Array, change: Array, space: Array
) -> bool:
    """Sets forces (C, 3) that velocities v (C, 3) ask for, as `Linearisation.change`; False where they are not known.

    Args:
        among: the pairs.
        friction, yielding, f, u: as of `look_among`; f - ρ u says what pairs do.
        v: in the frames, m/s.
        change: in the frames, N; may be f.
        space: with room for 9 numbers of each pair, and 3 more.
    """
    (V, numbers), C, K, n, begun = among, len(f), 0, 0, taken(space)
    owner, begins, directions = take_integers(space, C), take_integers(space, C), take_rows(space, C, 3)
    right, last = take(space, 3 * C + 3), take_integers(space, C)  # of each closed pair: its last unknown
    for c in range(C):
        ρ = 1 / yielding[c]
        λ = f[c, 0] - ρ * u[c, 0]
        if λ <= 0:
            continue
        x, y, cone = f[c, 1] - ρ * u[c, 1], f[c, 2] - ρ * u[c, 2], friction[c] * λ
        length = math.sqrt(x * x + y * y)
        owner[K], begins[K], right[n] = c, n, -v[c, 0]
        if length > cone:  # it slips, across its direction where there is friction
            cos, sin = x / length, y / length
            put(directions[K], cos, sin, (length / cone - 1) * yielding[c] if cone > 0 else 0.0)
            last[K] = n + 1 if cone > 0 else n
            right[n + 1] = sin * v[c, 1] - cos * v[c, 2]
        else:
            last[K], right[n + 1], right[n + 2] = n + 2, -v[c, 1], -v[c, 2]
        n, K = last[K] + 1, K + 1
    matrix = matrix_in(numbers, n)
    for j in range(K):
        c, m, size, (cos, sin, slack) = owner[j], begins[j], last[j] - begins[j], directions[j]
        one, two, three, μ = V[3 * c], V[3 * c + 1], V[3 * c + 2], friction[c]
        for i in range(K):
            x, y, z = 3 * owner[i], 3 * owner[i] + 1, 3 * owner[i] + 2
            of = (one[x], one[y], one[z]), (two[x], two[y], two[z]), (three[x], three[y], three[z])
            at = begins[i], last[i], directions[i, 0], directions[i, 1]
            if size == 2:
                _put(matrix, at, m, of[0])
                _put(matrix, at, m + 1, of[1])
                _put(matrix, at, m + 2, of[2])
                continue
            _put(matrix, at, m, sum_of((1.0, μ * cos, μ * sin), of))
            if size == 1:
                _put(matrix, at, m + 1, sum_of((0.0, -sin, cos), of))
        if size == 1:
            matrix[m + 1, m + 1] += slack
    is_known = solve(matrix, right, n)
    if is_known:
        fill(change, 0.0)
        for j in range(K):
            c, m, size, (cos, sin, _) = owner[j], begins[j], last[j] - begins[j], directions[j]
            if size == 2:
                put(change[c], right[m], right[m + 1], right[m + 2])
                continue
            across, along = right[m + 1] if size == 1 else 0.0, friction[c] * right[m]
            put(change[c], right[m], cos * along - sin * across, sin * along + cos * across)
    release(space, begun)
    return is_known


@jit_part
def _put(matrix: Array, at: tuple[int, int, float, float], m: int, moved: Vector) -> None:
    """Sets a column of the equations of a pair, from a first to a last one, to what moves it, in its frame.

    at: these two, and the direction in which the pair slips.
    """
    k, last, cos, sin = at
    matrix[k, m] = moved[0]
    if last == k + 1:
        matrix[k + 1, m] = cos * moved[2] - sin * moved[1]
    elif last == k + 2:
        matrix[k + 1, m], matrix[k + 2, m] = moved[1], moved[2]


@jit_part
def find_by_steps(
    among: Among, q: Array, friction: Array, yielding: Array, f: Array, u: Array, error: float, space: Array
) -> tuple[int, bool]:
    """Forces of C pairs by Newton's method: how many steps it took, and whether they are found.

    Arguments as of `look_among`, which was asked of f (C, 3), and gave this error; f is changed only if they are found;
    space: with room for 12 numbers of each pair, and 3 more.
    """
    begun, C, speed, before = taken(space), len(f), largest_of(q), np.inf
    now, steps, is_found = take_rows(space, C, 3), 0, False
    copy(f, now)
    for count in range(MOST_STEPS + 1):
        steps = count
        if count > 0:
            error = look_among(among.V, q, friction, yielding, now, u)
        is_found = error <= ACCURATE * speed or (error <= SOLVED * speed and error >= before / 2)
        before = error
        if is_found:
            for c in range(C):
                n, first, second = max(now[c, 0], 0.0), now[c, 1], now[c, 2]
                length, cone = math.sqrt(first * first + second * second), friction[c] * n
                share = cone / length if length > cone else 1.0
                f[c, 0], f[c, 1], f[c, 2] = n, share * first, share * second
            break
        # all forces at once: a change would take a look at those that z is nearest to
        if not find_change(among, friction, yielding, now, u, q, now, space):
            break
    release(space, begun)
    return steps, is_found
