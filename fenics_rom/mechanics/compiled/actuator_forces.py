"""Forces of actuators that a step finds, by strokes and at guides, compiled: `mechanics.actuator_forces`.

A step goes through the same rounds, in each of which it looks for contact by itself.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.compiled_products import LANES, ROWS
from fenics_rom.mechanics.actuator_forces import (
    AT_A_BOUND,
    LARGEST_MISS,
    PIVOTED,
    ROUND_OFF,
    SETTLED,
    TOGETHER,
    TOLERANCE,
    ActuatorForces,
)
from fenics_rom.mechanics.compiled.copying import are_equal, copy, fill
from fenics_rom.mechanics.compiled.elimination import matrix_in, solve
from fenics_rom.mechanics.compiled.work_space import take, take_rows
from fenics_rom.mechanics.complementarity import pivoting

solve_by_pivots = jit_shared(pivoting.solve_by_pivots)
GOES_ON, ARE_FOUND, NONE_FOUND = range(3)  # what a round of a search ends with


class Actuators(NamedTuple):
    """What n forces are of, k of strokes and then g at guides."""

    columns: Array  # of the input (n,)
    pulls: Array  # 1 of cables by strokes (n,), 0 of others
    share: Array  # (n,), as in `ActuatorForces`
    # (g, 3), of each tendon from where it is pulled on: which force, which stroke the tendon has or -1, and its column
    guides: Array
    bends: Array  # μα at guides (n,), of angles at rest

    @staticmethod
    def of(actuators: ActuatorForces | None, p: int) -> "Actuators":
        """Those of inputs (p,)."""
        if actuators is None:
            none = np.zeros(0)
            return Actuators(np.zeros(0, int), none, none, np.zeros((0, 3), int), none)
        chains = [
            (guide, -1 if stroke is None else stroke, column % p)
            for stroke, column, guides in actuators.chains
            for guide in guides.tolist()
        ]
        share, pulls = actuators.share.astype(float), actuators.pulls.astype(float)
        return Actuators(
            actuators.columns % p, pulls, share, np.array(chains, int).reshape(-1, 3), actuators.bends(None)
        )


class Search(NamedTuple):
    """Of a step, (n,) each but the last ones."""

    z: Array  # forces
    targets: Array  # rates of strokes
    rates: Array  # those without these forces and without contact,
    added: Array  # and what contact adds to them
    beyond: Array  # what is at a bound, as contact was last found with it
    sides: Array  # the bound where a force is, -1 or 1, or 0
    holds: Array  # 1 of those within their bounds, with which contact is found next
    tried: Array  # sides of the last time when pivots were to find them
    kept: Array  # what is at guides, with which pivots begin
    lower: Array
    upper: Array
    wrong: Array  # 1 of those that are to change
    flags: Array  # whether pivots find the sides now (1,)
    follows: Array  # forces by those that are looked for, (n, n + 1): the last is known
    tensions: Array  # of tendons ahead of guides, likewise
    matrix: Array  # room for equations, as of `elimination.matrix_in`,
    solved: Array  # and for what they give (n + 3,)


@jit_part
def room_for_search(n: int) -> int:
    """How many numbers it has."""
    return 2 + 12 * n + 2 * n * (n + 1) + (n + ROWS) * (n + LANES) + n + 3


@jit_part
def search_in(numbers: Array, n: int) -> Search:
    """As parts of these."""
    numbers[0] = 1.0
    z, targets, rates, added = take(numbers, n), take(numbers, n), take(numbers, n), take(numbers, n)
    beyond, sides, holds, tried = take(numbers, n), take(numbers, n), take(numbers, n), take(numbers, n)
    kept, lower, upper, wrong = take(numbers, n), take(numbers, n), take(numbers, n), take(numbers, n)
    last = take(numbers, 1), take_rows(numbers, n, n + 1), take_rows(numbers, n, n + 1)
    of_equations = take(numbers, (n + ROWS) * (n + LANES)), take(numbers, n + 3)
    bounds = kept, lower, upper, wrong
    return Search(z, targets, rates, added, beyond, sides, holds, tried, *bounds, *last, *of_equations)


@jit_part
def begin_search(given: Actuators, bends: Array, W: Array, u: Array, before: Array, search: Search) -> None:
    """Begins with what guides did under forces before (n,): as `ActuatorForces.solve`."""
    n, largest, are_known = len(before), 0.0, False
    first = n - len(given.guides)
    for k in range(n):
        largest, are_known = max(largest, W[k, k]), are_known or before[k] != 0.0
    _set_bounds(given, bends, u, before, search)
    fill(search.beyond, 0.0)
    fill(search.added, 0.0)
    fill(search.sides, 0.0)
    for k in range(first, n):
        idle = W[k, k] <= ROUND_OFF * largest
        if idle or not are_known or before[k] <= AT_A_BOUND * search.lower[k]:
            search.sides[k] = -1.0
        elif before[k] >= AT_A_BOUND * search.upper[k]:
            search.sides[k] = 1.0
    search.flags[0] = 0.0
    copy(search.sides, search.tried)
    copy(search.beyond, search.kept)
    _hold_within(given, search)


@jit_part
def _hold_within(given: Actuators, search: Search) -> None:
    """Has those hold that are within their bounds; no guides, while pivots find where these are."""
    first = len(search.sides) - len(given.guides)
    for k in range(len(search.sides)):
        search.holds[k] = 1.0 if search.sides[k] == 0.0 and not (search.flags[0] and k >= first) else 0.0


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
def hold(W: Array, search: Search) -> bool:
    """Sets the forces that contact is to be found with: those with which what is held goes as it is to.

    Whether there are some.
    """
    n, z, holds = len(W), search.z, search.holds
    A, x = matrix_in(search.matrix, n), search.solved
    for k in range(n):
        z[k] = 0.0 if holds[k] else search.beyond[k]
    for k in range(n):
        x[k] = search.targets[k] - search.rates[k]
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
def _find(given: Actuators, bends: Array, W: Array, u: Array, search: Search) -> bool:
    """Sets forces with which those within their bounds give their rates, under contact as it is."""
    n, z, follows, sides = len(W), search.z, search.follows, search.sides
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
        x[k] = search.targets[k] - search.rates[k] - search.added[k]
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
def _find_by_pivots(given: Actuators, bends: Array, W: Array, u: Array, search: Search) -> bool:
    """Sets the bounds where forces are that fulfil all conditions; whether pivots find them."""
    n, g, sides, unknown = len(W), len(given.guides), search.sides, search.wrong
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
        b[k] = search.rates[k] + search.added[k] - search.targets[k]
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
def look(given: Actuators, bends: Array, W: Array, u: Array, count: int, touches: bool, search: Search) -> int:
    """Sets the forces of a round, and what the next one begins with if these are not found: GOES_ON.

    Args:
        given, bends, W, u, search: as in `begin_search`.
        count: of rounds before.
        touches: whether contact was found with the forces of `hold`.
    """
    n, z, sides, beyond, targets = len(W), search.z, search.sides, search.beyond, search.targets
    if search.flags[0] and not _find_by_pivots(given, bends, W, u, search):
        return NONE_FOUND
    if not _find(given, bends, W, u, search):
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
        elif not search.flags[0]:
            search.flags[0] = 1.0
            copy(search.kept, beyond)
        _hold_within(given, search)
        return GOES_ON
    helps = False
    for k in range(first, n):
        if targets[k] != 0.0 and z[k] * (missed[k] + targets[k]) > TOLERANCE * most * scale:
            targets[k], helps = 0.0, True
    if not (helps or (touches and changed > SETTLED * most)):
        return ARE_FOUND
    if search.flags[0] and not are_equal(sides, search.tried):  # turns are slow, so that these sides are tried
        search.flags[0] = 0.0
        copy(sides, search.tried)
        copy(beyond, search.kept)
        for k in range(n):
            beyond[k] = 0.0 if sides[k] == 0.0 else beyond[k]
    _hold_within(given, search)
    return GOES_ON
