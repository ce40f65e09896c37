"""Gramians: closed forms against dense Lyapunov solvers, and against what they mean."""

import numpy as np
import pytest
from scipy.linalg import eigh, expm

from fenics_rom.errors import SolverError
from fenics_rom.reduction.gramians import gramian_factors, square_root, textbook_gramians

DAMPINGS = {"heavy": (0.5, 1e-2), "light": (0.1, 1e-6), "alpha only": (1.0, 0.0), "beta only": (0.0, 1e-3)}


def relative(one, other):
    return np.abs(one - other).max() / np.abs(other).max()


def controllability(γ, damping, G):
    Z, _ = gramian_factors(γ, damping, G, np.eye(len(γ)))
    return Z @ Z.T


def observability(γ, damping, weight):
    _, Y = gramian_factors(γ, damping, np.ones((len(γ), 1)), weight)
    return Y @ Y.T


def matrices(system):
    identity = np.eye(system.size)
    return system.mass @ identity, system.stiffness @ identity


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
@pytest.mark.parametrize("weighting", ["mass", "nodal", "output"])
def test_closed_forms_agree_with_the_dense_lyapunov_solver(box_system, damping, weighting):
    α, β = damping
    M, K = matrices(box_system)
    γ, V = eigh(K, M)
    C = {"mass": np.linalg.cholesky(M), "nodal": np.eye(len(M)), "output": box_system.contacts["top"]}[weighting]
    B = box_system.input_matrix("right")
    Wc, Wo = textbook_gramians(M, α * M + β * K, K, B, C @ C.T)
    MV = M @ V
    assert relative(MV @ controllability(γ, α + β * γ, V.T @ B) @ MV.T, M @ Wc @ M) <= 1e-7
    weight = V.T @ C @ C.T @ V
    assert relative(MV @ observability(γ, α + β * γ, weight) @ MV.T, Wo) <= 1e-7


def test_observability_of_the_mass_weighted_shape_has_the_closed_form_of_the_matrices(box_system):
    """β/2 M + α/2 M K⁻¹ M + ½ M D⁻¹ M, without eigenvectors."""
    α, β = 0.7, 2e-3
    M, K = matrices(box_system)
    γ, V = eigh(K, M)
    exact = β / 2 * M + α / 2 * M @ np.linalg.solve(K, M) + M @ np.linalg.solve(α * M + β * K, M) / 2
    MV = M @ V
    assert relative(MV @ observability(γ, α + β * γ, np.eye(len(M))) @ MV.T, exact) <= 1e-9


@pytest.mark.parametrize("strength", [1e-3, 1.0, 100.0])
def test_dense_damping_agrees_with_the_textbook(strength):
    random = np.random.default_rng(0)
    γ, G, C = np.array([1.0, 9.0, 30.0, 200.0]), random.standard_normal((4, 2)), random.standard_normal((4, 3))
    root = random.standard_normal((4, 4))
    D = strength * root @ root.T
    Wc, Wo = textbook_gramians(np.eye(4), D, np.diag(γ), G, C @ C.T)
    assert relative(controllability(γ, D, G), Wc) <= 1e-9
    assert relative(observability(γ, D, C @ C.T), Wo) <= 1e-9


def test_gramians_are_the_energies_that_they_stand_for():
    """Wc = ∫ x xᵀ dt after an impulse; x₀ᵀ Wo x₀ = ∫ |y|² dt from rest at x₀: by quadrature."""
    γ, d, g = np.array([4.0, 30.0]), np.array([0.8, 1.1]), np.array([[1.0], [-2.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(γ), -np.diag(d)]])
    h, steps = 0.002, 20_000
    flow = expm(h * A)
    impulse, rest = np.concatenate([np.zeros((2, 1)), g]), np.array([[0.3], [-1.0], [0.0], [0.0]])
    Wc, seen = np.zeros((2, 2)), 0.0
    for step in range(steps + 1):
        simpson = h / 3 * (1 if step in (0, steps) else 4 if step % 2 else 2)
        Wc += simpson * impulse[:2] @ impulse[:2].T
        seen += simpson * float(rest[0, 0] + 2 * rest[1, 0]) ** 2
        impulse, rest = flow @ impulse, flow @ rest
    c = np.array([1.0, 2.0])
    start = np.array([0.3, -1.0])
    assert relative(controllability(γ, d, g), Wc) <= 1e-8
    assert start @ observability(γ, d, np.outer(c, c)) @ start == pytest.approx(seen, rel=1e-8)


def test_square_roots_are_as_accurate_in_their_small_columns_as_in_their_large_ones():
    """Of a Gramian whose entries span 24 decades, as those of heavily damped bodies do."""
    scale = np.logspace(0, -12, 13)
    root = np.tril(np.random.default_rng(0).uniform(0.5, 1.0, (13, 13)))
    W = scale[:, None] * (root @ root.T) * scale
    Z = square_root(W, noise=0.0)
    assert Z.shape == (13, 13)
    assert np.abs(Z @ Z.T / W - 1).max() <= 1e-12


def test_noise_is_left_out_of_square_roots():
    root = np.random.default_rng(0).standard_normal((30, 4))
    assert square_root(root @ root.T).shape == (30, 4)


@pytest.mark.parametrize(
    "damping", [np.zeros(3), np.array([1.0, 0.0, 1.0]), np.zeros((3, 3)), np.diag([1.0, 0.0, 1.0])]
)
def test_undamped_motions_have_no_gramians(damping):
    with pytest.raises(SolverError, match="needs damping of every motion"):
        gramian_factors(np.array([1.0, 4.0, 9.0]), damping, np.ones((3, 1)), np.eye(3))


def test_one_dashpot_that_all_motions_feel_is_damping_enough():
    γ, G = np.array([1.0, 4.0, 9.0]), np.ones((3, 1))
    D = np.outer(*[[0.3, -0.2, 0.4]] * 2)
    Wc, Wo = textbook_gramians(np.eye(3), D, np.diag(γ), G, np.eye(3))
    assert relative(controllability(γ, D, G), Wc) <= 1e-9
    assert relative(observability(γ, D, np.eye(3)), Wo) <= 1e-9


def test_numbers_beyond_floating_point_are_an_error_of_the_solver():
    with pytest.raises(SolverError, match="too large for double precision"):
        gramian_factors(np.array([1.0, 4.0]), np.diag([1.0, np.inf]), np.ones((2, 1)), np.eye(2))
