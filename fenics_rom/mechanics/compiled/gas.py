"""Gas in chambers, compiled: `mechanics.gas`, whose law it is, and valves."""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_apart, jit_part, jit_shared
from fenics_rom.mechanics import filling, gas
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.searched_forces import (
    ARE_FOUND,
    GOES_ON,
    MISSED,
    NONE_FOUND,
    STEP,
    TURNS,
    Actuators,
    Search,
    gas_in,
)
from fenics_rom.mechanics.gas import LEAST_VOLUME, MAX_ITERATIONS, SETTLED, SMALLEST, STUCK, Gas


class Filled(NamedTuple):
    """Gas that was blown into chambers of B bodies so far, m³: of n forces each, 0 of those that are not of gas."""

    amounts: Array  # (B, n)
    before: Array  # the same before the last step


_pressure_at, _energy_of, _let_in = map(jit_shared, (gas.pressure_at, gas.energy_of, filling.let_in))


@jit_apart
def pressure_at(gas: Gas, amount: float, stroke: float, end: float, slope: Array) -> float:
    """As `gas.pressure_at`, with what it changes by set (1,)."""
    pressure, slope[0] = _pressure_at(gas, amount, stroke, end, False)
    return pressure


@jit_apart
def energy_of(gas: Gas, stroke: float, amount: float) -> float:
    """As `gas.energy_of`."""
    return _energy_of(gas, stroke, amount)


@jit_apart
def let_in(gas: Gas, stroke: float, amount: float, supply: float, h: float) -> float:
    """As `filling.let_in`."""
    return _let_in(gas, stroke, amount, supply, h)


@jit_apart
def blow_in(given: Actuators, strokes: Array, amounts: Array, u: Array, h: float) -> float:
    """Has an input (p,) say what gas there is after a step of h s, also of valves; what is stored before it, J.

    Args:
        given: what n forces are of.
        strokes: (n,) of chambers, m³.
        amounts: (n,) that was blown in so far, m³.
        u: changed.
        h: as above.

    Returns:
        What gas stores; not a number: a chamber has no volume, or no gas.
    """
    stored = 0.0
    for i in range(len(given.gases)):
        k, gas = int(given.gases[i, 0]), gas_in(given.gases, i)
        column = given.columns[k]
        if not gas.volume + strokes[k] > 0:
            return math.nan
        stored += energy_of(gas, strokes[k], amounts[k])
        if gas.orifice > 0:
            u[column] = let_in(gas, strokes[k], amounts[k], u[column], h)
        if not gas.volume + u[column] > 0:
            return math.nan
    return stored


@jit_apart
def keep_gas(given: Actuators, strokes: Array, u: Array, amounts: Array) -> float:
    """Has the gas of a step under an input (p,) that `blow_in` changed be there; what it stores, J."""
    stored = 0.0
    for i in range(len(given.gases)):
        k = int(given.gases[i, 0])
        amounts[k] = u[given.columns[k]]
        stored += energy_of(gas_in(given.gases, i), strokes[k], amounts[k])
    return stored


@jit
def store_in_gas(given: Actuators, strokes: Array, amounts: Array, stored: Array) -> None:
    """Sets what the gas of bodies (B,) stores, J, of strokes and amounts (B, n)."""
    for b in range(len(stored)):
        stored[b] = 0.0
        for i in range(len(given.gases)):
            k = int(given.gases[i, 0])
            stored[b] += energy_of(gas_in(given.gases, i), strokes[b, k], amounts[b, k])


@jit_part
def begin_gas(given: Actuators, u: Array, h: float, search: Search) -> bool:
    """Begins with pressures near those that forces before lead to; whether chambers have a volume, and gas."""
    search.numbers[TURNS], search.numbers[MISSED], search.numbers[STEP] = 0.0, math.inf, h
    for i in range(len(given.gases)):
        k = int(given.gases[i, 0])
        volume, whole = given.gases[i, 1] + search.strokes[k], given.gases[i, 1] + u[given.columns[k]]
        if not (volume > 0 and whole > 0):
            return False
        rate = search.rates[k]
        for j in range(len(search.z)):
            rate += search.W[k, j] * search.before[j]
        search.guess[k] = (max(volume + h * rate, LEAST_VOLUME * volume, SMALLEST * whole) - volume) / h
    _give_way(given, u, search)
    return True


@jit_part
def _give_way(given: Actuators, u: Array, search: Search) -> None:
    """Has gas be strokes that give way as it does near the guess."""
    h = search.numbers[STEP]
    for i in range(len(given.gases)):
        k, slope = int(given.gases[i, 0]), search.wrong
        end = search.strokes[k] + h * search.guess[k]
        pressure = pressure_at(gas_in(given.gases, i), u[given.columns[k]], search.strokes[k], end, slope)
        search.pressures[k], search.gives[k] = pressure, -1 / (h * slope[0])
        search.W[k, k] = search.diagonal[k] + search.gives[k]
        search.aims[k] = search.guess[k] + search.gives[k] * pressure


@jit_part
def are_pressures(given: Actuators, u: Array, search: Search) -> int:
    """Whether forces that were found are those of gas; else what the next rounds begin with is set: GOES_ON."""
    numbers, h, is_far = search.numbers, search.numbers[STEP], False
    copy(search.targets, search.aims)
    for i in range(len(given.gases)):
        k = int(given.gases[i, 0])
        volume, smallest = given.gases[i, 1] + search.strokes[k], SMALLEST * (given.gases[i, 1] + u[given.columns[k]])
        last = volume + h * search.guess[k]
        rate, least = search.guess[k] + search.gives[k] * (search.pressures[k] - search.z[k]), LEAST_VOLUME * last
        least = max(least, smallest)
        if volume + h * rate < least:
            if last <= 2 * smallest:  # pressed to nothing
                return NONE_FOUND
            rate, is_far = (least - volume) / h, True
        search.guess[k] = rate
    numbers[TURNS] += 1.0
    _give_way(given, u, search)
    if is_far:
        return GOES_ON if numbers[TURNS] < MAX_ITERATIONS else NONE_FOUND
    last, missed = numbers[MISSED], 0.0
    for i in range(len(given.gases)):
        k = int(given.gases[i, 0])
        lacks = abs(search.z[k] - search.pressures[k])
        scale = max(abs(search.pressures[k]), abs(search.guess[k] / search.gives[k]))
        missed = max(missed, lacks / scale if lacks > 0 else 0.0)
    numbers[MISSED] = missed
    if missed <= SETTLED or last / 2 <= missed <= STUCK:
        return ARE_FOUND
    return GOES_ON if numbers[TURNS] < MAX_ITERATIONS else NONE_FOUND
