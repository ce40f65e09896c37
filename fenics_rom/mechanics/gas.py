"""Gas in chambers: its pressure, what it stores, and its forces in a step.

A chamber of volume V₀ at rest holds the gas that fills V₀ at the ambient pressure p_a, and u (m³, measured there) that
was blown in besides. With s what the chamber is larger by, its gauge pressure is

    p = p_a ((1 + d)^-γ - 1),    d = (s - u)/(V₀ + u),

isothermal with γ = 1, adiabatic with γ the ratio of heat capacities. So d = 0 where the gas is at ambient pressure, and
what it can do down to there is stored:

    Ψ = p_a (V₀ + u) ψ(d),    ψ' = 1 - (1 + d)^-γ,    ψ(0) = 0.

A step keeps the gas that it begins with, and its pressure is the discrete gradient -(Ψ(s⁺) - Ψ(s))/(s⁺ - s), which does
exactly the work that the gas gives away (Gonzalez, 1996). An equilibrium has the pressure of its end.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact import ContactSolution

ATMOSPHERE = 101325.0  # Pa
AIR = 293.15  # K
GAS_CONTROLS = ("gas", "valve")  # of a chamber: what is given is the gas blown in, m³, or the supply's pressure, Pa
NEAR_AMBIENT = 0.1  # of d: so near to 0 sums of powers keep all digits
POWERS = 20  # of them, until they are round-off
LEAST_VOLUME = 0.1  # of a volume, that an iteration goes down to at once
SMALLEST = 1e-4  # of the volume that the gas has outside: beyond it a chamber is pressed to nothing
MAX_ITERATIONS = 100
SETTLED = 1e-15  # of the pressures: what iterations leave
STUCK = 1e-9  # the same, of one that gets no nearer for round-off


class Gas(NamedTuple):
    """What a chamber is filled with."""

    volume: float  # V₀, of the chamber at rest, m³; 0: what its surface encloses, which no scene knows
    exponent: float = 1.0  # γ
    ambient: float = ATMOSPHERE  # p_a, Pa
    orifice: float = 0.0  # of a valve: area times discharge coefficient, m²
    temperature: float = AIR  # of what comes through it, K


def stored(d: float, exponent: float) -> float:
    """ψ."""
    if abs(d) < NEAR_AMBIENT:
        term, total = exponent / 2 * d * d, 0.0
        for k in range(2, POWERS):
            total += term
            term *= (1 - exponent - k) / (k + 1) * d
        return total
    if exponent == 1.0:
        return d - math.log1p(d)
    return d + math.expm1((1 - exponent) * math.log1p(d)) / (exponent - 1)


def gauge(d: float, exponent: float) -> tuple[float, float]:
    """p/p_a, and what it changes by with d."""
    grown = math.log1p(d)
    return math.expm1(-exponent * grown), -exponent * math.exp(-(exponent + 1) * grown)


def mean_gauge(start: float, end: float, exponent: float) -> tuple[float, float]:
    """-(ψ(end) - ψ(start))/(end - start), and what it changes by with the end."""
    if abs(start) < NEAR_AMBIENT and abs(end) < NEAR_AMBIENT:
        term, power = exponent / 2, 1.0
        divided = slope = value = changes = 0.0
        for k in range(1, POWERS):
            slope = divided + end * slope  # of Σ endⁱ startʲ, i + j = k - 1
            divided = end * divided + power
            power *= start
            if k > 1:
                value -= term * divided
                changes -= term * slope
                term *= (1 - exponent - k) / (k + 1)
        return value, changes
    x = (end - start) / (1 + start)
    at_start, grown = math.exp(-exponent * math.log1p(start)), math.log1p(x)
    if x == 0.0:
        return at_start - 1, -exponent * at_start / (1 + start) / 2
    mean = grown / x if exponent == 1.0 else -math.expm1((1 - exponent) * grown) / ((exponent - 1) * x)
    if abs(x) < 1e-4:
        slope = -exponent / 2 + exponent * (exponent + 1) * x / 3
    else:
        slope = (math.exp(-exponent * grown) - mean) / x
    return at_start * mean - 1, at_start * slope / (1 + start)


def pressure_at(gas: Gas, amount: float, stroke: float, end: float, at_rest: bool) -> tuple[float, float]:
    """Gauge pressure, Pa, in a step in which a chamber's stroke goes to its end, m³, and what it changes by with that.

    `at_rest`: that of the end, of an equilibrium.
    """
    whole = gas.volume + amount
    first, last = (stroke - amount) / whole, (end - amount) / whole
    p, slope = gauge(last, gas.exponent) if at_rest else mean_gauge(first, last, gas.exponent)
    return gas.ambient * p, gas.ambient * slope / whole


class GasStep(NamedTuple):
    """What g gases do in a step, or at its end, of an equilibrium."""

    places: Array  # of their forces (g,), among n that are found
    names: tuple[str, ...]
    gases: tuple[Gas, ...]
    amounts: Array  # u (g,), m³
    strokes: Array  # s (g,) at the start, m³
    h: float  # s
    at_rest: bool

    def at(self, rates: Array) -> tuple[Array, Array]:
        """Pressures (g,), Pa, where chambers grow at rates (g,), m³/s, and what they change by with these."""
        pressures, slopes = np.empty(len(rates)), np.empty(len(rates))
        for k, (gas, u, s) in enumerate(zip(self.gases, self.amounts.tolist(), self.strokes.tolist(), strict=True)):
            pressures[k], slope = pressure_at(gas, u, s, s + self.h * rates.item(k), self.at_rest)
            slopes[k] = self.h * slope
        return pressures, slopes

    def slopes(self, rates: Array) -> tuple[Array, Array, Array]:
        """What pressures (g,) change by with rates, with strokes at the start, and with what is blown in."""
        _, by_rate = self.at(rates)
        by_stroke, by_amount = by_rate / self.h, np.empty(len(rates))
        for k, (gas, u, s) in enumerate(zip(self.gases, self.amounts.tolist(), self.strokes.tolist(), strict=True)):
            whole = gas.volume + u
            start, end = (s - u) / whole, (s + self.h * rates.item(k) - u) / whole
            by_start = 0.0 if self.at_rest else mean_gauge(end, start, gas.exponent)[1]
            share = gas.ambient * by_start / whole
            by_amount[k] = -(1 + start) * share - (1 + end) * by_stroke[k]
            by_stroke[k] += share
        return by_rate, by_stroke, by_amount

    def compliances(self, z: Array) -> Array:
        """What rates change by with forces less than without gas, near forces z (n,): (n,), m³/s/Pa."""
        gives = np.zeros(len(z))
        for place, gas, u in zip(self.places, self.gases, self.amounts, strict=True):
            share = max(1 + z[place] / gas.ambient, LEAST_VOLUME**gas.exponent)
            slope = -gas.exponent * share ** (1 + 1 / gas.exponent) * (1.0 if self.at_rest else 0.5)
            gives[place] = -(gas.volume + u) / (gas.ambient * slope * self.h)
        return gives

    def find(self, rates: Array, W: Array, targets: Array, before: Array, solve: "Solve") -> "Found":
        """Forces and contact of a step, by Newton's method.

        Near some rates gas is a stroke that gives way: its forces p + p' (rate - those) go to the side of W.

        Args:
            rates, W, targets, before: as of `ActuatorForces.solve`; of gas there are no targets.
            solve: with the same, and what strokes give way by.

        Raises:
            StepError: a chamber has no volume or no gas, or no forces were found.
        """
        for name, gas, s, u in zip(self.names, self.gases, self.strokes.tolist(), self.amounts.tolist(), strict=True):
            check_gas(name, gas, s, u)
        at, h, filled = self.places, self.h, np.array([gas.volume for gas in self.gases])
        volumes, smallest = filled + self.strokes, SMALLEST * (filled + self.amounts)

        def led(ends: Array, last: Array) -> tuple[Array, Array]:
            """Rates to volumes (g,), or as far as one goes at once from the last ones; and which of them go farther."""
            least = np.maximum(LEAST_VOLUME * last, smallest)
            return (np.maximum(ends, least) - volumes) / h, ends < least

        guess, _ = led(volumes + h * (rates + W.dot(before))[at], volumes)
        error, found = math.inf, None
        for _ in range(MAX_ITERATIONS):
            pressures, slopes = self.at(guess)
            if found is not None:
                last, missed = error, np.abs(found[0][at] - pressures)
                scale = np.maximum(np.abs(pressures), np.abs(slopes * guess))
                error = float((missed / np.where(missed > 0, scale, 1.0)).max())
                if error <= SETTLED or last / 2 <= error <= STUCK:
                    return found
            gives, aims = np.zeros(len(rates)), targets.copy()
            gives[at] = -1 / slopes
            aims[at] = guess + gives[at] * pressures
            z, contact = solve(W + np.diag(gives), aims, before, gives)
            last_ends, wanted = volumes + h * guess, guess + gives[at] * (pressures - z[at])
            guess, is_far = led(volumes + h * wanted, last_ends)
            if (crushed := is_far & (last_ends <= 2 * smallest)).any():
                raise StepError(
                    f"chamber {self.names[int(crushed.argmax())]!r} is pressed to nothing within a step, to less than "
                    f"{SMALLEST:g} of the volume that its gas has outside; a smaller dt, or more gas, is the cure"
                )
            guess = np.where(is_far, guess, wanted)
            found, before = (None if is_far.any() else (z, contact)), z
        raise StepError(f"no pressures were found of the gas in {', '.join(self.names)}; a smaller dt may help")


def check_gas(name: str, gas: Gas, stroke: float, amount: float, where: str = "") -> None:
    """A StepError where a chamber has no volume, or no gas."""
    if not gas.volume + stroke > 0:
        raise StepError(
            f"{where}chamber {name!r} is pressed to {gas.volume + stroke:.4g} m³ (at rest it has {gas.volume:.4g} m³), "
            "so that its gas has no pressure; a smaller dt, or more gas, is the cure"
        )
    if not gas.volume + amount > 0:
        raise StepError(
            f"{where}chamber {name!r}: {amount:.4g} m³ of gas are given; use more than {-gas.volume:.4g} m³, as "
            "it holds no more at rest that could be taken out"
        )


Found = tuple[Array, "ContactSolution | None"]
Solve = Callable[[Array, Array, Array, Array], Found]


class Targets(NamedTuple):
    """What strokes are to do in a step."""

    rates: Array  # c (n,), per s; of gas nothing
    gas: GasStep | None = None


def amount_at(gas: Gas, stroke: float, pressure: float) -> float:
    """Of gas, m³, that has a gauge pressure, Pa, where the chamber is larger by a stroke, m³."""
    share = max(1 + pressure / gas.ambient, 0.0)
    return (gas.volume + stroke) * share ** (1 / gas.exponent) - gas.volume


def energy_of(gas: Gas, stroke: float, amount: float) -> float:
    """What gas stores, J; infinite where the chamber has no volume."""
    whole = gas.volume + amount
    d = (stroke - amount) / whole
    return gas.ambient * whole * stored(d, gas.exponent) if d > -1 else math.inf
