"""The validation against dense solves, for every way to damp and to reduce."""

import numpy as np
import pytest
import scipy.linalg
from bodies import sparse
from test_own_matrices import triple_chain

import fenics_rom as fr
from fenics_rom.reduction.validation import minimal_residuals


def measured(system, rom, name):
    """Errors and static error of one contact mode by dense solves, relative as the validation says."""
    identity = np.eye(system.size)
    M, D, K = (A @ identity for A in (system.mass, system.damping, system.stiffness))
    L, B, mode = np.linalg.cholesky(M), system.input_matrix(name), rom.contact_models[name]
    damping = np.diag(mode.damping) if mode.damping.ndim == 1 else mode.damping
    gaps, sizes = [], []
    for ω in [0.0, *mode.frequencies]:
        exact = np.linalg.solve(K + 1j * ω * D - ω**2 * M, B)
        dynamic = np.diag(mode.eigenvalues - ω**2) + 1j * ω * damping
        reduced = rom.basis @ mode.coordinates @ np.linalg.solve(dynamic, mode.inputs)
        gaps.append(np.linalg.norm(L.T @ (exact - reduced)))
        sizes.append(np.linalg.norm(L.T @ exact))
    return np.array(gaps[1:]) / max(sizes[1:]), gaps[0] / sizes[0]


@pytest.fixture(scope="module")
def chain():
    M, D, K, B = triple_chain(40, 0.01, 0.01, 5.0)
    return fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B, "ends": np.eye(121)[:, [0, 120]]})


@pytest.mark.parametrize("method", ["balanced", "modal", "modal+static", "pod"])
@pytest.mark.parametrize("lyapunov", ["closed-form", "krylov"])
@pytest.mark.parametrize("body", ["box_system", "chain"])
def test_validation_measures_the_error(body, method, lyapunov, request):
    system = request.getfixturevalue(body)
    rom = fr.reduce(system, order=8, method=method, lyapunov=lyapunov)
    for name, mode in rom.contact_models.items():
        errors, static = measured(system, rom, name)
        assert len(mode.frequencies) >= 3
        np.testing.assert_allclose(mode.transfer_errors, errors, rtol=0.1, atol=1e-9)
        assert mode.static_error == pytest.approx(static, rel=1e-3, abs=1e-8)
        assert rom.validation[name]["transfer_error"] == mode.transfer_errors.max()


def test_more_inputs_than_can_be_tried_are_combined(box_system):
    nodal = np.random.default_rng(0).standard_normal((box_system.size, 12))
    M, D, K = (sparse(A) for A in (box_system.mass, box_system.damping, box_system.stiffness))
    system = fr.System(mass=M, damping=D, stiffness=K, contacts={"c": nodal})
    rom = fr.reduce(system, order=10)
    errors, _ = measured(system, rom, "c")
    ratio = rom.contact_models["c"].transfer_errors / errors
    assert (ratio > 0.2).all()
    assert (ratio < 5).all()


def test_minimal_residuals_solves_each_column_in_its_own_space():
    random = np.random.default_rng(0)
    columns = random.standard_normal((30, 4)) + 1j * random.standard_normal((30, 4))
    matrices = [np.eye(30) + 0.02 * k * random.standard_normal((30, 30)) for k in range(4)]

    def operator(x):
        return np.stack([A @ x[:, k] for k, A in enumerate(matrices)], axis=1)

    def dot(left, right):
        return np.sum(left.conj() * right, axis=0)

    x = minimal_residuals(operator, columns, dot, np.zeros(4))
    residual = np.linalg.norm(columns - operator(x), axis=0) / np.linalg.norm(columns, axis=0)
    assert (residual <= 0.1).all()
    exact = np.stack([scipy.linalg.solve(A, columns[:, k]) for k, A in enumerate(matrices)], axis=1)
    assert np.linalg.norm(x - exact) <= 0.2 * np.linalg.norm(exact)
