"""Anyone's matrices: the triple chain of the M-M.E.S.S. benchmarks, SciPy and NumPy, and what is refused."""

import numpy as np
import pytest
import scipy.sparse

import fenics_rom as fr
from fenics_rom.errors import SceneError, StructureError


def triple_chain(length, α, β, v):
    """Truhar & Veselić's chain: three rows of masses on springs, joined to one mass that a spring holds."""
    masses, springs, joint, wall = (1.0, 2.0, 3.0), (10.0, 20.0, 1.0), 10.0, 50.0
    size = 3 * length + 1
    M = scipy.sparse.diags(np.concatenate([*(np.full(length, m) for m in masses), [joint]]))
    row = scipy.sparse.diags([-np.ones(length - 1), 2 * np.ones(length), -np.ones(length - 1)], [-1, 0, 1])
    K = scipy.sparse.block_diag([*(k * row for k in springs), [[sum(springs) + wall]]]).tolil()
    for number, k in enumerate(springs, start=1):
        K[number * length - 1, size - 1] = K[size - 1, number * length - 1] = -k
    dashpots = np.zeros(size)
    dashpots[[0, length - 1, 2 * length]] = v
    K = K.tocsc()
    return M, α * M + β * K + scipy.sparse.diags(dashpots), K, np.ones((size, 1))


def hankel_singular_values(M, D, K, B, C):
    """By nothing but dense linear algebra on the first-order form."""
    from fenics_rom.reduction.gramians import textbook_gramians

    Wc, Wo = textbook_gramians(M.toarray(), D.toarray(), K.toarray(), B, C @ C.T)
    return np.sqrt(np.sort(np.linalg.eigvals(Wc @ Wo).real)[::-1][:6])


@pytest.mark.parametrize("v", [0.0, 5.0])
def test_triple_chain_agrees_with_a_dense_solution(v):
    M, D, K, B = triple_chain(20, 0.1, 0.1, v)
    system = fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B}, outputs={"all": B})
    assert (system.rayleigh is None) == (v > 0)
    rom = fr.reduce(system, order=6, weighting="outputs")
    reference = hankel_singular_values(M, D, K, B, B)
    np.testing.assert_allclose(rom.contact_models["all"].hankel_singular_values[:6], reference, rtol=1e-6)


def test_reduced_chain_follows_the_full_one():
    M, D, K, B = triple_chain(50, 0.01, 0.01, 5.0)
    system = fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B, "end": B[:, 0] * 0 + np.eye(151)[0]})
    rom = fr.reduce(system, order=120)  # σ of a chain fall slowly
    for name in system.contacts:
        mode, B = rom.contact_models[name], system.input_matrix(name)
        for ω in (0.01, 0.1, 0.5):
            exact = np.linalg.solve((-(ω**2) * M + 1j * ω * D + K).toarray(), B)
            dynamic = np.diag(mode.eigenvalues - ω**2) + 1j * ω * mode.damping
            reduced = rom.basis @ (mode.coordinates @ np.linalg.solve(dynamic, mode.inputs))
            assert np.linalg.norm(reduced - exact) <= 1e-5 * np.linalg.norm(exact)
    body = fr.Simulator(rom, dt=0.1)
    for step in range(300):
        body.switch(("all", "end")[step // 10 % 2])
        body.step([1.0])
    account = body.ledger
    gap = body.energy - account.supplied + account.dissipated + account.lost_in_switching
    assert abs(gap) <= 2e-12 * max(body.energy, account.supplied)
    assert body.displacement().shape == (151,)


def test_sparse_and_dense_matrices_give_the_same_model():
    M, D, K, B = triple_chain(10, 0.1, 0.1, 1.0)
    one = fr.reduce(fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B}), order=5)
    dense = {"mass": M.toarray(), "damping": D.toarray(), "stiffness": K.toarray()}
    other = fr.reduce(fr.System(**dense, contacts={"all": B}), order=5)
    np.testing.assert_allclose(
        one.contact_models["all"].eigenvalues, other.contact_models["all"].eigenvalues, rtol=1e-9
    )


def test_model_without_a_mesh_is_kept_in_a_file_and_has_no_scene_to_run(tmp_path):
    M, D, K, B = triple_chain(10, 0.1, 0.1, 1.0)
    fr.write_rom(
        tmp_path / "chain.h5", fr.reduce(fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B}), order=5)
    )
    rom = fr.read_rom(tmp_path / "chain.h5")
    body = fr.Simulator(rom, dt=0.1)
    body.step([1.0])
    assert body.displacement().shape == (31,)
    with pytest.raises(SceneError, match="has no mesh, so no scene goes with it; step it with Simulator"):
        fr.simulate(rom)


def test_proportional_damping_is_found_out():
    M, D, K, B = triple_chain(10, 0.3, 0.02, 0.0)
    assert fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B}).rayleigh == pytest.approx((0.3, 0.02))
    assert fr.System(mass=M, damping=0 * M, stiffness=K, contacts={"all": B}).rayleigh == pytest.approx((0.0, 0.0))


def test_coefficients_in_place_of_a_damping_matrix():
    M, D, K, B = triple_chain(10, 0.3, 0.02, 0.0)
    given = fr.System(mass=M, rayleigh=(0.3, 0.02), stiffness=K.toarray(), contacts={"all": B})
    assert given.rayleigh == (0.3, 0.02)
    np.testing.assert_allclose(given.damping @ np.eye(31), D.toarray(), rtol=1e-12, atol=1e-12)
    found = fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B})
    σ = [fr.reduce(system, order=5).contact_models["all"].hankel_singular_values[:5] for system in (given, found)]
    np.testing.assert_allclose(*σ, rtol=1e-9)


