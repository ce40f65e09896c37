"""The demo of control runs, with short loops, and what it claims holds."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "control"
OUT = FOLDER / "out" / "quick"
pytestmark = pytest.mark.slow


def test_what_the_demo_claims_holds_and_is_written():
    run = subprocess.run([sys.executable, FOLDER / "control.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 10
    assert "FAILS" not in run.stdout
    assert (OUT / "control.md").read_text().count("C, double") == 2
    for picture in ("control.png", "following.png", "replanning.png"):
        assert (OUT / picture).stat().st_size > 20_000
