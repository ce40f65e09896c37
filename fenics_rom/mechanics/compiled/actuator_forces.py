"""Forces of actuators that a step finds, by strokes and at guides, compiled: `mechanics.actuator_forces`.

A step goes through the same rounds, in each of which it looks for contact by itself.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.mechanics.actuator_forces import (
    AT_A_BOUND,
    LARGEST_MISS,
    MAX_ROUNDS,
    PIVOTED,
    ROUND_OFF,
    SETTLED,
    TOGETHER,
    TOLERANCE,
)
from fenics_rom.mechanics.compiled.copying import are_equal, copy, fill
from fenics_rom.mechanics.compiled.elimination import matrix_in, solve
from fenics_rom.mechanics.compiled.gas import are_pressures, begin_gas
from fenics_rom.mechanics.compiled.searched_forces import (
    ARE_FOUND,
    BY_PIVOTS,
    GOES_ON,
    NONE_FOUND,
    ROUNDS,
    Actuators,
    Search,
)
from fenics_rom.mechanics.complementarity import pivoting

solve_by_pivots = jit_shared(pivoting.solve_by_pivots)


@jit_part
def begin_search(given: Actuators, bends: Array, W: Array, u: Array, before: Array, h: float, search: Search) -> bool:
    """Begins with what guides did under forces before (n,), as `ActuatorForces.solve`; whether gas is what it may be.

    Args:
        given: what forces are of.
        bends: μα at guides (n,).
        W: (n, n) rates by forces.
        u: the input (p,).
        before: as above.
        h: step, s.
        search: with targets and rates, and of gas strokes at the start.
    """
    copy(W, search.W)
    for k in range(len(before)):
        search.diagonal[k] = W[k, k]
    copy(before, search.before)
    copy(search.targets, search.aims)
    fill(search.added, 0.0)
    if not begin_gas(given, u, h, search):
        return False
    _begin_rounds(given, bends, u, search)
    return True


@jit_part
def _begin_rounds(given: Actuators, bends: Array, u: Array, search: Search) -> None:
    """With forces before, and targets and rates by forces of which gas has its own."""
    W, before = search.W, search.before
    n, largest, are_known = len(before), 0.0, False
    first = n - len(given.guides)
    for k in range(n):
        largest, are_known = max(largest, W[k, k]), are_known or before[k] != 0.0
    _set_bounds(given, bends, u, before, search)
    fill(search.beyond, 0.0)
    fill(search.sides, 0.0)
    for k in range(first, n):
        idle = W[k, k] <= ROUND_OFF * largest
        if idle or not are_known or before[k] <= AT_A_BOUND * search.lower[k]:
            search.sides[k] = -1.0
        elif before[k] >= AT_A_BOUND * search.upper[k]:
            search.sides[k] = 1.0
    search.numbers[BY_PIVOTS] = search.numbers[ROUNDS] = 0.0
    copy(search.sides, search.tried)
    copy(search.beyond, search.kept)
    _hold_within(given, search)


@jit_part
def _hold_within(given: Actuators, search: Search) -> None:
    """Has those hold that are within their bounds; no guides, while pivots find where these are."""
    first = len(search.sides) - len(given.guides)
    for k in range(len(search.sides)):
        search.holds[k] = 1.0 if search.sides[k] == 0.0 and not (search.numbers[BY_PIVOTS] and k >= first) else 0.0


@jit_part
def _set_bounds(given: Actuators, bends: Array, u: Array, z: Array, search: Search) -> None:
    """Sets the least and the most that forces can be, with the tensions that z (n,) leads to."""
    for k in range(len(z)):
        search.lower[k], search.upper[k] = 0.0 if given.pulls[k] else -math.inf, math.inf
    pulled = change = 0.0
    for i in range(len(given.guides)):
        k, stroke, column = given.guides[i, 0], given.guides[i, 1], given.guides[i, 2]
        if i == 0 or column != given.guides[i - 1, 2]:
            pulled, change = max(u[column] if stroke < 0 else z[stroke], 0.0), 0.0
        tension = max(pulled + change, 0.0)
        search.lower[k], search.upper[k] = tension * math.expm1(-bends[k]), tension * math.expm1(bends[k])
        change += z[k]


@jit_part
def hold(search: Search) -> bool:
    """Sets the forces that contact is to be found with: those with which what is held goes as it is to.

    Whether there are some.
    """
    n, z, holds, W = len(search.z), search.z, search.holds, search.W
    A, x = matrix_in(search.matrix, n), search.solved
    for k in range(n):
        z[k] = 0.0 if holds[k] else search.beyond[k]
    for k in range(n):
        x[k] = search.aims[k] - search.rates[k]
        for j in range(n):
            x[k] -= W[k, j] * z[j]
            A[k, j] = W[k, j]
        if not holds[k]:
            x[k] = 0.0
        for j in range(n):
            if not (holds[k] and holds[j]):
                A[k, j] = 1.0 if k == j else 0.0
    if not solve(A, x, n):
        return False
    for k in range(n):
        z[k] += x[k]
    return True


@jit_part
def _chain(given: Actuators, bends: Array, u: Array, sides: Array, unknown: Array, search: Search) -> None:
    """Sets what forces follow from some that are unknown (n,), where guides slide to their sides (n,)."""
    follows, tensions, n = search.follows, search.tensions, len(sides)
    fill(follows, 0.0)
    fill(tensions, 0.0)
    for k in range(n):
        follows[k, k] = unknown[k]
    for i in range(len(given.guides)):
        k, stroke, column = given.guides[i, 0], given.guides[i, 1], given.guides[i, 2]
        last, tension = given.guides[i - 1, 0], tensions[k]
        if i == 0 or column != given.guides[i - 1, 2]:
            if stroke < 0:
                tension[n] = max(u[column], 0.0)
            else:
                tension[stroke] = unknown[stroke]
        else:
            for j in range(n + 1):
                tension[j] = tensions[last, j] + follows[last, j]
        share = math.expm1(sides[k] * bends[k])
        for j in range(n + 1):
            follows[k, j] += share * tension[j]


@jit_part
def _find(given: Actuators, bends: Array, u: Array, search: Search) -> bool:
    """Sets forces with which those within their bounds give their rates, under contact as it is."""
    n, z, follows, sides, W = len(search.z), search.z, search.follows, search.sides, search.W
    A, x = matrix_in(search.matrix, n), search.solved
    for k in range(n):
        search.wrong[k] = 0.0 if sides[k] else 1.0
    _chain(given, bends, u, sides, search.wrong, search)
    for k in range(n):
        x[k] = 0.0
        for j in range(n):
            A[k, j] = 1.0 if k == j else 0.0
        if sides[k]:
            continue
        x[k] = search.aims[k] - search.rates[k] - search.added[k]
        A[k, k] = 0.0
        for j in range(n):
            x[k] -= W[k, j] * follows[j, n]
            for i in range(n):
                A[k, i] += W[k, j] * follows[j, i]
    if not solve(A, x, n):
        return False
    for k in range(n):
        z[k] = follows[k, n]
        for j in range(n):
            z[k] += follows[k, j] * x[j]
    return True


@jit_apart
def _find_by_pivots(given: Actuators, bends: Array, u: Array, search: Search) -> bool:
    """Sets the bounds where forces are that fulfil all conditions; whether pivots find them."""
    n, g, sides, unknown, W = len(search.z), len(given.guides), search.sides, search.wrong, search.W
    first, most = n - g, 0.0
    idle, at, free = np.zeros(n), np.full(n, -1), np.zeros(n)
    for k in range(n):
        most = max(most, W[k, k])
    for k in range(n):
        idle[k] = 1.0 if k >= first and W[k, k] <= ROUND_OFF * most else 0.0
        unknown[k], sides[k] = 1.0 - idle[k], -1.0 if k >= first else 0.0
        free[k] = 1.0 if k < first and not given.pulls[k] else 0.0
    _chain(given, bends, u, sides, unknown, search)
    follows, tensions = search.follows, search.tensions
    A, b = np.zeros((n, n)), np.zeros(n)
    for k in range(n):
        b[k] = search.rates[k] + search.added[k] - search.aims[k]
        for j in range(n):
            b[k] += W[k, j] * follows[j, n]
            for i in range(n):
                A[k, i] += W[k, j] * follows[j, i]
    for p in range(n):  # volumes, whose forces may be of either sign, are eliminated
        for k in range(n if free[p] else 0):
            share = A[k, p] / A[p, p]
            for i in range(n if k != p else 0):
                A[k, i] -= share * A[p, i]
            b[k] -= share * b[p] if k != p else 0.0
    kept = rubs = 0
    for k in range(n):
        if not (idle[k] or free[k]):
            at[k], kept, rubs = kept, kept + 1, rubs + (k >= first)
    size, largest = most, 0.0
    M, q = np.zeros((kept + rubs, kept + rubs)), np.zeros(kept + rubs)
    for k in range(n):
        largest = max(largest, abs(b[k]) / size if at[k] >= 0 else 0.0, abs(tensions[k, n]))
    for k in range(n):
        if at[k] < 0:
            continue
        row, side = at[k], at[k] + rubs  # guides are the last ones of those that are kept
        q[row] = b[k] / size / largest
        for i in range(n):
            if at[i] >= 0:
                M[row, at[i]] = A[k, i] / size
        if k >= first:
            wide = math.expm1(bends[k]) - math.expm1(-bends[k])
            q[side], M[row, side] = wide * tensions[k, n] / largest, 1.0
            for i in range(n):
                if at[i] >= 0:
                    M[side, at[i]] = wide * tensions[k, i]
            M[side, row] -= 1.0
    found = solve_by_pivots(M, q)
    if found is None:
        return False
    for k in range(n):
        sides[k] = -idle[k]
        if at[k] >= 0:
            sides[k] = 0.0 if found[at[k]] > 0 else -1.0
            if k >= first and found[at[k] + rubs] > 0:
                sides[k] = 1.0
    return True


@jit_part
def look(given: Actuators, bends: Array, u: Array, touches: bool, search: Search) -> int:
    """Sets the forces of a round, and what the next one begins with if these are not found: GOES_ON.

    Args:
        given, bends, u, search: as in `begin_search`.
        touches: whether contact was found with the forces of `hold`.
    """
    outcome = _look(given, bends, u, int(search.numbers[ROUNDS]), touches, search)
    search.numbers[ROUNDS] += 1.0
    if outcome == GOES_ON:
        return GOES_ON if search.numbers[ROUNDS] < MAX_ROUNDS else NONE_FOUND
    if outcome == NONE_FOUND or len(given.gases) == 0:
        return outcome
    outcome = are_pressures(given, u, search)
    if outcome == GOES_ON:
        copy(search.z, search.before)
        _begin_rounds(given, bends, u, search)
    return outcome


@jit_part
def _look(given: Actuators, bends: Array, u: Array, count: int, touches: bool, search: Search) -> int:
    """The same after so many rounds of strokes that go at their aims, of which gas gives way as it is known to."""
    n, z, sides, beyond, targets, W = len(search.z), search.z, search.sides, search.beyond, search.aims, search.W
    if search.numbers[BY_PIVOTS] and not _find_by_pivots(given, bends, u, search):
        return NONE_FOUND
    if not _find(given, bends, u, search):
        return NONE_FOUND
    missed, wrong, first = search.tensions[0], search.wrong, n - len(given.guides)
    scale = most = miss = 0.0
    for k in range(n):
        missed[k] = search.rates[k] + search.added[k] - targets[k]
        for j in range(n):
            missed[k] += W[k, j] * z[j]
        scale, most = max(scale, abs(search.rates[k]), abs(targets[k]), abs(search.added[k])), max(most, abs(z[k]))
        miss = max(miss, 0.0 if sides[k] else abs(missed[k]))
    if not miss <= LARGEST_MISS * scale:
        return NONE_FOUND
    _set_bounds(given, bends, u, z, search)
    tolerance = PIVOTED if count >= TOGETHER else TOLERANCE
    are_wrong, changed = False, 0.0
    for k in range(n):
        least, lower, upper = tolerance * most if k >= first else 0.0, search.lower[k], search.upper[k]
        if sides[k]:
            is_wrong = sides[k] * missed[k] > tolerance * scale and lower < upper
        else:
            is_wrong = z[k] < lower - least or z[k] > upper + least
        wrong[k], are_wrong = 1.0 if is_wrong else 0.0, are_wrong or is_wrong
        last = beyond[k]
        beyond[k] = 0.0 if search.holds[k] else min(max(z[k], lower), upper)
        changed = max(changed, abs(beyond[k] - last))
    if are_wrong:
        if count + 1 < TOGETHER:
            for k in range(n):
                if wrong[k]:
                    sides[k] = 0.0 if sides[k] else -1.0 if z[k] < search.lower[k] else 1.0
                bounded = min(max(z[k], search.lower[k]), search.upper[k])
                beyond[k] = bounded if sides[k] else 0.0
                search.kept[k] = bounded if k >= first else beyond[k]
        elif not search.numbers[BY_PIVOTS]:
            search.numbers[BY_PIVOTS] = 1.0
            copy(search.kept, beyond)
        _hold_within(given, search)
        return GOES_ON
    helps = False
    for k in range(first, n):
        if targets[k] != 0.0 and z[k] * (missed[k] + targets[k]) > TOLERANCE * most * scale:
            targets[k], helps = 0.0, True
    if not (helps or (touches and changed > SETTLED * most)):
        return ARE_FOUND
    if search.numbers[BY_PIVOTS] and not are_equal(sides, search.tried):
        # Turns are slow, so that these sides are tried.
        search.numbers[BY_PIVOTS] = 0.0
        copy(sides, search.tried)
        copy(beyond, search.kept)
        for k in range(n):
            beyond[k] = 0.0 if sides[k] == 0.0 else beyond[k]
    _hold_within(given, search)
    return GOES_ON
