"""The demo of the finger runs until it has closed, and its chamber is closed, too."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr

FOLDER = Path(__file__).parents[2] / "demos" / "finger"
OUT = FOLDER / "out" / "quick"


@pytest.fixture(scope="module")
def run():
    return subprocess.run([sys.executable, FOLDER / "finger.py", "--quick"], capture_output=True, text=True)


@pytest.fixture(scope="module")
def system():
    return fr.assemble(fr.read_scene(FOLDER / "finger.toml"))


@pytest.mark.slow
def test_all_claims_hold(run):
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 13
    assert "FAILS" not in run.stdout


@pytest.mark.slow
def test_tables_are_written(run):
    rows = [row.split("|")[1].strip() for row in (OUT / "accuracy.md").read_text().splitlines()[2:]]
    assert rows == ["full order", "reduced", "by balanced truncation", "without residual compliance too"]
    assert "contact, friction" in (OUT / "profile.md").read_text()


def test_pressure_on_the_closed_chamber_has_no_resultant_and_no_moment(system):
    body, forces = system.body, np.zeros(3 * len(system.body.nodes))
    forces[body.free] = system.actuators["air"][:, 0]
    forces = forces.reshape(-1, 3)
    size = np.linalg.norm(forces, axis=1).sum()
    assert np.abs(forces.sum(axis=0)).max() < 1e-13 * size
    moments = np.cross(body.nodes, forces)
    assert np.abs(moments.sum(axis=0)).max() < 1e-13 * np.linalg.norm(moments, axis=1).sum()


def test_air_presses_on_all_walls_of_the_chamber(system):
    a, b, c = 0.08, 0.012, 0.007  # m
    assert system.units["air"] == pytest.approx(2 * (a * b + b * c + c * a), rel=1e-12)