def test_damping_that_takes_from_the_mass_is_found_out_and_reduced():
    M, _, K, B = triple_chain(10, 0.0, 0.0, 0.0)
    lowest = np.linalg.eigvals(np.linalg.solve(M.toarray(), K.toarray())).real.min()
    system = fr.System(mass=M, damping=0.1 * K - 0.05 * lowest * M, stiffness=K, contacts={"all": B})
    assert system.rayleigh == pytest.approx((-0.05 * lowest, 0.1))
    reference = hankel_singular_values(M, system.damping, K, B, np.linalg.cholesky(M.toarray()))
    np.testing.assert_allclose(
        fr.reduce(system, order=6).contact_models["all"].hankel_singular_values[:6], reference, rtol=1e-6
    )


def test_dashpots_alone_are_semi_definite():
    M, _, K, B = triple_chain(10, 0.0, 0.0, 0.0)
    dashpots = scipy.sparse.diags(1.0 * (np.arange(31) == 7))
    assert fr.System(mass=M, damping=dashpots, stiffness=K, contacts={"all": B}).rayleigh is None


def test_undamped_matrices_are_modal_only():
    M, D, K, B = triple_chain(10, 0.3, 0.02, 0.0)
    with pytest.raises(fr.errors.SolverError, match="needs damping"):
        fr.reduce(fr.System(mass=M, damping=0 * D, stiffness=K, contacts={"all": B}), order=4)


@pytest.mark.slow
def test_large_sparse_matrices_take_the_krylov_route():
    M, D, K, B = triple_chain(500, 0.002, 0.002, 0.0)
    system = fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B})
    krylov = fr.reduce(system, order=10)
    exact = fr.reduce(system, order=10, lyapunov="closed-form")
    σ = [rom.contact_models["all"].hankel_singular_values[:10] for rom in (krylov, exact)]
    np.testing.assert_allclose(σ[0], σ[1], rtol=1e-6)


def broken(what):
    M, D, K, B = (part.toarray() if scipy.sparse.issparse(part) else part for part in triple_chain(4, 0.1, 0.1, 1.0))
    parts = {"mass": M, "damping": D, "stiffness": K, "contacts": {"all": B}}
    return parts | what(parts)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (lambda p: {"mass": -p["mass"]}, "mass is not positive definite"),
        (lambda p: {"stiffness": p["stiffness"] - 100 * np.eye(13)}, "stiffness is not positive definite"),
        (lambda p: {"damping": p["damping"] - 50 * np.eye(13)}, "damping is not positive semi-definite"),
        (lambda p: {"stiffness": np.triu(p["stiffness"])}, r"stiffness is not symmetric: \|A - Aᵀ\| = 2.0e\+01"),
        (lambda p: {"stiffness": p["stiffness"][:5, :5]}, r"stiffness has shape \(5, 5\); use \(13, 13\)"),
        (lambda p: {"mass": p["mass"] * np.nan}, "mass holds numbers that are not finite"),
        (lambda p: {"contacts": {"all": np.ones((4, 1))}}, r"contacts\['all'\] has shape \(4, 1\)"),
        (lambda p: {"contacts": {}}, "at least one contact mode"),
        (lambda p: {"mass": p["mass"] * 1j}, "mass is complex; use real numbers"),
        (lambda p: {"outputs": {"tip": np.full((13, 1), 1j)}}, r"outputs\['tip'\] is complex"),
        (lambda p: {"damping": None}, "neither damping nor rayleigh given; use one of them"),
        (lambda p: {"rayleigh": (0.1, 0.1)}, "both damping and rayleigh given; use one of them"),
        (lambda p: {"damping": None, "rayleigh": (0.1, np.inf)}, r"rayleigh = \(0.1, inf\): use two finite"),
        (lambda p: {"damping": None, "rayleigh": (0.1,)}, r"rayleigh = \(0.1,\): use two finite"),
        (lambda p: {"actuators": {"pull": np.full((13, 1), np.inf)}}, r"actuators\['pull'\] holds numbers"),
    ],
)
@pytest.mark.parametrize("sparse", [False, True])
def test_matrices_without_structure_are_refused(what, message, sparse):
    parts = broken(what)
    if sparse:
        given = {name: parts[name] for name in ("mass", "damping", "stiffness") if parts[name] is not None}
        parts |= {name: scipy.sparse.csr_matrix(matrix) for name, matrix in given.items()}
    with pytest.raises(StructureError, match=message):
        fr.System(**parts)


def test_printed_system_says_what_it_is():
    M, D, K, B = triple_chain(50, 0.3, 0.02, 5.0)
    contacts = {f"place {k}": B[:, :1] for k in range(6)}
    lines = repr(fr.System(mass=M, rayleigh=(0.3, 0.02), stiffness=K, contacts=contacts, outputs={"all": B})).split(
        "\n"
    )
    assert lines == [
        "System of matrices: 151 unknowns, D = 0.3 M + 0.02 K, no rigid motions, no mesh",
        "  contacts place 0 (1), place 1 (1), place 2 (1), place 3 (1) and 2 more; "
        f"outputs all ({B.shape[1]}) (columns)",
    ]
    assert "D not proportional" in repr(fr.System(mass=M, damping=D, stiffness=K, contacts={"all": B}))
