"""The demo of large deformation, in its short form."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import fenics_rom as fr

DEMO = Path(__file__).parents[2] / "demos" / "bending"
pytestmark = pytest.mark.slow


def test_all_claims_hold():
    run = subprocess.run(
        [sys.executable, DEMO / "bending.py", "--quick"], capture_output=True, text=True, env=dict(os.environ)
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "FAILS" not in run.stdout
    out = DEMO / "out" / "quick"
    assert {"bending.h5", "bending.md", "bending.png"} <= {file.name for file in out.iterdir()}
    body = fr.read_rom(out / "bending.h5").deformation
    assert body.law == "neo_hookean"
    assert set(body.tendons) == {"flexor"}
    assert set(body.pressures) == {"air"}
    validation = fr.read_rom(out / "bending.h5").validation["under"]
    assert 0 < validation["validation_error"] < 0.1
