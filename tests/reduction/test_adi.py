"""LR-ADI: against Gramians of many digits, against plain complex ADI, and against the equation it solves.

Dense Gramians of double precision know σ² to a share of σ_1², so that of σ of 1e-8 nothing is left; the factor that
ADI builds knows σ itself. The references here are dense Gramians of fifty digits.
"""

from contextlib import closing
from decimal import Decimal, localcontext
from itertools import islice

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from bodies import assembled, box_arrays, sparse, write_arrays
from test_own_matrices import triple_chain

import fenics_rom as fr
from fenics_rom.errors import SolverError
from fenics_rom.reduction import adi
from fenics_rom.reduction.adi import (
    Residual,
    apply_shift,
    independent_columns,
    low_rank_gramians,
    projected_observability,
    select_shifts,
)
from fenics_rom.system.scipy_backend import MatrixFactor

PROPORTIONAL = {"heavy": (0.5, 1e-2), "light": (0.1, 1e-6), "alpha only": (1.0, 0.0), "beta only": (0.0, 1e-3)}


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """M, K and B of a box, n = 81, and of a beam, n = 36, out of a real assembly."""
    found = {}
    for name, lengths, bricks in (("box", (1.0, 0.4, 0.3), (3, 2, 2)), ("beam", (0.3, 0.04, 0.03), (3, 1, 1))):
        path = tmp_path_factory.mktemp(name) / "body.msh"
        system = assembled(write_arrays(path, *box_arrays(lengths, bricks, shake=0.1)))
        found[name] = sparse(system.mass), sparse(system.stiffness), system.input_matrix("right")
    return found


def own_system(M, D, K, B):
    return fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B})


def proportional(body, damping):
    (M, K, B), (α, β) = body, damping
    return own_system(M, α * M + β * K, K, B)


def whole_space(system):
    return adi._diagonalized(system, system.algebra.eigenpairs(system.mass, system.stiffness, system.size)[1])


def state_matrix(ω, D):
    """Of the state (ω q, r)."""
    return np.block([[np.zeros_like(D), np.diag(ω)], [-np.diag(ω), -D]])


def observability(space):
    """Wo of the mass-weighted shape, projected."""
    ω, k, d = np.sqrt(space.eigenvalues), len(space.eigenvalues), space.damping
    if d.ndim == 1:
        return np.diag(d / (2 * ω**2) + 1 / (2 * d))
    seen = scipy.linalg.block_diag(np.diag(ω**-2), np.zeros((k, k)))
    Wo = scipy.linalg.solve_continuous_lyapunov(state_matrix(ω, d).T, -seen)[:k, :k] * ω[:, None] * ω
    return (Wo + Wo.T) / 2


def converged(system, B, augmentation=None):
    """σ and the Gramian when a sweep changes no σ above 1e-11 of the largest by more than 1e-9 of it."""
    previous = np.empty(0)
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        for gramian in low_rank_gramians(system, factor, B, augmentation):
            Wo = (
                projected_observability(system, factor, gramian.space.basis)
                if system.rayleigh
                else observability(gramian.space)
            )
            Y = np.linalg.cholesky(Wo)
            σ = np.linalg.svd(Y.T @ gramian.factor, compute_uv=False)
            count = int(np.sum(σ > 1e-11 * σ[0]))
            if len(previous) >= count and (np.abs(previous[:count] - σ[:count]) <= 1e-9 * σ[:count]).all():
                return σ, gramian
            previous = σ
    raise AssertionError("not converged")


def digits(array):
    return np.vectorize(Decimal, otypes=[object])(array)


def decimal_root(W):
    """Z with Z Zᵀ = W by Cholesky's method with the largest pivot first, in many digits."""
    W, columns, first = W.copy(), [], max(W.diagonal())
    while len(columns) < len(W) and max(W.diagonal()) > first * Decimal("1e-34"):
        pivot = int(np.argmax(W.diagonal()))
        columns.append(W[:, pivot] / W[pivot, pivot].sqrt())
        W = W - np.outer(columns[-1], columns[-1])
    return np.array(columns).T


