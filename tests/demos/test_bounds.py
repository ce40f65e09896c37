"""The demo of bounds runs, with its plate; random runs are in tests/runtime/test_errors.py."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "bounds"
pytestmark = pytest.mark.slow


def test_all_claims_hold():
    run = subprocess.run([sys.executable, FOLDER / "bounds.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 4
    rows = (FOLDER / "out" / "quick" / "bounds.md").read_text().splitlines()[2:]
    assert [row.split("|")[2].strip() for row in rows] == ["10", "20", "40"]
    assert (FOLDER / "out" / "quick" / "bounds.png").stat().st_size > 10_000


def test_costs_are_measured():
    """One thread's, of which the smallest body's are to be told; no claim is made of them."""
    run = subprocess.run([sys.executable, FOLDER / "costs.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert [row.split("|")[2].strip() for row in run.stdout.splitlines()[2:4]] == ["20, 41", "40, 59"]
