"""How much gas the chambers of a body hold in a run, and what it stores: part of the energy account of the body."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.gas import Gas, amount_at, check_gas, energy_of, gauge, stored

GAS_CONSTANT = 287.05  # of air, J/kg/K
HEATS = 1.4  # ratio of heat capacities of air, in the jet
CHOKED = (2 / (HEATS + 1)) ** (HEATS / (HEATS - 1))  # of the pressures behind and before it, below which it is
BISECTIONS = 200


class Filling:
    """Of one body.

    Args:
        gases: of chambers, by name.
        widths: number of input columns of all actuators, by name, in the order of the input.
        stroke: by how much a chamber is larger than at rest now, m³, by name.
        by_valve: `let_in`, compiled; None: as it is.

    Attributes:
        columns: of each in the input, counted from the end of the actuators'.
        amounts: what was blown in so far, by name, m³ at ambient pressure.
    """

    def __init__(
        self,
        gases: Mapping[str, Gas],
        widths: Mapping[str, int],
        stroke: Callable[[str], float],
        by_valve: "Callable[[Gas, float, float, float, float], float] | None" = None,
    ):
        self._gases, self._stroke, total = gases, stroke, sum(widths.values())
        self._let_in = by_valve or let_in
        ends = dict(zip(widths, accumulate(widths.values()), strict=True))
        self.columns = {name: ends[name] - 1 - total for name in gases}
        self.resume({})

    @property
    def energy(self) -> float:
        """Stored in all gas, J."""
        return self._energy_at({name: self._stroke(name) for name in self._gases})

    def _energy_at(self, strokes: Mapping[str, float]) -> float:
        return math.fsum(energy_of(gas, strokes[name], self.amounts[name]) for name, gas in self._gases.items())

    def resume(self, amounts: Mapping[str, float]) -> None:
        """Goes on from a body that is where it is, with some gas."""
        self.amounts = {name: amounts.get(name, 0.0) for name in self._gases}
        self._stored = 0.0
        self.gained()

    def in_order(self, names: Sequence[str], count: int) -> Array:
        """What was blown into chambers, (count,), of which the first have such names; 0 of others."""
        amounts = np.zeros(count)
        for place, name in enumerate(names):
            amounts[place] = self.amounts.get(name, 0.0)
        return amounts

    def check(self, u: Array, time: float) -> None:
        """A StepError where a chamber has no volume, or no gas, in a step that begins at a time, s, under (any,)."""
        for name, gas in self._gases.items():
            check_gas(name, gas, self._strokes[name], u.item(self.columns[name]), f"t = {time:.6g} s: ")

    def blown(self, u: Array, time: float, h: float) -> Array:
        """An input (any,), which ends with the actuators', with the gas of a step of h, s, that begins at a time, s.

        Raises:
            StepError: a chamber has no volume, or no gas.
        """
        blown = u.copy()
        for name, gas in self._gases.items():
            if gas.orifice:
                stroke, column, amount = self._strokes[name], self.columns[name], self.amounts[name]
                check_gas(name, gas, stroke, amount, f"t = {time:.6g} s: ")
                blown[column] = self._let_in(gas, stroke, amount, u.item(column), h)
        self.check(blown, time)
        return blown

    def let_in_slopes(self, name: str, u: Array, h: float) -> tuple[float, float, float]:
        """What a chamber gets in `blown` changes by with what it holds, with its stroke, and with the input."""
        gas, column = self._gases[name], self.columns[name]
        if not gas.orifice:
            return 0.0, 0.0, 1.0
        return let_in_slopes(gas, self._stroke(name), self.amounts[name], u.item(column), h)

    def energy_slopes(self, name: str) -> tuple[float, float]:
        """What gas stores more with a stroke, and with what is blown in, Pa."""
        gas, amount = self._gases[name], self.amounts[name]
        whole = gas.volume + amount
        d = (self._stroke(name) - amount) / whole
        pressure, _ = gauge(d, gas.exponent)
        return -gas.ambient * pressure, gas.ambient * (stored(d, gas.exponent) + (1 + d) * pressure)

    def last(self, u: Array) -> Array:
        """An input (any,), which ends with the actuators', with the gas of the last step."""
        blown = u.copy()
        for name, column in self.columns.items():
            blown[column] = self.amounts[name]
        return blown

    def take(self, blown: Array) -> float:
        """Ends a step under such an input; what gas gained, J.

        A body books the work of its gas as supplied, as if it came from outside. With this added it is that of what is
        blown in.
        """
        self.amounts = {name: blown.item(column) for name, column in self.columns.items()}
        return self.gained()

    def gained(self) -> float:
        """What all gas stores more than when this was last asked, J."""
        self._strokes = {name: self._stroke(name) for name in self._gases}  # until the body is put elsewhere
        before, self._stored = self._stored, self._energy_at(self._strokes)
        return self._stored - before