def exact_singular_values(system, B):
    """σ of the mass-weighted shape from dense Gramians of about forty digits."""
    whole = whole_space(system)
    G = system.algebra.inner(whole.basis, B)
    with localcontext() as context:
        context.prec = 50
        of_many_digits = _closed_gramians if whole.damping.ndim == 1 else _refined_gramians
        Wc, Wo = of_many_digits(whole.eigenvalues, whole.damping, G)
        return np.linalg.svd((decimal_root(Wo).T @ decimal_root(Wc)).astype(float), compute_uv=False)


def _closed_gramians(γ, d, G):
    γ, d, G = digits(γ), digits(d), digits(G)
    sums, cross = d[:, None] + d, d[:, None] * γ
    Wc = (G @ G.T) * sums / (sums * (cross + cross.T) + (γ[:, None] - γ) ** 2)
    return Wc, np.diag(d / (2 * γ) + 1 / (2 * d)) + digits(np.zeros((len(d), len(d))))


def _refined_gramians(γ, D, G):
    ω, k = np.sqrt(γ), len(γ)
    A = state_matrix(ω, D)
    forced, seen = np.zeros((2 * k, 2 * k)), np.zeros((2 * k, 2 * k))
    forced[k:, k:] = G @ G.T
    seen[:k, :k] = np.diag(1 / γ)
    ω = digits(ω)
    return (
        _refined_lyapunov(A, forced)[:k, :k] / ω[:, None] / ω,
        _refined_lyapunov(A.T, seen)[:k, :k] * ω[:, None] * ω,
    )


def _refined_lyapunov(A, Q):
    """P with A P + P Aᵀ + Q = 0: what a solution of 16 digits lacks is solved for again, of a residual of 50 digits."""
    exact, left = digits(A), digits(Q)
    P = 0 * left
    for _ in range(4):
        size = np.abs(left).max()
        P = P + digits(scipy.linalg.solve_continuous_lyapunov(A, -(left / size).astype(float))) * size
        P = (P + P.T) / 2
        AP = exact @ P
        left = AP + AP.T + digits(Q)
    assert np.abs(left).max() < Decimal("1e-36")
    return P


def assert_agreement(σ, exact):
    count = int(np.sum(exact > 1e-8 * exact[0]))
    assert count >= 8
    np.testing.assert_allclose(σ[:count], exact[:count], rtol=1e-6)


@pytest.mark.parametrize("columns", [1, pytest.param(3, marks=pytest.mark.slow), 30])
@pytest.mark.parametrize("damping", PROPORTIONAL.values(), ids=PROPORTIONAL)
def test_proportional_damping(bodies, damping, columns):
    system = proportional(bodies["box"], damping)
    B = bodies["box"][2][:, -columns:]
    if columns > B.shape[1]:
        B = np.random.default_rng(0).standard_normal((system.size, columns))
    σ, gramian = converged(system, B)
    assert_agreement(σ, exact_singular_values(system, B))
    assert gramian.factor.dtype == gramian.space.basis.dtype == float
    assert gramian.factor.shape[1] <= gramian.space.basis.shape[1] <= system.size  # memory is bounded
    assert gramian.shifts <= (72 if damping[1] > 1e-4 else 152)
    assert gramian.residual <= 1e-7
    assert gramian.remaining <= 1e-7


@pytest.mark.parametrize("strength", [0.5, 50.0])
def test_local_dashpots(bodies, strength):
    M, K, B = bodies["beam"]
    dashpots = np.zeros(M.shape[0])
    dashpots[[1, 20, 34]] = strength
    system = own_system(M, 0.5 * M + 1e-4 * K + scipy.sparse.diags(dashpots), K, B)
    assert system.rayleigh is None
    σ, _ = converged(system, B)
    assert_agreement(σ, exact_singular_values(system, B))


@pytest.mark.parametrize("v", [0.0, 5.0])
@pytest.mark.parametrize("damping", [0.2, 0.002])
def test_triple_chain(v, damping):
    M, D, K, B = triple_chain(8, damping, damping, v)
    system = own_system(M, D, K, B)
    σ, _ = converged(system, B)
    assert_agreement(σ, exact_singular_values(system, B))


