"""The elastic rest of a free body against dense linear algebra in what is M-orthogonal to its rigid motions."""

from contextlib import closing

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from bodies import assembled, box_arrays, dense, write_arrays

import fenics_rom as fr
from fenics_rom.errors import SceneError, StructureError
from fenics_rom.reduction.balancing import balance
from fenics_rom.reduction.gramians import square_root, textbook_gramians
from fenics_rom.reduction.rigid_mode_deflation import elastic_part

OUTPUT = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]"}


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """A box that nothing holds, n = 135."""
    mesh = write_arrays(tmp_path_factory.mktemp("free") / "box.msh", *box_arrays((1.0, 0.4, 0.3), (4, 2, 2), shake=0.2))
    return assembled(mesh, supports=None, damping="alpha = 1.0, beta = 1e-3", **OUTPUT)


def free_chain(size, **parts):
    """Masses between springs that nothing holds."""
    ends = np.concatenate([[1.0], np.full(size - 2, 2.0), [1.0]])
    K = scipy.sparse.diags([-np.ones(size - 1), ends, -np.ones(size - 1)], [-1, 0, 1]).tocsr()
    M = scipy.sparse.diags(1 + np.arange(size) / size).tocsr()
    contacts = {"left": np.eye(size)[0], "right": np.eye(size)[-1]}
    given = {"mass": M, "stiffness": K, "contacts": contacts, "rayleigh": (0.0, 0.1), "rigid": np.ones(size)}
    return given | {"outputs": {"last": np.eye(size)[-1]}} | parts


def on_rest(system):
    """γ and V (n, n - ρ) of the elastic rest, and R, by nothing but dense linear algebra."""
    M, K = (np.asarray(dense(A, system.size)) for A in (system.mass, system.stiffness))
    rest = scipy.linalg.null_space((M @ system.rigid).T)
    γ, U = scipy.linalg.eigh(rest.T @ K @ rest, rest.T @ M @ rest)
    return γ, rest @ U


def reference(system, B):
    """σ of the elastic rest by dense Lyapunov equations."""
    γ, V = on_rest(system)
    D = V.T @ np.asarray(dense(system.damping, system.size)) @ V
    Wc, Wo = textbook_gramians(np.eye(len(γ)), (D + D.T) / 2, np.diag(γ), V.T @ B, np.eye(len(γ)))
    return balance(square_root(Wc), square_root(Wo)).singular_values


@pytest.mark.parametrize("lyapunov", ["closed-form", "krylov", "adi"])
def test_hankel_singular_values_are_those_of_the_elastic_rest(free, lyapunov):
    rom = fr.reduce(free, order=12, lyapunov=lyapunov)
    for name, mode in rom.contact_models.items():
        σ = reference(free, free.input_matrix(name))
        assert (mode.order, mode.rigid) == (18, 6)
        np.testing.assert_allclose(mode.hankel_singular_values[:12], σ[:12], rtol=1e-6)


@pytest.mark.parametrize(
    "choice",
    [
        {"method": "modal"},
        {"method": "modal+static"},
        {"method": "pod"},
        {"method": "eigenvector-selection", "share": 0.999},
        {"solver": "iterative", "lyapunov": "krylov"},
        {"weighting": "outputs", "lyapunov": "krylov"},
        {"weighting": "nodal"},
    ],
)
def test_every_basis_begins_with_the_rigid_motions_and_holds_no_more_of_them(free, choice):
    with pytest.warns() if "solver" in choice else pytest.MonkeyPatch.context():
        rom = fr.reduce(free, order=10, **choice)
    Q = rom.basis
    np.testing.assert_array_equal(Q[:, :6], free.rigid)
    assert np.abs(Q.T @ (free.mass @ Q) - np.eye(Q.shape[1])).max() <= 1e-12
    QᵀKQ = Q.T @ (free.stiffness @ Q)
    assert np.abs(QᵀKQ - np.diag(rom.stiffness)).max() <= 1e-11 * rom.stiffness.max()
    for name, mode in rom.contact_models.items():
        assert not mode.eigenvalues[:6].any()
        W = Q @ mode.coordinates
        np.testing.assert_allclose(mode.inputs, W.T @ free.input_matrix(name), atol=1e-12)
        np.testing.assert_allclose(mode.damping, 1.0 + 1e-3 * mode.eigenvalues, rtol=1e-12)


def test_all_of_the_elastic_rest_is_all_there_is(free):
    rom = fr.reduce(free, order=20, method="eigenvector-selection", share=1.0)
    assert {mode.order for mode in rom.contact_models.values()} == {free.size}
    root = np.random.default_rng(0).standard_normal((12, 12))
    chain = fr.System(**free_chain(12, damping=0.1 * root @ root.T, rayleigh=None))
    mode = fr.reduce(chain, order=11, lyapunov="krylov").contact_models["left"]
    assert mode.order == 12
    np.testing.assert_allclose(mode.hankel_singular_values, reference(chain, chain.contacts["left"]), rtol=1e-5)