def flow(gas: Gas, supply: float, pressure: float) -> float:
    """Of air through an orifice, m³ at ambient pressure per s, from gauge pressures, Pa; out of a chamber negative."""
    before, behind = max(gas.ambient + max(supply, pressure), 0.0), max(gas.ambient + min(supply, pressure), 0.0)
    if before <= behind:
        return 0.0
    ratio, k = max(behind / before, CHOKED), HEATS
    jet = math.sqrt(2 * k / (k - 1) * (ratio ** (2 / k) - ratio ** ((k + 1) / k)))
    rate = gas.orifice * math.sqrt(GAS_CONSTANT * gas.temperature) * before / gas.ambient * jet
    return rate if supply > pressure else -rate


def let_in(gas: Gas, stroke: float, amount: float, supply: float, h: float) -> float:
    """What a chamber holds, m³ beside that at rest, after h s behind an orifice, in which its volume stays.

    By the backward Euler method, so that no step goes beyond the pressure of the supply.
    """
    volume = gas.volume + stroke
    end = amount_at(gas, stroke, supply)
    least, most = min(amount, end), max(amount, end)
    for _ in range(BISECTIONS):
        middle = (least + most) / 2
        if not least < middle < most:
            break
        pressure = gas.ambient * ((gas.volume + middle) / volume - 1)
        if middle < amount + h * flow(gas, supply, pressure):
            least = middle
        else:
            most = middle
    return (least + most) / 2


def let_in_slopes(gas: Gas, stroke: float, amount: float, supply: float, h: float) -> tuple[float, float, float]:
    """What `let_in` changes by with the amount at the start, the stroke and the supply's pressure."""
    end, volume = let_in(gas, stroke, amount, supply, h), gas.volume + stroke
    share = (gas.volume + end) / volume
    by_supply, by_pressure = flow_slopes(gas, supply, gas.ambient * (share - 1))
    per_pressure = -h * by_pressure  # u = u₀ + h v(p(u)): what comes in less, as the pressure rises
    left = 1 / (1 + per_pressure * gas.ambient / volume)
    return left, left * per_pressure * gas.ambient * share / volume, left * h * by_supply


def flow_slopes(gas: Gas, supply: float, pressure: float) -> tuple[float, float]:
    """What `flow` changes by with both pressures, of which one flows into the other."""
    rate, k = flow(gas, supply, pressure), HEATS
    if rate == 0.0:
        return 0.0, 0.0
    before, behind = (gas.ambient + each for each in (max(supply, pressure), min(supply, pressure)))
    ratio, by_ratio = behind / before, 0.0
    if ratio > CHOKED:
        jet, slope = (
            ratio ** (2 / k) - ratio ** ((k + 1) / k),
            2 / k * ratio ** (2 / k - 1) - (k + 1) / k * ratio ** (1 / k),
        )
        by_ratio = slope / jet / 2
    slopes = rate / before * (1 - ratio * by_ratio), rate / before * by_ratio
    return slopes if supply > pressure else slopes[::-1]