def test_dashpots_keep_the_input_company():
    """With other damping Wo is projected; dashpots turn motions into others, which the span of the factor lacks."""
    M, D, K, B = triple_chain(60, 0.5, 0.1, 5.0)
    system = own_system(M, D, K, B)
    whole = whole_space(system)
    Y = np.linalg.cholesky(observability(whole))
    errors = []
    for augmentation in (None, np.eye(system.size)[:, [0, 59, 120]]):
        σ, gramian = converged(system, B, augmentation)
        assert gramian.space.basis.shape[1] < system.size
        exact = np.linalg.svd(Y.T @ whole.basis.T @ (M @ gramian.space.basis) @ gramian.factor, compute_uv=False)
        errors.append(np.abs(σ / exact - 1)[exact > 1e-8 * exact[0]].max())
    assert errors[0] > 1e-4
    assert errors[1] <= 1e-9


def test_company_is_not_in_the_gramian(bodies):
    system = proportional(bodies["box"], (0.5, 1e-2))
    B = bodies["box"][2]
    augmentation = 1e6 * B[:, :1] + np.eye(len(B))[:, 3:5]
    alone, (together, gramian) = (
        converged(system, B[:, 1:], augmentation[:, :0])[0],
        converged(system, B[:, 1:], augmentation),
    )
    assert_agreement(together, alone)
    assert gramian.factor.shape[1] <= gramian.space.basis.shape[1]


def first_order(system):
    identity = np.eye(system.size)
    M, D, K = (A @ identity for A in (system.mass, system.damping, system.stiffness))
    zero = 0 * identity
    return np.block([[identity, zero], [zero, M]]), np.block([[zero, identity], [-K, -D]])


def test_steps_are_those_of_plain_complex_adi(bodies):
    system = proportional(bodies["beam"], (0.5, 1e-2))
    E, A = first_order(system)
    B, n = bodies["beam"][2], system.size
    residual = Residual(np.zeros_like(B), B)
    F = np.vstack([np.zeros_like(B), B])
    W, Z, P = F.astype(complex), np.empty((n, 0)), np.zeros((2 * n, 2 * n))
    for μ in (-3.0 + 20.0j, -40.0 + 0.0j, -0.5 + 300.0j):
        block, residual = apply_shift(system, residual, μ)
        Z = np.hstack([Z, block])
        for shift in (μ, np.conj(μ)) if μ.imag else (μ,):
            V = np.linalg.solve(A + shift * E, W)
            W = W - 2 * shift.real * E @ V
            P = P - 2 * shift.real * (V @ V.conj().T).real
        carried = np.vstack([residual.motion, residual.force])
        np.testing.assert_allclose(carried, W.real, atol=1e-9 * np.abs(W).max())
        np.testing.assert_allclose(Z @ Z.T, P[:n, :n], atol=1e-9 * np.abs(P[:n, :n]).max())
        left = A @ P @ E.T + E @ P @ A.T + F @ F.T
        np.testing.assert_allclose(carried @ carried.T, left, atol=1e-9 * np.abs(left).max())
    assert Z.dtype == float
    assert Z.shape == (n, 15)


def test_energy_of_the_residual_falls_with_any_shift(bodies):
    system = proportional(bodies["beam"], (0.5, 1e-4))
    E, A = first_order(system)
    B, n = bodies["beam"][2], system.size
    K = system.stiffness @ np.eye(n)
    residual = Residual(np.zeros_like(B), B)
    random = np.random.default_rng(1)
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        energies = [residual.energy(system, factor)]
        assert energies[0] == pytest.approx(np.trace(B.T @ np.linalg.solve(K, B)))
        for _ in range(20):
            μ = complex(-(10 ** random.uniform(-1, 3)), random.choice([0.0, 10 ** random.uniform(0, 3)]))
            residual = apply_shift(system, residual, μ)[1]
            energies.append(residual.energy(system, factor))
        rest = np.linalg.solve(A, np.vstack([residual.motion, residual.force]))
    assert (np.diff(energies) < 0).all()
    norm = scipy.linalg.block_diag(K, E[n:, n:])
    assert energies[-1] == pytest.approx(np.trace(rest.T @ norm @ rest), rel=1e-8)


def test_residual_of_the_gramian_is_relative(bodies):
    system = proportional(bodies["beam"], PROPORTIONAL["light"])
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        B = bodies["beam"][2]
        found = [(g.shifts, g.residual) for g in islice(low_rank_gramians(system, factor, B), 4)]
        scaled = [g.residual for g in islice(low_rank_gramians(system, factor, 7 * B), 4)]
    counts, residuals = zip(*found, strict=True)
    assert counts == (8, 16, 24, 32)
    assert residuals[0] < 1
    assert (np.diff(residuals) < 0).all()
    np.testing.assert_allclose(scaled, residuals, rtol=1e-3)


