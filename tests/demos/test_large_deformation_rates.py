"""The demo of what large deformation costs runs, in short loops: errors are judged, and times are not."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "rates"
OUT = FOLDER / "out" / "large_deformation" / "quick"
pytestmark = pytest.mark.slow


def test_the_stepper_that_is_chosen_is_exact_enough():
    run = subprocess.run([sys.executable, FOLDER / "stepper_choice.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert (run.stdout.count("| holds "), run.stdout.count("| not judged |")) == (8, 8)


def test_steps_are_as_exact_as_the_demo_claims():
    run = subprocess.run([sys.executable, FOLDER / "large_deformation.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("| holds ") == 6
    assert run.stdout.count("| not judged |") == 4
    tables = (OUT / "large_deformation.md").read_text()
    assert all(part in tables for part in ("## Steps of a body per second", "## Errors, relative", "| neo_hookean"))
