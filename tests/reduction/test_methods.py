"""Methods beside balancing, and methods of one's own: what they span, and that they all switch passively."""

import itertools

import numpy as np
import pytest
import scipy.linalg
from bodies import dense

import fenics_rom as fr
from fenics_rom.errors import SceneError
from fenics_rom.fem.linear_stepper import FullOrderStepper

METHODS = ("balanced", "modal", "modal+static", "pod")


def static_shapes(problem):
    """The simplest method there is."""
    for name in problem.contacts:
        with problem.stages("static shapes"):
            shapes = problem.factor.solve(problem.system.input_matrix(name))
        yield name, problem.directions(shapes)


@pytest.fixture(scope="module")
def eigenvectors(box_system):
    M, K = dense(box_system.mass, box_system.size), dense(box_system.stiffness, box_system.size)
    γ, V = scipy.linalg.eigh(K, M)
    return M, γ, V


def basis(rom, name):
    return rom.basis @ rom.contact_models[name].coordinates


@pytest.mark.parametrize("lyapunov", ["closed-form", "krylov"])
def test_modal_takes_the_lowest_eigenvectors(box_system, eigenvectors, lyapunov):
    M, γ, V = eigenvectors
    rom = fr.reduce(box_system, method="modal", order=7, lyapunov=lyapunov)
    assert rom.method == "modal"
    assert rom.basis.shape[1] == 7
    for mode in rom.contact_models.values():
        np.testing.assert_allclose(mode.eigenvalues, γ[:7], rtol=1e-8)
        assert len(mode.hankel_singular_values) == 0
    W = basis(rom, "right")
    assert np.linalg.norm(W - V[:, :7] @ (V[:, :7].T @ M @ W)) <= 1e-6 * np.linalg.norm(W)


def test_modal_static_is_exact_at_rest(box_system, eigenvectors):
    M, _, V = eigenvectors
    rom = fr.reduce(box_system, method="modal+static", order=9)
    for name, mode in rom.contact_models.items():
        assert mode.order == 9
        assert mode.static_error <= 1e-9
        lowest = V[:, : 9 - mode.inputs.shape[1]]
        W = basis(rom, name)
        assert np.linalg.norm(lowest - W @ (W.T @ M @ lowest)) <= 1e-6 * np.linalg.norm(lowest)


@pytest.mark.slow
def test_pod_follows_the_run_that_it_was_made_from(box_system):
    """The error of a step load, in time, falls as the order rises; against the full order."""
    h, B = 0.002, box_system.input_matrix("right")
    errors = []
    for order in (2, 4, 8, 16):
        rom = fr.reduce(box_system, method="pod", order=order)
        reduced, full = fr.Simulator(rom, dt=h), FullOrderStepper(box_system, h)
        reduced.switch("right")
        gap = size = 0.0
        for _ in range(100):
            reduced.step([0.3, -0.2, 1.0, 0.1])
            full.step_under(B @ np.array([0.3, -0.2, 1.0, 0.1]))
            gap = max(gap, np.abs(reduced.displacement() - full.displacement()).max())
            size = max(size, np.abs(full.displacement()).max())
        full.close()
        errors.append(gap / size)
    assert errors[-1] <= 2e-3
    assert rom.contact_models["top"].static_error <= 1.1e-3  # which velocities alone do not reach
    assert all(later < earlier / 2 for earlier, later in itertools.pairwise(errors)), errors


@pytest.mark.slow
def test_pod_takes_a_tolerance(box_system):
    few, many = (fr.reduce(box_system, method="pod", tolerance=t).contact_models["top"].order for t in (1e-2, 1e-4))
    assert 1 <= few < many < 108


@pytest.mark.parametrize("method", [*METHODS, static_shapes])
def test_every_method_switches_without_making_energy(box_system, method):
    rom = fr.reduce(box_system, method=method, order=6 if isinstance(method, str) else 4)
    body = fr.Simulator(rom, dt=1e-3)
    random = np.random.default_rng(0)
    for _ in range(400):
        before = body.energy
        body.switch(random.choice(list(rom.contact_models)))
        assert body.energy <= before * (1 + 1e-14)
        body.dt = 10.0 ** random.uniform(-6, -1)
        body.step(random.standard_normal(4) * 10.0 ** random.uniform(-3, 3))
    account = body.ledger
    scale = max(account.supplied, body.energy)
    gap = body.energy - account.supplied + account.dissipated + account.lost_in_switching
    assert abs(gap) <= 1e-12 * scale


def test_a_method_of_ones_own_is_a_function(box_system):
    rom = fr.reduce(box_system, method=static_shapes, order=4)
    assert rom.method == "static_shapes"
    assert max(mode.static_error for mode in rom.contact_models.values()) <= 1e-10
    assert "static shapes" in {stage.name for stage in rom.stages}
    assert rom.validation["right"]["neglected"] is None


def with_names(names):
    def method(problem):
        for name in names:
            yield name, problem.directions(problem.factor.solve(problem.system.input_matrix("right")))

    return method


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"method": "modal"}, "eigenvectors have no singular values for a tolerance to leave out; give an order"),
        ({"method": static_shapes}, "this method has no singular values for a tolerance to leave out; give an order"),
        ({"method": "modul", "order": 3}, r"method: no choice 'modul'; .* did you mean 'modal'\?"),
        (
            {"method": "pod", "switching": "oblique"},
            "switching = 'oblique' goes with method = 'balanced', not with 'pod'",
        ),
        ({"method": with_names(["right"]), "order": 2}, "the method gave no directions for contact mode 'top'"),
        ({"method": with_names(["left"]), "order": 2}, "the method gave contact mode 'left', which was not asked for"),
        ({"solver": "magic", "order": 2}, "solver: no choice 'magic'"),
    ],
)
def test_choices_that_do_not_fit_are_refused(box_system, choices, message):
    with pytest.raises(SceneError, match=message):
        fr.reduce(box_system, **choices)
