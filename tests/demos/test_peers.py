"""The comparison with peers: what needs none; with FENICS_ROM_PEERS set, they are installed and asked."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from scipy.sparse import csc_matrix

import fenics_rom as fr

DEMOS = Path(__file__).parents[2] / "demos"
SMALL = 3.2  # size factor of a mesh of 603 unknowns
ORDERS = (6, 12, 24)

quiet = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


@pytest.fixture(scope="module", autouse=True)
def path():
    """The demo's modules can be imported."""
    with pytest.MonkeyPatch.context() as patch:
        for folder in ("rates", "scaling", "peers"):
            patch.syspath_prepend(DEMOS / folder)
        yield


@pytest.fixture(scope="module")
def pymor(path):
    import against_pymor

    return against_pymor


@pytest.fixture(scope="module")
def mujoco(path):
    import against_mujoco

    return against_mujoco


@pytest.fixture(scope="module")
def system(pymor, tmp_path_factory):
    return pymor.cylinder(SMALL, tmp_path_factory.mktemp("out"))


@pytest.fixture(scope="module")
def model(pymor, system):
    """One contact mode of it."""
    model = pymor.matrices(system)
    name, B = next(iter(model.inputs.items()))
    return replace(model, inputs={name: B})


@pytest.fixture(scope="module")
def full(model):
    return model.responses()


def errors(pymor, model, bases, full):
    return {order: outputs for order, (outputs, _) in pymor.errors_of(model, bases, full).items()}


@pytest.fixture(scope="module")
def textbook(pymor, model, full):
    """Errors of second-order balanced truncation by dense position Gramians (Meyer & Srinivasan 1996)."""
    ((name, B),) = model.inputs.items()
    L = np.linalg.cholesky(model.M.toarray())
    solve = scipy.linalg.solve_triangular
    K, D = (solve(L, solve(L, A.toarray(), lower=True).T, lower=True) for A in (model.K, model.D))
    B, C = (solve(L, columns, lower=True) for columns in (B, model.C))
    zero, unit = np.zeros_like(K), np.eye(len(K))
    A = np.block([[zero, unit], [-K, -D]])
    Wc = scipy.linalg.solve_continuous_lyapunov(A, -np.block([[zero, zero], [zero, B @ B.T]]))
    Wo = scipy.linalg.solve_continuous_lyapunov(A.T, -np.block([[C @ C.T, zero], [zero, zero]]))
    Z, Y = (E * np.sqrt(np.maximum(w, 0)) for w, E in (np.linalg.eigh(W[: len(K), : len(K)]) for W in (Wc, Wo)))
    T = solve(L.T, Z @ np.linalg.svd(Y.T @ Z)[2].T)
    return errors(pymor, model, {(name, order): T[:, :order] for order in ORDERS}, full)


@quiet
@pytest.mark.parametrize("lyapunov", ["krylov", "closed-form"])
@pytest.mark.slow
def test_errors_are_those_of_textbook_balanced_truncation(pymor, system, model, full, textbook, lyapunov):
    (name,) = model.inputs
    watched = replace(system, outputs={"patches": model.C})
    bases = {}
    for order in ORDERS:
        rom = fr.reduce(watched, order=order, weighting="outputs", lyapunov=lyapunov)
        bases[name, order] = rom.basis @ rom.contact_models[name].coordinates
    assert system.size == 603
    assert errors(pymor, model, bases, full) == pytest.approx(textbook, rel=1e-4)


def test_matrices_come_out_of_the_file_as_they_went_in(model, tmp_path):
    model.write(tmp_path / "model.npz")
    with np.load(tmp_path / "model.npz") as given:
        size = len(given["C"])
        for name in "MDK":
            parts = tuple(given[f"{name}_{part}"] for part in ("data", "indices", "indptr"))
            assert abs(csc_matrix(parts, (size, size)) - getattr(model, name)).max() == 0  # symmetric: rows are columns
        for name, B in model.inputs.items():
            np.testing.assert_array_equal(given[f"B_{name}"], B)
        np.testing.assert_array_equal(given["C"], model.C)


@quiet
def test_directions_that_are_given_make_the_same_model(pymor, system, model):
    (name,) = model.inputs
    watched = replace(system, contacts={name: system.contacts[name]}, outputs={"patches": model.C})
    ours = fr.reduce(watched, order=12, weighting="outputs")
    given = pymor.given_directions({name: ours.basis @ ours.contact_models[name].coordinates})
    theirs = fr.reduce(watched, method=given, order=12)
    np.testing.assert_allclose(
        theirs.contact_models[name].eigenvalues, ours.contact_models[name].eigenvalues, rtol=1e-8
    )


@pytest.mark.parametrize("stiff", [1.0, 100.0])
def test_switching_gain_is_that_of_the_projection(pymor, stiff):
    model = pymor.Model(csc_matrix(np.eye(2)), csc_matrix(np.eye(2)), csc_matrix(np.diag([1.0, stiff])), {}, np.eye(2))
    start, end = np.array([[1.0], [0.0]]), np.array([[0.5], [np.sqrt(0.75)]])  # 60° apart
    # Orthogonal: cos 60° long, along `end`; oblique, along what is orthogonal to `start`: 1 / cos 60°.
    for left, length in ((end, 0.5), (start, 2.0)):
        expected = length**2 * max(1.0, 0.25 + 0.75 * stiff)
        assert pymor.switching_gain(model, (start, start), (end, left)) == pytest.approx(expected)


