"""The step against the exact exponential and against linear algebra that knows nothing of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import fenics_rom as fr
from fenics_rom.rom import Mode
from fenics_rom.runtime.midpoint import Midpoint


def three_modes():
    """With proportional damping, dense damping, none."""
    random = np.random.default_rng(0)
    γ, G = np.array([4.0, 25.0, 90.0]), random.standard_normal((3, 2))
    root = random.standard_normal((3, 3))
    dampings = (0.3 + 0.01 * γ, root @ root.T, np.zeros(3))
    return [Mode(γ, damping, G, np.eye(3), np.eye(3), np.ones(3)) for damping in dampings]


MODES = three_modes()


def final_state(mode, h, steps, u):
    stepper, q, r = Midpoint(mode, h), np.zeros(mode.order), np.ones(mode.order)
    for _ in range(steps):
        v = stepper.representative_velocity(q, r, mode.inputs @ u).copy()
        q, r = q + h * v, 2 * v - r
    return np.concatenate([q, r])


@pytest.mark.parametrize("mode", MODES, ids=("proportional", "dense", "undamped"))
def test_order_of_accuracy_is_two(mode):
    m, u, end = mode.order, np.array([1.0, -2.0]), 1.0
    D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.diag(mode.eigenvalues), -D]])
    forced = np.concatenate([np.zeros(m), mode.inputs @ u])
    start = np.concatenate([np.zeros(m), np.ones(m)])
    exact = expm(end * A) @ start + np.linalg.solve(A, (expm(end * A) - np.eye(2 * m)) @ forced)
    errors = [np.linalg.norm(final_state(mode, end / n, n, u) - exact) for n in (400, 800, 1600)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((orders >= 1.9) & (orders <= 2.1)).all(), orders


@pytest.mark.parametrize("mode", MODES, ids=("proportional", "dense", "undamped"))
def test_step_solves_the_equation_of_the_paper(mode):
    """(2)-(3): M (v⁺ - v)/h + D v̂ + K (x⁺ + x)/2 = B u, with v̂ = (v⁺ + v)/2 = (x⁺ - x)/h."""
    random = np.random.default_rng(1)
    D = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    for h in (1e-6, 1e-3, 1.0):
        q, r, force = random.standard_normal((3, mode.order))
        v = Midpoint(mode, h).representative_velocity(q, r, force)
        after_q, after_r = q + h * v, 2 * v - r
        residual = (after_r - r) / h + D @ v + mode.eigenvalues * (after_q + q) / 2 - force
        assert np.abs(residual).max() <= 1e-13 * (np.abs(r).max() / h + np.abs(mode.eigenvalues * q).max())


def test_undamped_energy_is_kept_for_ever():
    mode = MODES[2]
    stepper, h = Midpoint(mode, 0.05), 0.05
    q, r, force = np.zeros(3), np.ones(3), np.zeros(3)
    for _ in range(100_000):
        v = stepper.representative_velocity(q, r, force)
        r = 2 * v - r
        q = q + h * v
    assert (r @ r + q @ (mode.eigenvalues * q)) / 3 == pytest.approx(1, abs=1e-11)


def test_dense_and_diagonal_damping_agree(box_system):
    diagonal = fr.reduce(box_system, order=10)
    simulators = []
    for dense in (False, True):
        made = {
            name: replace(mode, damping=np.diag(mode.damping) if dense else mode.damping)
            for name, mode in diagonal.modes.items()
        }
        simulator = fr.Simulator(replace(diagonal, modes=made), dt=1e-2)
        for step in range(200):
            simulator.switch(("right", "top")[step // 50 % 2])
            simulator.step([0.1, 0.2, 0.3, -1.0])
        simulators.append(simulator)
    one, other = simulators
    np.testing.assert_allclose(one.state, other.state, rtol=1e-9, atol=1e-12)
    assert one.ledger.dissipated == pytest.approx(other.ledger.dissipated, rel=1e-9)
