"""Gas in chambers: its law, steps that it is found in, and what comes through a valve."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fenics_rom.errors import StepError
from fenics_rom.mechanics.actuator_forces import ActuatorForces
from fenics_rom.mechanics.filling import CHOKED, GAS_CONSTANT, flow, let_in
from fenics_rom.mechanics.gas import Gas, amount_at, energy_of, gauge, mean_gauge, stored

EXPONENTS = pytest.mark.parametrize("exponent", [1.0, 1.4])
SIZES = st.floats(-9.0, 0.5).map(lambda x: 10**x)
ENDS = st.tuples(SIZES, st.sampled_from([-1.0, 1.0])).map(lambda given: max(given[0] * given[1], -0.97))


@given(ENDS, ENDS, st.sampled_from([1.0, 1.2, 1.4]))
def test_mean_pressure_does_the_work_that_is_stored(start, end, exponent):
    """To round-off of what is stored, and no more than that of d itself where both are small."""
    mean, slope = mean_gauge(start, end, exponent)
    work, sizes = -(end - start) * mean, [stored(d, exponent) for d in (start, end)]
    assert abs(work - (sizes[1] - sizes[0])) <= 1e-14 * max(sizes)
    assert min(sizes) >= 0
    there, step = gauge(end, exponent)[0], 1e-6 * (1 + end)
    assert slope == pytest.approx(
        (mean_gauge(start, end + step, exponent)[0] - mean_gauge(start, end - step, exponent)[0]) / (2 * step), rel=1e-5
    )
    assert mean_gauge(end, end, exponent)[0] == pytest.approx(there, rel=1e-12, abs=1e-15)


@EXPONENTS
def test_stored_energy_is_the_textbooks(exponent):
    """Of compression to half, from ambient pressure: isothermal n R T ln 2, adiabatic p V/(γ - 1), less p_a's work."""
    gas = Gas(1e-3, exponent)
    whole = math.log(2) if exponent == 1 else (2 ** (exponent - 1) - 1) / (exponent - 1)
    assert energy_of(gas, -0.5e-3, 0.0) == pytest.approx(gas.ambient * 1e-3 * (whole - 0.5), rel=1e-14)
    assert energy_of(gas, 2e-4, 2e-4) == 0.0
    pressure = gas.ambient * (2**exponent - 1)
    assert amount_at(gas, -0.5e-3, pressure) == pytest.approx(0.0, abs=1e-18)
    assert energy_of(gas, -1e-3, 0.0) == math.inf


@given(
    st.integers(0, 10**6), st.integers(1, 3), st.sampled_from([1.0, 1.4]), st.floats(-5.0, -1.0), st.floats(-2.0, 2.0)
)
def test_a_sealed_chamber_adds_no_energy_at_any_step(seed, chambers, exponent, time, stiff):
    """Of random bodies x'' + D x' + K x = B p: what body and gas store falls by what is dissipated, to round-off."""
    random, m, h = np.random.default_rng(seed), 5, 10**time
    K = (roots := random.standard_normal((m, m))) @ roots.T * 10 ** (2 * stiff + 2)
    D, B = 0.5 * np.eye(m), 1e-4 * random.standard_normal((m, chambers))
    gases = {f"c{k}": Gas(10 ** random.uniform(-4, -3), exponent) for k in range(chambers)}
    actuators = ActuatorForces(dict.fromkeys(gases, "gas"), {}, dict.fromkeys(gases, 1), gases)
    amounts = np.array([gas.volume for gas in gases.values()]) * random.uniform(-0.5, 3.0, chambers)
    x, v, z = np.zeros(m), 10 ** random.uniform(-3, 0.5) * random.standard_normal(m), np.zeros(chambers)
    A = 2 / h * np.eye(m) + D + h / 2 * K
    spread = np.linalg.solve(A, B)
    W = actuators.compliance(B.T @ spread)

    def energy():
        gas = sum(energy_of(each, s, u) for each, s, u in zip(gases.values(), B.T @ x, amounts, strict=True))
        return (v @ v + x @ K @ x) / 2 + gas

    for _ in range(20):
        before, free = energy(), np.linalg.solve(A, 2 / h * v - K @ x)
        targets = actuators.targets(amounts, B.T @ x, B.T @ v, h)
        z, _ = actuators.solve(amounts, B.T @ free, W, targets, z, None)
        middle = free + spread @ z
        x, v = x + h * middle, 2 * middle - v
        # A is as ill-conditioned as h² K: what is lost there is no matter of the gas
        tolerance = 1e-13 * max(before, 1.0) * max(np.linalg.cond(A), 100.0)
        assert abs(energy() - before + h * middle @ D @ middle) <= tolerance


def test_no_gas_and_no_volume_are_told():
    actuators = ActuatorForces({"air": "gas"}, {}, {"air": 1}, {"air": Gas(1e-3)})
    one, nothing = np.ones((1, 1)), np.zeros(1)
    for amount, stroke, message in (
        (-1e-3, 0.0, r"chamber 'air': -0.001 m³ of gas are given; use more than -0.001 m³"),
        (0.0, -2e-3, r"chamber 'air' is pressed to -0.001 m³ \(at rest it has 0.001 m³\)"),
    ):
        targets = actuators.targets(np.array([amount]), np.array([stroke]), nothing, 1e-3)
        with pytest.raises(StepError, match=message):
            actuators.solve(nothing, nothing, one, targets, nothing, None)
    targets = actuators.targets(nothing, nothing, nothing, 1.0)
    with pytest.raises(StepError, match=r"chamber 'air' is pressed to nothing within a step"):
        actuators.solve(nothing, np.array([-1e6]), one, targets, nothing, None)


def test_a_choked_valve_lets_in_as_much_each_second():
    """C_d A √(R T) p/p_a φ with φ = 0.68473 of air, until the chamber is at 0.528 of the supply's pressure."""
    gas, supply = Gas(1e-3, orifice=0.6e-6, temperature=293.15), 4e5
    pressure = gas.ambient + supply
    rate = 0.6e-6 * math.sqrt(GAS_CONSTANT * 293.15) * pressure / gas.ambient * math.sqrt(1.4) * (2 / 2.4) ** 3
    assert pytest.approx(0.5283, rel=1e-4) == CHOKED
    assert flow(gas, supply, 0.0) == pytest.approx(rate, rel=1e-14)
    assert flow(gas, supply, 1e5) == flow(gas, supply, 0.0)
    assert 0 < flow(gas, supply, 3.9e5) < rate / 3
    assert flow(gas, 0.0, supply) == -flow(gas, supply, 0.0)
    amount = 0.0
    for _ in range(10):
        amount = let_in(gas, 0.0, amount, supply, 1e-2)
    assert amount == pytest.approx(0.1 * rate, rel=1e-12)


@given(st.floats(-6.0, 3.0), st.floats(-0.9, 5.0), st.floats(-1e5, 5e5))
def test_a_valve_never_leads_beyond_its_supply(time, share, supply):
    gas, start = Gas(1e-3, orifice=1e-6), 1e-3 * share
    end, amount = amount_at(gas, 0.0, supply), start
    for _ in range(5):
        last, amount = amount, let_in(gas, 0.0, amount, supply, 10**time)
        assert min(last, end) - 1e-17 <= amount <= max(last, end) + 1e-17
