"""The demo of a thrown bar runs for a part of its flight, and what it claims holds."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "spin"
pytestmark = pytest.mark.slow


def test_what_the_demo_claims_holds_and_is_written():
    run = subprocess.run([sys.executable, FOLDER / "spin.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 3
    assert (FOLDER / "out" / "quick" / "spin.png").stat().st_size > 30_000