def test_dependent_columns_cost_nothing(bodies):
    B = bodies["box"][2]
    wide = np.hstack([B, 3 * B[:, :1] - B[:, 1:2], 0 * B[:, :1], 1e-7 * np.eye(len(B))[:, 5:6]])
    system = proportional(bodies["box"], (0.5, 1e-2))
    narrow = independent_columns(system, wide)
    assert narrow.shape == (len(B), 4)
    np.testing.assert_allclose(narrow @ narrow.T, wide @ wide.T, atol=1e-13 * np.abs(B).max() ** 2)
    assert_agreement(converged(system, wide)[0], exact_singular_values(system, narrow))


def test_compression_keeps_what_is_above_the_truncation(bodies):
    """Also what is no direction of its own beside a column that is 1e10 times as long."""
    system = proportional(bodies["box"], (0.5, 1e-2))
    V = whole_space(system).basis
    random = np.random.default_rng(0)
    s = np.array([1.0, 1e-3, 1e-7, 1e-11, 3e-13, 1e-15])
    columns = V[:, :6] * s @ np.linalg.qr(random.standard_normal((6, 6)))[0]
    space, parts = adi._compressed(system, columns[:, :0], [np.empty((0, 0))], [columns[:, :3]])
    space, (Z,) = adi._compressed(system, space.basis, parts, [columns[:, 3:]])
    np.testing.assert_allclose(np.linalg.svd(Z, compute_uv=False), s[:5], rtol=1e-2, atol=1e-15)
    np.testing.assert_allclose(space.basis @ Z @ (space.basis @ Z).T, columns @ columns.T, atol=1e-12)
    np.testing.assert_allclose(space.basis.T @ (system.mass @ space.basis), np.eye(5), atol=1e-12)
    np.testing.assert_allclose(space.basis.T @ (system.stiffness @ space.basis), np.diag(space.eigenvalues), atol=1e-5)


@pytest.mark.parametrize("damping", PROPORTIONAL.values(), ids=PROPORTIONAL)
def test_observed_is_the_closed_form(bodies, damping):
    system = proportional(bodies["box"], damping)
    whole = whole_space(system)
    exact = observability(whole)
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        some = whole.basis[:, ::7] + whole.basis[:, 1::7][:, :12].sum(axis=1, keepdims=True)
        coordinates = whole.basis.T @ (system.mass @ some)
        Wo = projected_observability(system, factor, some)
    np.testing.assert_allclose(Wo, coordinates.T @ exact @ coordinates, atol=1e-9 * np.abs(Wo).max())
    np.testing.assert_array_equal(Wo, Wo.T)


def test_shifts_are_the_eigenvalues_that_the_residual_moves_most(bodies):
    """In the space of all eigenvectors the first shifts are those of the motions that make up the Gramian."""
    system = proportional(bodies["beam"], (0.1, 1e-6))
    B = bodies["beam"][2][:, :1]
    whole = whole_space(system)
    γ, d, g = whole.eigenvalues, whole.damping, whole.basis.T @ B[:, 0]
    λ, contributions = adi._contributions(system, whole, Residual(np.zeros_like(B), B))
    chosen = select_shifts(λ, contributions)
    column = apply_shift(system, Residual(np.zeros_like(B), B), chosen[0])[0]
    length = np.sqrt(np.linalg.eigvalsh(column.T @ (system.mass @ column))[-1])
    assert contributions.max() == pytest.approx(length, rel=1e-2)
    motions = [int(np.argmin(np.abs(np.sqrt(γ) - abs(μ)))) for μ in chosen]
    np.testing.assert_allclose(chosen, -d[motions] / 2 + 1j * np.sqrt(γ - d**2 / 4)[motions], rtol=1e-9)
    assert sorted(motions) == sorted(np.argsort(g**2 / (γ * d))[::-1][:8])


def test_a_shift_takes_its_eigenvalue_and_much_of_those_near():
    λ = np.array([-1.0, -1.5, -1 + 9j, -100.0])
    assert select_shifts(λ, np.array([4.0, 3.0, 2.0, 1.0])) == [-1.0, -1 + 9j, -100.0, -1.5]
    assert select_shifts(λ, np.array([1.0, 3.0, 4.0, 0.1])) == [-1 + 9j, -1.5, -1.0, -100.0]


