"""The step against the exact exponential and against linear algebra that knows nothing of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import fenics_rom as fr
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.midpoint import LARGEST_FUSED_ORDER, FusedMidpoint, StagedMidpoint, fastest_kernel


def three_modes():
    """With proportional damping, dense damping, none."""
    random = np.random.default_rng(0)
    γ, G = np.array([4.0, 25.0, 90.0]), random.standard_normal((3, 2))
    root = random.standard_normal((3, 3))
    dampings = (0.3 + 0.01 * γ, root @ root.T, np.zeros(3))
    return [ContactModel(γ, damping, G, np.eye(3), np.eye(3), np.ones(3)) for damping in dampings]


MODES = three_modes()
each_mode = pytest.mark.parametrize("mode", MODES, ids=("proportional", "dense", "undamped"))
each_form = pytest.mark.parametrize("form", [FusedMidpoint, StagedMidpoint])


def dense(mode):
    return np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping


def started(form, mode, h, q, r):
    stepper = form(mode, EnergyLedger())
    stepper.set_time_step(h)
    stepper.state[:] = np.concatenate([np.sqrt(mode.eigenvalues) * q, r])
    return stepper


def booked(stepper):
    stepper.flush()
    return stepper._ledger


def displacement_and_velocity(stepper, mode):
    e, r = stepper.state.reshape(2, -1)
    return e / np.sqrt(mode.eigenvalues), r.copy()


@each_form
@each_mode
def test_order_of_accuracy_is_two(mode, form):
    m, u, end = mode.order, np.array([1.0, -2.0]), 1.0
    A = np.block([[np.zeros((m, m)), np.eye(m)], [-np.diag(mode.eigenvalues), -dense(mode)]])
    forced = np.concatenate([np.zeros(m), mode.inputs @ u])
    start = np.concatenate([np.zeros(m), np.ones(m)])
    exact = expm(end * A) @ start + np.linalg.solve(A, (expm(end * A) - np.eye(2 * m)) @ forced)

    def error(steps):
        stepper = started(form, mode, end / steps, np.zeros(m), np.ones(m))
        for _ in range(steps):
            stepper.step(u)
        return np.linalg.norm(np.concatenate(displacement_and_velocity(stepper, mode)) - exact)

    errors = [error(n) for n in (400, 800, 1600)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((orders >= 1.9) & (orders <= 2.1)).all(), orders


@each_form
@each_mode
def test_step_solves_the_equation_of_the_paper(mode, form):
    """(2)-(3): M (v⁺ - v)/h + D v̂ + K (x⁺ + x)/2 = B u, with v̂ = (v⁺ + v)/2 = (x⁺ - x)/h."""
    random = np.random.default_rng(1)
    for h in (1e-6, 1e-3, 1.0):
        (q, r), u = random.standard_normal((2, mode.order)), random.standard_normal(2)
        stepper = started(form, mode, h, q, r)
        twice_energy = stepper.step(u)
        after_q, after_r = displacement_and_velocity(stepper, mode)
        assert twice_energy == pytest.approx(after_r @ after_r + after_q @ (mode.eigenvalues * after_q), rel=1e-14)
        v, force = (after_r + r) / 2, mode.inputs @ u
        residual = (after_r - r) / h + dense(mode) @ v + mode.eigenvalues * (after_q + q) / 2 - force
        scale = np.abs(r).max() / h + np.abs(mode.eigenvalues * q).max()
        assert np.abs(residual).max() <= 1e-13 * scale
        assert np.abs(after_q - q - h * v).max() <= 1e-14 * (np.abs(q).max() + h * np.abs(r).max())
        ledger = booked(stepper)
        assert ledger.supplied == pytest.approx(h * force @ v, rel=1e-9)
        assert ledger.dissipated == pytest.approx(h * v @ dense(mode) @ v, rel=1e-9)
        stepper.rollback()
        np.testing.assert_allclose(displacement_and_velocity(stepper, mode), [q, r], rtol=2e-15)


@each_form
def test_undamped_energy_is_kept_for_ever(form):
    stepper = started(form, MODES[2], 0.05, np.zeros(3), np.ones(3))
    for _ in range(100_000):
        twice = stepper.step(np.zeros(2))
    assert twice / 3 == pytest.approx(1, abs=100_000 * 3 * np.finfo(float).eps)  # what rounds a step is the same in all


@pytest.mark.parametrize("damping", ["diagonal", "dense"])
@pytest.mark.parametrize("m", [1, 20, 164])
def test_every_form_gives_the_same_numbers(m, damping):
    """To round-off, over 300 steps of changing size."""
    random = np.random.default_rng(m)
    γ = np.sort(10 ** random.uniform(0, 8, m))
    root = random.standard_normal((m, m))
    D = 0.1 + 1e-4 * γ if damping == "diagonal" else root @ root.T
    mode = ContactModel(γ, D, random.standard_normal((m, 3)), np.eye(m), np.eye(m), np.ones(m))
    one, other = (started(form, mode, 1e-3, *np.zeros((2, m))) for form in (FusedMidpoint, StagedMidpoint))
    largest = 0.0
    for step in range(300):
        u = random.standard_normal(3)
        if step % 30 == 0:
            h = 10 ** random.uniform(-6, -1)
            one.set_time_step(h)
            other.set_time_step(h)
        one.step(u)
        other.step(u)
        largest = max(largest, np.linalg.norm(one.state))
        assert np.linalg.norm(one.state - other.state) <= 1e-12 * largest
        if step % 7 == 0:  # in between, works wait to be booked
            sums, others = (np.array(booked(form).sums)[:2, 0] for form in (one, other))
            np.testing.assert_allclose(sums, others, rtol=1e-9, atol=1e-12 * largest**2)


def test_the_form_is_chosen_by_order_and_damping():
    def form(m, dimensions):
        shape = (m,) * dimensions
        damping = np.ones(m) if len(shape) == 1 else np.eye(m)
        return type(
            fastest_kernel(ContactModel(np.ones(m), damping, np.ones((m, 1)), np.eye(m), np.eye(m), np.ones(m)), None)
        )

    for dimensions, largest in LARGEST_FUSED_ORDER.items():
        assert form(largest, dimensions) is FusedMidpoint
        assert form(largest + 1, dimensions) is StagedMidpoint


def test_dense_and_diagonal_damping_agree(box_system):
    diagonal = fr.reduce(box_system, order=10)
    simulators = []
    for dense in (False, True):
        made = {
            name: replace(mode, damping=np.diag(mode.damping) if dense else mode.damping)
            for name, mode in diagonal.contact_models.items()
        }
        simulator = fr.Simulator(replace(diagonal, contact_models=made), dt=1e-2)
        for step in range(200):
            simulator.switch(("right", "top")[step // 50 % 2])
            simulator.step([0.1, 0.2, 0.3, -1.0])
        simulators.append(simulator)
    one, other = simulators
    np.testing.assert_allclose(one.state, other.state, rtol=1e-9, atol=1e-12)
    assert one.ledger.dissipated == pytest.approx(other.ledger.dissipated, rel=1e-9)
