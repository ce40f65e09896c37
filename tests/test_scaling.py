"""The demo of costs runs, on small meshes; and models are as good as those of dense balanced truncation by SciPy."""

import csv
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import fenics_rom as fr

FOLDER = Path(__file__).parent.parent / "demos" / "scaling"
SMALL = 3.2  # size factor of a mesh of 603 unknowns
ORDERS = (6, 12, 24)


@pytest.fixture(scope="module")
def demo():
    """The functions of the comparison with pyMOR."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        import against_pymor

        yield against_pymor


@pytest.fixture(scope="module")
def system(demo, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "OUT", tmp_path_factory.mktemp("out"))
        return demo.cylinder(SMALL)


def errors(demo, model, bases):
    return {order: outputs for order, (outputs, _) in demo.errors_of(model, bases).items()}


@pytest.fixture(scope="module")
def textbook(demo, system):
    """Model and errors of second-order balanced truncation by dense position Gramians (Meyer & Srinivasan 1996)."""
    model = demo.matrices(system)
    name, B = next(iter(model["inputs"].items()))
    model["inputs"] = {name: B}
    L = np.linalg.cholesky(model["M"].toarray())
    solve = scipy.linalg.solve_triangular
    K, D = (solve(L, solve(L, model[A].toarray(), lower=True).T, lower=True) for A in "KD")
    B, C = (solve(L, columns, lower=True) for columns in (B, model["outputs"]))
    zero, unit = np.zeros_like(K), np.eye(len(K))
    A = np.block([[zero, unit], [-K, -D]])
    Wc = scipy.linalg.solve_continuous_lyapunov(A, -np.block([[zero, zero], [zero, B @ B.T]]))
    Wo = scipy.linalg.solve_continuous_lyapunov(A.T, -np.block([[C @ C.T, zero], [zero, zero]]))
    Z, Y = (E * np.sqrt(np.maximum(w, 0)) for w, E in (np.linalg.eigh(W[: len(K), : len(K)]) for W in (Wc, Wo)))
    T = solve(L.T, Z @ np.linalg.svd(Y.T @ Z)[2].T)
    return model, errors(demo, model, {(name, order): T[:, :order] for order in ORDERS})


@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
@pytest.mark.parametrize("lyapunov", ["krylov", "closed-form"])
def test_errors_are_those_of_textbook_balanced_truncation(demo, system, textbook, lyapunov):
    model, expected = textbook
    (name,) = model["inputs"]
    watched = replace(system, outputs={"patches": model["outputs"]})
    bases = {}
    for order in ORDERS:
        rom = fr.reduce(watched, order=order, weighting="outputs", lyapunov=lyapunov)
        bases[name, order] = rom.basis @ rom.modes[name].coordinates
    assert system.size == 603
    assert errors(demo, model, bases) == pytest.approx(expected, rel=1e-4)


def test_demo_of_costs_keeps_its_claims():
    run = subprocess.run(
        [sys.executable, FOLDER / "scaling.py", "--quick"], capture_output=True, text=True, env=dict(os.environ)
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("holds: ") == 4
    out = FOLDER / "out" / "quick"
    with (out / "costs.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["against"], row["ranks"], row["contact modes"]) for row in rows] == [
        *[("unknowns", "2", "2")] * 2,
        *[("contact modes", "1", "1"), ("contact modes", "1", "10")],
        *[("ranks", "1", "2"), ("ranks", "2", "2")],
    ]
    for row in rows:
        stages = [float(row[name]) for name in row if name.endswith(" (s)") and name != "assembly (s)"]
        assert sum(stages) == pytest.approx(2 * float(row["reduction (s)"]))
    assert "not in this run" in (out / "goals.md").read_text()
    assert (out / "scaling.png").stat().st_size > 10_000