@pytest.mark.parametrize("dashpot", [0.0, 50.0])
def test_validation_is_that_of_the_elastic_rest(free, dashpot):
    """With a dashpot to the ground, too, which the elastic rest feels as if the rigid motions were held."""
    M, K = (dense(A, free.size) for A in (free.mass, free.stiffness))
    D = 1.0 * M + 1e-3 * K + np.diag(dashpot * (np.arange(free.size) == 40))
    choices = {"contacts": free.contacts, "rigid": free.rigid}
    system = fr.System(mass=M, damping=D, stiffness=K, **choices)
    assert (system.rayleigh is None) == (dashpot > 0)
    γ, V = on_rest(system)
    rom = fr.reduce(system, order=10)
    for name, mode in rom.contact_models.items():
        W, G, B = (rom.basis @ mode.coordinates)[:, 6:], mode.inputs[6:], system.input_matrix(name)
        sizes, errors = [], []
        for ω in (0.0, *mode.frequencies):
            exact = V @ np.linalg.solve(np.diag(γ - ω**2) + 1j * ω * V.T @ D @ V, V.T @ B)
            Δ = W.T @ D @ W
            gap = exact - W @ np.linalg.solve(np.diag(mode.eigenvalues[6:] - ω**2) + 1j * ω * Δ, G)
            size, error = (np.sqrt(np.trace(x.conj().T @ M @ x).real) for x in (exact, gap))
            sizes.append(size)
            errors.append(error)
        assert mode.static_error == pytest.approx(errors[0] / sizes[0], rel=1e-6)
        np.testing.assert_allclose(mode.transfer_errors, np.array(errors[1:]) / max(sizes[1:]), rtol=0.1)


@pytest.mark.parametrize("solver", ["direct", "iterative"])
def test_factor_gives_the_compliance_of_the_elastic_rest(free, solver):
    part = elastic_part(free)
    γ, V = on_rest(free)
    f = np.random.default_rng(0).standard_normal((free.size, 3))  # not in balance
    with closing(part.algebra.factor((1.0, part.stiffness), solver=solver)) as factor:
        x = factor.solve(f)
        exact = V @ (V.T @ f / γ[:, None])
        assert np.abs(x - exact).max() <= 1e-11 * np.abs(exact).max()
        both = factor.solve(f + 2j * f[:, ::-1])
        np.testing.assert_allclose(both, x + 2j * x[:, ::-1], atol=1e-12 * np.abs(x).max())


@pytest.mark.parametrize("shift", [30.0, 30.0 + 20.0j])
def test_shifted_factors_project_what_dampers_drag_along(shift):
    """With a dashpot to the ground, P(s²M + sD + K)P on the elastic rest is another matrix than its inverse's part."""
    damped = free_chain(12, damping=np.diag([3.0] + 11 * [0.1]), rayleigh=None)
    part = elastic_part(fr.System(**damped))
    γ, V = on_rest(part)
    f = np.random.default_rng(0).standard_normal((12, 2))
    factor = part.algebra.factor((shift**2, part.mass), (shift, part.damping), (1.0, part.stiffness))
    exact = V @ np.linalg.solve(np.diag(γ + shift**2) + shift * V.T @ (part.damping @ V), V.T @ f)
    assert np.abs(factor.solve(f) - exact).max() <= 1e-12 * np.abs(exact).max()


@pytest.mark.parametrize("count", [5, 60, 129])
def test_eigenpairs_are_those_that_strain(free, count):
    part = elastic_part(free)
    γ, V = part.algebra.eigenpairs(part.mass, part.stiffness, count)
    np.testing.assert_allclose(γ, on_rest(free)[0][:count], rtol=1e-9)
    assert np.abs(V.T @ (free.mass @ V) - np.eye(count)).max() <= 1e-10
    assert np.abs(free.rigid.T @ (free.mass @ V)).max() <= 1e-14


@pytest.mark.parametrize("sparse", [True, False])
def test_free_chain_of_own_matrices(sparse):
    """In the reduced model as in the full one, and its centre of mass exactly as a point that weighs as much."""
    given = free_chain(200, rayleigh=(0.0, 5.0))
    if not sparse:
        given |= {name: given[name].toarray() for name in ("mass", "stiffness")}
    system = fr.System(**given)
    assert system.rigid.shape == (200, 1)
    rom = fr.reduce(system, order=40)
    body, h = fr.Simulator(rom, dt=0.5), 0.5
    M, K = (dense(A, 200) for A in (system.mass, system.stiffness))
    x, v, B = np.zeros(200), np.zeros(200), system.input_matrix("left")
    for step in range(300):
        u = np.array([np.sin(0.1 * step)])
        mid = np.linalg.solve(2 / h * M + 5.0 * K + h / 2 * K, B @ u + 2 / h * M @ v - K @ x)
        x, v = x + h * mid, 2 * mid - v
        body.step(u)
    got = body.displacement()
    assert np.abs(got - x).max() <= 1e-6 * np.abs(x).max()
    assert np.ones(200) @ M @ got == pytest.approx(np.ones(200) @ M @ x, rel=1e-12)


