"""The demo of a falling ring runs in its short variant, and its mesh is what its script makes."""

import runpy
import subprocess
import sys
from pathlib import Path

import gmsh
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "demos" / "drop"
OUT = FOLDER / "out" / "quick"


@pytest.fixture(scope="module")
def run():
    return subprocess.run([sys.executable, FOLDER / "drop.py", "--quick"], capture_output=True, text=True)


@pytest.mark.slow
def test_what_the_demo_claims_holds(run):
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 15
    assert "FAILS" not in run.stdout


@pytest.mark.slow
def test_tables_and_picture_are_written(run):
    rows = (OUT / "accuracy.md").read_text().splitlines()[2:]
    assert [row.split("|")[2].strip() for row in rows] == ["1200", "50", "50"]
    rows = (OUT / "variants.md").read_text().splitlines()[4:]
    assert [row.split("|")[1].strip() for row in rows] == ["as in the scene", "no losses"]
    assert (OUT / "drop.png").stat().st_size > 50_000


def nodes_and_cells(path):
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        tags, points, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
    return points.reshape(-1, 3)[np.argsort(tags)], corners.reshape(-1, 4) - 1


def test_mesh_is_made_by_its_script_and_symmetric(tmp_path):
    script = runpy.run_path(str(ROOT / "meshes" / "drop.py"))
    script["write"](tmp_path / "drop.msh")
    made, kept = (nodes_and_cells(path) for path in (tmp_path / "drop.msh", ROOT / "meshes" / "drop.msh"))
    assert np.abs(made[0] - kept[0]).max() < 1e-11
    assert np.array_equal(made[1], kept[1])
    nodes, cells = kept
    whole = {tuple(sorted(cell)) for cell in cells.tolist()}
    assert len(whole) == len(cells) == 960
    for sign in ([-1, 1, 1], [1, -1, 1]):
        distance = np.linalg.norm(nodes[:, None] - nodes * sign, axis=2)
        assert distance.min(axis=0).max() < 1e-9
        assert {tuple(sorted(cell)) for cell in distance.argmin(axis=1)[cells].tolist()} == whole
