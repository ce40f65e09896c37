"""The demo of a swung finger runs, until it stops and at one order, and what it claims holds."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "swing"
OUT = FOLDER / "out" / "quick"
pytestmark = pytest.mark.slow


def test_what_the_demo_claims_holds_and_is_written():
    path = (FOLDER / "path.csv").read_text()
    run = subprocess.run([sys.executable, FOLDER / "swing.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 7
    assert "FAILS" not in run.stdout
    assert (FOLDER / "path.csv").read_text() == path  # which the scene names is what the script writes
    rows = (OUT / "swing.md").read_text().splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows][:3] == ["order 20", "without stiffening", "quasi-rigid"]
    assert (OUT / "swing.png").stat().st_size > 50_000
    assert (OUT / "swing.gif").stat().st_size > 50_000
