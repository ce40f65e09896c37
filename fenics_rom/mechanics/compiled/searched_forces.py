"""What is looked for in a step of strokes and guides: `mechanics.actuator_forces`, as arrays for compiled steps."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_products import LANES, ROWS
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.compiled.work_space import take, take_rows
from fenics_rom.mechanics.gas import Gas

GOES_ON, ARE_FOUND, NONE_FOUND = range(3)  # what a round of a search ends with
OF_GAS = 6


class Actuators(NamedTuple):
    """What n forces are of, k of strokes and then g at guides."""

    columns: Array  # of the input (n,)
    pulls: Array  # 1 of cables by strokes (n,), 0 of others
    share: Array  # (n,), as in `ActuatorForces`
    # (g, 3), of each tendon from where it is pulled on: which force, which stroke the tendon has or -1, and its column
    guides: Array
    bends: Array  # μα at guides (n,), of angles at rest
    gases: Array  # (g, 6): which force, and its `Gas`

    @staticmethod
    def of(actuators: ActuatorForces | None, p: int) -> "Actuators":
        """Those of inputs (p,)."""
        if actuators is None:
            none = np.zeros(0)
            return Actuators(np.zeros(0, int), none, none, np.zeros((0, 3), int), none, np.zeros((0, OF_GAS)))
        chains = [
            (guide, -1 if stroke is None else stroke, column % p)
            for stroke, column, guides in actuators.chains
            for guide in guides.tolist()
        ]
        share, pulls = actuators.share.astype(float), actuators.pulls.astype(float)
        gases = [(float(place), *gas) for place, (_, gas) in actuators.gases.items()]
        of_guides = np.array(chains, int).reshape(-1, 3), actuators.bends(None)
        return Actuators(actuators.columns % p, pulls, share, *of_guides, np.array(gases).reshape(-1, OF_GAS))


class Search(NamedTuple):
    """Of a step, (n,) each but the last ones."""

    z: Array  # forces
    targets: Array  # rates of strokes,
    aims: Array  # and those that they are led to in these rounds
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
    diagonal: Array  # of W without what gives way
    strokes: Array  # at the start,
    guess: Array  # rates near which gas is a stroke that gives way,
    gives: Array  # by so much,
    pressures: Array  # and its pressures there
    before: Array  # forces that these rounds begin with
    numbers: Array  # in this order: BY_PIVOTS, ROUNDS, TURNS, MISSED, STEP
    follows: Array  # forces by those that are looked for, (n, n + 1): the last is known
    tensions: Array  # of tendons ahead of guides, likewise
    W: Array  # rates by forces (n, n), with what gives way
    matrix: Array  # room for equations, as of `elimination.matrix_in`,
    solved: Array  # and for what they give (n + 3,)


BY_PIVOTS = 0  # whether pivots find the sides now
ROUNDS = 1  # that were taken
TURNS = 2  # of gas that were
MISSED = 3  # share that pressures missed in the last one
STEP = 4  # s
NUMBERS = 5


@jit_part
def room_for_search(n: int) -> int:
    """How many numbers it has."""
    return 1 + 19 * n + NUMBERS + 2 * n * (n + 1) + n * n + (n + ROWS) * (n + LANES) + n + 3


@jit_part
def search_in(numbers: Array, n: int) -> Search:
    """As parts of these."""
    numbers[0] = 1.0
    z, targets, aims = take(numbers, n), take(numbers, n), take(numbers, n)
    rates, added = take(numbers, n), take(numbers, n)
    beyond, sides, holds, tried = take(numbers, n), take(numbers, n), take(numbers, n), take(numbers, n)
    kept, lower, upper, wrong = take(numbers, n), take(numbers, n), take(numbers, n), take(numbers, n)
    diagonal, strokes, guess = take(numbers, n), take(numbers, n), take(numbers, n)
    gives, pressures, before = take(numbers, n), take(numbers, n), take(numbers, n)
    last = take(numbers, NUMBERS), take_rows(numbers, n, n + 1), take_rows(numbers, n, n + 1), take_rows(numbers, n, n)
    of_equations = take(numbers, (n + ROWS) * (n + LANES)), take(numbers, n + 3)
    first, bounds = (z, targets, aims, rates, added, beyond), (sides, holds, tried, kept, lower, upper, wrong)
    return Search(*first, *bounds, diagonal, strokes, guess, gives, pressures, before, *last, *of_equations)


@jit_part
def gas_in(gases: Array, k: int) -> Gas:
    """One of them."""
    return Gas(gases[k, 1], gases[k, 2], gases[k, 3], gases[k, 4], gases[k, 5])