def test_critically_damped_motions_have_one_eigenvector_for_two_eigenvalues():
    system = own_system(np.eye(2), np.diag([2.0, 4.0]), np.diag([1.0, 4.0]), np.eye(2))
    σ, gramian = converged(system, np.eye(2))
    Wc = np.diag([1 / 4, 1 / 32])
    columns = gramian.space.basis @ gramian.factor
    np.testing.assert_allclose(columns @ columns.T, Wc, atol=1e-12)
    np.testing.assert_allclose(σ, np.sqrt(np.diag(Wc) * [1.25, 0.625]), rtol=1e-9)


def test_no_damping_is_refused(bodies):
    system = proportional(bodies["beam"], (0.0, 0.0))
    with (
        closing(system.algebra.factor((1.0, system.stiffness))) as factor,
        pytest.raises(SolverError, match="needs damping of every motion"),
    ):
        next(low_rank_gramians(system, factor, bodies["beam"][2]))


def test_iteration_ends_at_the_limit(bodies, monkeypatch):
    monkeypatch.setattr(adi, "MAX_SHIFTS", 20)
    system = proportional(bodies["box"], PROPORTIONAL["light"])
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        *_, last = low_rank_gramians(system, factor, bodies["box"][2])
    assert last.shifts == 24  # the sweep that has begun is finished
    assert last.residual > 1e-6  # and the caller can tell
    assert 1e-6 < last.remaining < 1


def test_first_shifts_come_from_a_small_krylov_space(bodies):
    system = proportional(bodies["box"], PROPORTIONAL["light"])
    K, M, B = system.stiffness.toarray(), system.mass.toarray(), bodies["box"][2]
    blocks = [np.linalg.solve(K, B)]
    blocks += [np.linalg.solve(K, M @ blocks[0])]
    blocks += [np.linalg.solve(K, M @ blocks[1])]
    krylov = np.linalg.qr(np.hstack(blocks))[0]
    with closing(system.algebra.factor((1.0, system.stiffness))) as factor:
        space = adi._first_space(system, factor, B)
    ritz = scipy.linalg.eigh(krylov.T @ K @ krylov, krylov.T @ M @ krylov, eigvals_only=True)
    np.testing.assert_allclose(space.eigenvalues, ritz, rtol=1e-6)
    one, e = np.eye(3), np.eye(3)[:, :1]
    assert adi._first_space(own_system(one, one, one, e), MatrixFactor(one), e).basis.shape == (3, 1)


@pytest.mark.parametrize("form", [scipy.sparse.csc_matrix.toarray, scipy.sparse.csc_matrix.tocsr])
def test_factors_of_complex_sums(bodies, form):
    M, K, B = (*(form(A) for A in bodies["beam"][:2]), bodies["beam"][2])
    system = own_system(M, 0.1 * M + 1e-6 * K, K, B)
    for s in (-0.05 + 30.0j, 1e-3 + 100.0j):
        A = s**2 * M + s * system.damping + K
        factor = system.algebra.factor((s**2, system.mass), (s, system.damping), (1.0, system.stiffness))
        for block in (B, B[:, :1] - 2j * B[:, 1:2]):
            x = factor.solve(block)
            assert x.dtype == complex
            assert np.linalg.norm(A @ x - block) <= 1e-10 * np.linalg.norm(block)
    x = system.algebra.factor((1.0, system.stiffness)).solve(B + 2j * B)
    assert np.linalg.norm(K @ x - B - 2j * B) <= 1e-10 * np.linalg.norm(B)
    assert system.algebra.factor((1.0, system.stiffness)).solve(B).dtype == float


@pytest.mark.parametrize("form", [np.array, scipy.sparse.csc_matrix])
def test_singular_sums_are_refused(form):
    system = own_system(form(np.eye(3)), form(np.eye(3)), form(np.diag([1.0, 2.0, 3.0])), np.eye(3))
    with pytest.raises(SolverError, match="a matrix of 3 unknowns could not be factored: singular"):
        system.algebra.factor((-2.0 + 0j, system.mass), (1.0, system.stiffness))
    with pytest.raises(SolverError, match="a matrix of 3 unknowns could not be factored: not positive definite"):
        system.algebra.factor((-1.5, system.mass), (1.0, system.stiffness))