def test_dashpot_on_a_free_chain_couples_what_is_rigid_and_what_is_not():
    damping = 0.01 * free_chain(30)["stiffness"] + scipy.sparse.diags([2.0] + 29 * [0.0])
    system = fr.System(**free_chain(30, damping=damping, rayleigh=None))
    rom = fr.reduce(system, order=29)
    mode = rom.contact_models["right"]
    assert mode.damping.shape == (30, 30)
    W = rom.basis @ mode.coordinates
    np.testing.assert_allclose(mode.damping, W.T @ (system.damping @ W), atol=1e-12)
    assert np.abs(mode.damping[0, 1:]).max() > 0.01
    for name in system.contacts:
        σ = reference(system, system.input_matrix(name))
        np.testing.assert_allclose(rom.contact_models[name].hankel_singular_values[:8], σ[:8], rtol=1e-6)
    body, h = fr.Simulator(rom, dt=0.1), 0.1
    M, D, K = (dense(A, 30) for A in (system.mass, system.damping, system.stiffness))
    x, v, B = np.zeros(30), np.zeros(30), system.input_matrix("left")[:, 0]
    for _ in range(200):
        mid = np.linalg.solve(2 / h * M + D + h / 2 * K, B + 2 / h * M @ v - K @ x)
        x, v = x + h * mid, 2 * mid - v
        body.step([1.0])
    assert np.abs(body.displacement() - x).max() <= 1e-9 * np.abs(x).max()


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"rigid": None, "stiffness": -np.eye(20)}, "stiffness is not .*; of a body that moves freely give rigid"),
        ({"rigid": np.arange(20.0)}, r"rigid: stiffness sees these columns: RᵀKR is up to .* for RᵀMR = 1"),
        ({"rigid": np.ones((20, 2))}, "rigid: its 2 columns depend on each other"),
        ({"rigid": np.zeros(20)}, "rigid: its 1 columns depend on each other"),
        ({"rigid": np.ones(19)}, r"rigid has shape \(19, 1\); use \(20, columns\)"),
        ({"rigid": 1j * np.ones(20)}, "rigid is complex; use real numbers"),
        (
            {"stiffness": np.zeros((20, 20))},
            "stiffness is not positive definite; beside the 1 columns of rigid it must be",
        ),
    ],
)
def test_rigid_columns_must_span_the_null_space(parts, message):
    with pytest.raises(StructureError, match=message):
        fr.System(**free_chain(20) | parts)


def test_round_off_does_not_make_a_free_body_a_held_one(free):
    """All pivots of this K are positive, the last ones by round-off alone."""
    M, K = (dense(A, free.size) for A in (free.mass, free.stiffness))
    for matrices in ((M, K), (scipy.sparse.csr_matrix(M), scipy.sparse.csr_matrix(K))):
        for shift, rigid in ((0.0, 6), (1e-15, 6), (-1e-15, 6), (1e-12, 0)):
            whole = matrices[1] + shift * abs(K).max() * scipy.sparse.identity(free.size)
            found = fr.System(mass=matrices[0], stiffness=whole, rayleigh=(0, 1e-3), contacts=free.contacts)
            assert found.rigid.shape[1] == rigid
    system = fr.System(mass=M, stiffness=K, rayleigh=(1.0, 1e-3), contacts=free.contacts, rigid=3 * free.rigid)
    one, other = (fr.reduce(s, order=8).contact_models["right"] for s in (system, free))
    np.testing.assert_allclose(one.hankel_singular_values[:8], other.hankel_singular_values[:8], rtol=1e-9)


def test_rows_of_other_units_do_not_make_a_held_body_a_free_one():
    """Of which the softest is 1e-18 of the mean."""
    K = np.diag([1e18, 1.0]) + 1e8 * (1 - np.eye(2))
    assert fr.System(mass=np.eye(2), stiffness=K, rayleigh=(0, 1e-3), contacts={"first": [1, 0]}).rigid.shape[1] == 0


def test_what_a_free_body_cannot_have_is_refused(free):
    for choice in ({"switching": "oblique"}, {"lyapunov": "bartels-stewart"}):
        with pytest.raises(SceneError, match="not wholly held have no dense Gramians"):
            fr.reduce(free, order=4, **choice)
    chain = free_chain(20)
    weight = fr.System(**chain | {"contacts": {"fall": chain["mass"] @ np.ones(20)}})
    with pytest.raises(SceneError, match="contact mode 'fall': its inputs move the body without straining it"):
        fr.reduce(weight, order=4)
