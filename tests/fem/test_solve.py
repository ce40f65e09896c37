"""The full-order run: the energy account closes to round-off, and the motion is that of the exact exponential."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import PLATE, assembled, box_arrays, dense, write_arrays
from scipy.linalg import expm

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.fem import linear_stepper
from fenics_rom.fem.linear_stepper import FullOrderStepper
from fenics_rom.scene.file import parse_scene

CLOSES_TO = 1e-12  # of the largest energy or work seen


@pytest.fixture(scope="module")
def undamped_plate():
    text = PLATE.read_text().replace("damping = { alpha = 0.5, beta = 1e-3 }", "")
    return fr.assemble(parse_scene(text, folder=PLATE.parent))


@pytest.fixture(scope="module")
def slab(tmp_path_factory):
    """A slab a hundredth as thick as long, degree 2: the eigenvalues of K span ten decades."""
    mesh = write_arrays(tmp_path_factory.mktemp("slab") / "slab.msh", *box_arrays((1.0, 0.4, 0.01), (6, 3, 1)))
    return assembled(mesh, degree=2)


def account_gap(system, steps, ride):
    """Largest gap of the energy account, as a share of the largest energy or work; `ride` gives dt, contact, force."""
    simulator = FullOrderStepper(system, 1e-3)
    columns = {name: system.input_matrix(name) for name in system.contacts}
    gap = scale = 0.0
    for step in range(steps):
        simulator.dt, contact, force = ride(step)
        simulator.step_under(columns[contact] @ force)
        energy, account = simulator.energy, simulator.ledger
        gap = max(gap, abs(energy - account.supplied + account.dissipated + account.lost_in_switching))
        scale = max(scale, energy, abs(account.supplied), account.dissipated)
    simulator.close()
    assert scale > 0
    return gap / scale


@pytest.mark.parametrize("steps", [1000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_account_closes_over_thousands_of_rough_steps(plate_system, steps):
    """Random forces, random step sizes from 1e-6 to 1e-1 s, random changes of the contact mode."""
    random = np.random.default_rng(0)
    forces = random.standard_normal((steps, 3)) * 10 ** random.uniform(-3, 3, (steps, 1))
    sizes = 10 ** random.uniform(-6, -1, steps)
    names = random.choice(list(plate_system.contacts), steps)
    assert account_gap(plate_system, steps, lambda k: (sizes[k], names[k], forces[k])) <= CLOSES_TO


@pytest.mark.parametrize("system", ["plate_system", "undamped_plate", "slab"])
@pytest.mark.parametrize("dt", [1e-3, 2e-2])
def test_account_closes_under_smooth_loads(request, system, dt):
    """Slow bending: the large terms of K x cancel, and the work is small beside what round-off of them would be."""
    system = request.getfixturevalue(system)
    first, second = system.contacts

    def ride(step):
        push = np.sin(np.pi * step / 300) ** 2 if step < 600 else 0.0
        return dt, first if step < 300 else second, np.array([0.0, 0.0, 1e-3 * push])

    assert account_gap(system, 900, ride) <= 5 * CLOSES_TO


def test_undamped_body_keeps_its_energy(undamped_plate):
    simulator = FullOrderStepper(undamped_plate, 5e-3)
    still = np.zeros(undamped_plate.size)
    simulator.set_state(still, np.random.default_rng(0).standard_normal(undamped_plate.size))
    start, B = simulator.energy, undamped_plate.input_matrix("middle")
    for _ in range(1000):
        simulator.step_under(B @ np.zeros(3))
    assert simulator.energy == pytest.approx(start, rel=CLOSES_TO)
    assert simulator.ledger.dissipated == 0.0
    simulator.close()


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    mesh = write_arrays(tmp_path_factory.mktemp("small") / "box.msh", *box_arrays((1.0, 0.4, 0.3), (2, 1, 1)))
    return assembled(mesh)


@pytest.mark.parametrize("damping", [(1.0, 1e-3), (0.0, 0.0)], ids=["damped", "undamped"])
def test_order_of_accuracy_is_two(small, damping):
    """Against the exponential of the whole first-order system, from a moving start, under a constant force."""
    α, β = damping
    system = replace(small, rayleigh=damping)
    n, end, u = system.size, 0.1, np.array([1.0, -2.0, 3.0])
    M, K, B = dense(system.mass, n), dense(system.stiffness, n), system.input_matrix("right")
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, α * M + β * K)]])
    x, v = np.linalg.solve(K, B @ [0.0, 1.0, 1.0]), np.linalg.solve(K, B @ [30.0, 0.0, 10.0])
    flow, forced = expm(end * A), np.concatenate([np.zeros(n), np.linalg.solve(M, B @ u)])
    exact = flow @ np.concatenate([x, v]) + np.linalg.solve(A, (flow - np.eye(2 * n)) @ forced)
    weight = np.concatenate([np.ones(n), np.full(n, 0.01)])
    errors = []
    for steps in (400, 800, 1600):
        simulator = FullOrderStepper(system, end / steps)
        simulator.set_state(x, v)
        for _ in range(steps):
            simulator.step_under(B @ u)
        simulator.close()
        errors.append(np.linalg.norm(weight * (np.concatenate([simulator.x, simulator.v])[:, 0] - exact)))
        assert simulator.time == pytest.approx(end, rel=1e-12)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((orders >= 1.9) & (orders <= 2.1)).all(), (orders, errors)


def test_step_solves_the_equation_of_the_paper(small):
    """(2)-(3): M (v⁺ - v)/h + D v̂ + K (x⁺ + x)/2 = B u, with v̂ = (v⁺ + v)/2 = (x⁺ - x)/h."""
    random = np.random.default_rng(0)
    M, K, D = (dense(matrix, small.size) for matrix in (small.mass, small.stiffness, small.damping))
    B = small.input_matrix("top")
    for h in (1e-6, 1e-3, 1.0):
        simulator = FullOrderStepper(small, h)
        x, v = random.standard_normal((2, small.size, 1))
        u = random.standard_normal(3)
        simulator.set_state(x, v)
        simulator.step_under(B @ u)
        mean = (simulator.v + v) / 2
        residual = M @ (simulator.v - v) / h + D @ mean + K @ (simulator.x + x) / 2 - (B @ u)[:, None]
        assert np.abs(residual).max() <= 1e-12 * max(np.abs(M @ v).max() / h, np.abs(K @ x).max())
        assert np.abs(simulator.x - x - h * mean).max() <= 1e-12 * np.abs(x).max()
        energy = (simulator.v.T @ M @ simulator.v + simulator.x.T @ K @ simulator.x).item() / 2
        assert simulator.energy == pytest.approx(energy, rel=1e-11)
        simulator.close()


def test_force_that_stays_ends_in_static_balance(small):
    simulator, B = FullOrderStepper(replace(small, rayleigh=(20.0, 1e-2)), 0.02), small.input_matrix("top")
    for _ in range(1000):
        simulator.step_under(B @ np.array([0.0, 0.0, 5.0]))
    simulator.close()
    static = np.linalg.solve(dense(small.stiffness, small.size), B @ [0.0, 0.0, 5.0])
    np.testing.assert_allclose(simulator.x[:, 0], static, atol=1e-10 * np.abs(static).max())


def test_there_is_one_factorisation_for_each_step_size(small, monkeypatch):
    made = []

    class Counted(linear_stepper.PetscFactor):
        def __init__(self, *arguments, **choices):
            super().__init__(*arguments, **choices)
            made.append(self)

    monkeypatch.setattr(linear_stepper, "PetscFactor", Counted)
    simulator, B = FullOrderStepper(small, 1e-3), small.input_matrix("top")
    for dt, factors in ((1e-3, 1), (2e-3, 2), (1e-3, 3)):
        simulator.dt = dt
        for _ in range(5):
            simulator.step_under(B @ np.ones(3))
        assert len(made) == factors
    simulator.close()


@pytest.mark.parametrize("force", [np.nan, np.inf, 1e308])
def test_force_that_is_not_finite_leaves_the_state_as_it_was(small, force):
    simulator, B = FullOrderStepper(small, 1e-3), small.input_matrix("top")
    simulator.step_under(B @ np.ones(3))
    before = simulator.x.copy(), simulator.v.copy(), simulator.energy, simulator.time, simulator.ledger.sums
    with np.errstate(all="ignore"), pytest.raises(StepError, match="step overflows"):
        simulator.step_under((B * 1e10) @ np.array([0.0, 0.0, force]))
    assert np.array_equal(simulator.x, before[0])
    assert np.array_equal(simulator.v, before[1])
    assert (simulator.energy, simulator.time, simulator.ledger.sums) == before[2:]
    simulator.close()


def test_run_of_the_scene_keeps_its_account(plate_system):
    run = fr.simulate(plate_system)
    assert run.balance_error <= CLOSES_TO
    assert run.model == "full"
    assert run.steps == 3000
    assert run.supplied[-1] > 0
    assert np.abs(run.outputs["tip"]).max() > 1e-3
    assert np.abs(run.outputs["tip"][-1]).max() < np.abs(run.outputs["tip"]).max() / 2  # released, and damped
