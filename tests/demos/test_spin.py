"""The demos of a thrown bar and a thrown beam run for a part of their flights, and what they claim holds."""

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


def test_what_the_flight_of_a_beam_claims_holds():
    run = subprocess.run([sys.executable, FOLDER / "flight.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 4
