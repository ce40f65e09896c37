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
from fenics_rom.mechanics.compiled.coulomb import ACCURATE, SOLVED, add_pushes, look_among
from fenics_rom.mechanics.compiled.elimination import matrix_in, numbers_for, solve
from fenics_rom.mechanics.compiled.work_space import release, take, take_integers, take_rows, taken

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
def add_change(among: Among, friction: Array, yielding: Array, z: Array, v: Array, f: Array, space: Array) -> bool:
    """Adds to forces (C, 3) what velocities v (C, 3) ask for, as `Linearisation.change`; False where that is not known.

    Args:
        among: the pairs.
        friction, yielding: as of `look_among`.
        z: f - ρ u (C, 3), which says what pairs do.
        v: in the frames, m/s.
        f: in the frames, N.
        space: with room for 30 numbers of each pair, and 3 more.
    """
    (V, numbers), C, n, begun = among, len(f), 0, taken(space)
    owner, row, column = take_integers(space, 3 * C), take_rows(space, 3 * C, 3), take_rows(space, 3 * C, 3)
    right, slack, moved = take(space, 3 * C + 3), take(space, 3 * C), take(space, 3 * C)  # slack: on the diagonal
    fill(slack, 0.0)
    for c in range(C):
        length, cone = math.sqrt(z[c, 1] ** 2 + z[c, 2] ** 2), friction[c] * z[c, 0]
        if z[c, 0] <= 0:
            continue
        put(row[n], 1.0, 0.0, 0.0)
        put(column[n], 1.0, 0.0, 0.0)
        owner[n], right[n] = c, -v[c, 0]
        if length > cone:
            cos, sin = z[c, 1] / length, z[c, 2] / length
            put(column[n], 1.0, friction[c] * cos, friction[c] * sin)
            if cone > 0:
                n += 1
                put(row[n], 0.0, -sin, cos)
                put(column[n], 0.0, -sin, cos)
                owner[n], right[n], slack[n] = c, sin * v[c, 1] - cos * v[c, 2], (length / cone - 1) * yielding[c]
        else:
            for k in range(1, 3):
                n += 1
                put(row[n], 0.0, 2.0 - k, k - 1.0)
                put(column[n], 0.0, 2.0 - k, k - 1.0)
                owner[n], right[n] = c, -v[c, k]
        n += 1
    matrix = matrix_in(numbers, n)
    for j in range(n):
        fill(moved, 0.0)
        add_pushes(V, owner[j], column[j, 0], column[j, 1], column[j, 2], moved)
        for i in range(n):
            to = 3 * owner[i]
            matrix[i, j] = row[i, 0] * moved[to] + row[i, 1] * moved[to + 1] + row[i, 2] * moved[to + 2]
        matrix[j, j] += slack[j]
    is_known = solve(matrix, right, n)
    for j in range(n if is_known else 0):
        for k in range(3):
            f[owner[j], k] += right[j] * column[j, k]
    release(space, begun)
    return is_known


@jit_part
def find_by_steps(
    among: Among, q: Array, friction: Array, yielding: Array, f: Array, u: Array, error: float, space: Array
) -> tuple[int, bool]:
    """Forces of C pairs by Newton's method: how many steps it took, and whether they are found.

    Arguments as of `look_among`, which was asked of f (C, 3), and gave this error; f is changed only if they are found;
    space: with room for 36 numbers of each pair, and 3 more.
    """
    begun, C, speed, before = taken(space), len(f), largest_of(q), np.inf
    now, z, steps, is_found = take_rows(space, C, 3), take_rows(space, C, 3), 0, False
    copy(f, now)
    for count in range(MOST_STEPS + 1):
        steps = count
        if count > 0:
            error = look_among(among.V, q, friction, yielding, now, u)
        is_found = error <= ACCURATE * speed or (error <= SOLVED * speed and error >= before / 2)
        before = error
        for c in range(C):
            for k in range(3):
                z[c, k] = now[c, k] - u[c, k] / yielding[c]
        if is_found:
            for c in range(C):
                n, first, second = max(now[c, 0], 0.0), now[c, 1], now[c, 2]
                length, cone = math.sqrt(first * first + second * second), friction[c] * n
                share = cone / length if length > cone else 1.0
                f[c, 0], f[c, 1], f[c, 2] = n, share * first, share * second
            break
        fill(now, 0.0)  # all forces at once: a change would take a look at those that z is nearest to
        if not add_change(among, friction, yielding, z, q, now, space):
            break
    release(space, begun)
    return steps, is_found
