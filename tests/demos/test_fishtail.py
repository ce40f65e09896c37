"""The demo of the fishtail runs, for a tenth of its time and at one order, and what it claims holds."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "fishtail"
OUT = FOLDER / "out" / "quick"
pytestmark = pytest.mark.slow


def test_what_the_demo_claims_holds_and_is_written():
    run = subprocess.run([sys.executable, FOLDER / "fishtail.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 4
    assert "FAILS" not in run.stdout
    row = (OUT / "fishtail.md").read_text().splitlines()[2]
    assert row.startswith("| 30 ")
    assert (OUT / "fishtail.png").stat().st_size > 20_000
