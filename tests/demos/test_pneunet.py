"""The demo of the PneuNet: two of its chambers, of degree 1, at full order and reduced."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.reduction.hyperreduction.training import plan_runs
from fenics_rom.reduction.hyperreduction.training_loads import step_input

DEMO = Path(__file__).parents[2] / "demos" / "pneunet"


def test_the_mesh_is_the_one_that_the_script_makes(tmp_path, monkeypatch):
    """Its chambers are as large as they are said to be, and joined."""
    monkeypatch.syspath_prepend(str(DEMO))
    import mesh

    mesh.write(tmp_path / "pneunet.msh")
    assert (tmp_path / "pneunet.msh").read_bytes() == (DEMO / "pneunet.msh").read_bytes()
    nodes, cells = mesh.tetrahedra(mesh.CHAMBERS)
    x = nodes[cells]
    solid = np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6
    gap = (mesh.HEIGHT - mesh.ROOF) * mesh.HALF_WIDTH * mesh.GAP
    half = mesh.HALF_WIDTH - mesh.WALL
    chamber = mesh.INSIDE * half * (mesh.HEIGHT - mesh.WALL - mesh.LAYER)
    channel = (2 * mesh.FACING + mesh.GAP) * half * (mesh.CHANNEL - mesh.LAYER)
    between = mesh.CHAMBERS - 1
    box = nodes[:, 0].max() * mesh.HALF_WIDTH * mesh.HEIGHT
    assert nodes[:, 0].max() == pytest.approx(100.0)
    assert solid == pytest.approx(box - mesh.CHAMBERS * chamber - between * (channel + gap), rel=1e-12)


def test_it_touches_itself_in_training():
    """Shares of the scene's own history, which nothing pushes, and the history as it is for validation."""
    system = fr.assemble(fr.read_scene(DEMO / "pneunet.toml"))
    factor = system.algebra.factor((1.0, system.stiffness))
    loads, training, (own,) = plan_runs(SimpleNamespace(system=system, factor=factor))
    assert not any(push.any() for push in loads.pushes.values())
    most = [max(u[-1] for _, u in run.steps) for run in training]
    assert len(training) == 3
    assert most[0] == pytest.approx(1.1 * 5e4)
    assert all(0.5 * 5e4 <= each <= 1.1 * 5e4 for each in most)
    assert max(u[-1] for _, u in own.steps) == pytest.approx(5e4)
    assert step_input(system.scene.environment, own.steps[0][1]).obstacles is not None


@pytest.mark.slow
def test_all_claims_hold():
    run = subprocess.run([sys.executable, DEMO / "pneunet.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 5
    out = DEMO / "out" / "quick"
    assert (out / "pneunet.png").stat().st_size > 20_000
    assert "air" in fr.read_rom(out / "pneunet.h5").deformation.pressures