def test_a_model_without_time_steps_is_that_of_the_matrix_exponential(mujoco, monkeypatch):
    random = np.random.default_rng(1)
    n = 6
    M = np.diag(random.uniform(1, 2, n))
    K = 2e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    B = random.uniform(size=n)
    zero, unit = np.zeros((n, n)), np.eye(n)
    inverse = np.linalg.inv(M)
    A = np.block([[zero, unit], [-inverse @ K, -mujoco.BETA * inverse @ K]])
    force = np.concatenate([np.zeros(n), inverse @ B * mujoco.FORCE])
    advance = scipy.linalg.expm(mujoco.SAMPLE * np.block([[A, force[:, None]], [np.zeros((1, 2 * n + 1))]]))
    state, expected = np.zeros(2 * n), []
    for sample in range(mujoco.samples()):
        pushed = float(sample < round(mujoco.PUSH / mujoco.SAMPLE))
        state = (advance @ np.append(state, pushed))[:-1]
        expected.append(B @ state[:n])
    np.testing.assert_allclose(mujoco.exact(M, K, B), expected, rtol=1e-8, atol=1e-12)


def test_modes_that_are_not_solved_for_follow_the_force_at_once(mujoco):
    n = 200
    M = 0.01 * np.eye(n)
    K = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    B = np.eye(n)[n // 2]
    all_of_them = mujoco.exact(M, K, B)
    assert mujoco.distance(mujoco.exact(csc_matrix(M), csc_matrix(K), B), all_of_them) <= 5e-4  # 4e-3 without them


@quiet
def test_reduced_beam_follows_the_same_matrices_to_second_order(mujoco):
    n = 40
    K = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    B = np.eye(n)[-1]
    rom = fr.reduce(mujoco.linear({"M": 1e-2 * np.eye(n), "K": K, "B": B}), order=mujoco.ORDER)
    reference = mujoco.exact(1e-2 * np.eye(n), K, B)
    coarse, fine = (mujoco.distance(mujoco.rollout(rom, h), reference) for h in (1e-4, 5e-5))
    assert fine <= 1e-3
    assert coarse / fine == pytest.approx(4, rel=0.1)


@quiet
def test_tetrahedra_are_read_as_the_beam_that_they_fill(mujoco, tmp_path):
    counts = (5, 3, 3)
    grid = np.stack(np.meshgrid(*(np.linspace(0, 1, k) for k in counts), indexing="ij"), axis=-1)
    points = (grid.reshape(-1, 3) ** [2, 1, 1] - [0, 0.5, 0.5]) * mujoco.SIZE  # finer where it is clamped
    number = np.arange(len(points)).reshape(counts)
    cells = []
    for corner in np.ndindex(*(k - 1 for k in counts)):
        for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):  # Kuhn's six
            way = [np.array(corner)]
            for axis in order:
                way.append(way[-1] + np.eye(3, dtype=int)[axis])
            cells.append([number[tuple(at)] for at in way])
    file = mujoco.tetrahedra({"points": points, "tetrahedra": np.array(cells)}, tmp_path / "flex.msh")
    system = mujoco.assembled(file, degree=1)
    assert system.size == 3 * 4 * 9  # all but the clamped face
    tip = system.input_matrix("tip")
    np.testing.assert_allclose(tip.sum(axis=0), 1.0)  # one newton in each direction
    M, _, _ = mujoco.matrices(system)
    kept = 1 - 2 / 3 / 16  # velocities grow linearly over the first sixteenth: a third of its mass counts
    assert M.sum() / 3 == pytest.approx(kept * mujoco.BEAM["density"] * np.prod(mujoco.SIZE))


def test_peer_that_cannot_be_installed_is_told_in_a_line(path, tmp_path):
    from environments import PeerError, environment

    with pytest.raises(PeerError, match=r"mujoco cannot be installed: .*no-python"):
        environment("mujoco", tmp_path, python=str(tmp_path / "no-python"))
    with pytest.raises(PeerError, match="mujoco cannot be installed: without a word"):
        environment("mujoco", tmp_path, python="/bin/false")
    assert not list(tmp_path.glob("env-*/made-from"))


@pytest.mark.slow
def test_demo_runs_without_the_peers():
    run = subprocess.run([sys.executable, DEMOS / "peers" / "peers.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "FAILS" not in run.stdout
    assert run.stdout.count(" holds ") == 6
    out = DEMOS / "peers" / "out" / "quick"
    assert "pymor is left out by --quick" in (out / "pymor.md").read_text()
    assert "mujoco is left out by --quick" in (out / "mujoco.md").read_text()
    assert "exudyn is left out by --quick" in (out / "exudyn.md").read_text()
    for name in ("mujoco", "tip"):
        assert (out / f"{name}.png").stat().st_size > 10_000


@pytest.mark.skipif(not os.environ.get("FENICS_ROM_PEERS"), reason="FENICS_ROM_PEERS is not set: no peers installed")
@quiet
@pytest.mark.slow
def test_peers_keep_the_claims_on_a_small_mesh(pymor, mujoco, tmp_path):
    from environments import environment
    from findings import Findings

    out, findings = DEMOS / "peers" / "out", Findings(judge_rates=False)
    pymor.compare(pymor.cylinder(SMALL, tmp_path), environment("pymor", out), tmp_path, findings, 1)
    sizes = (0.014, 0.0245)
    mujoco.compare(environment("mujoco", out), tmp_path, findings, mujoco.FLEXES[:1], sizes, 1)
    assert findings.verdict()
