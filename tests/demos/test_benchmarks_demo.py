"""The demo of published cases, in its short form: every number is within what it claims."""

import subprocess
import sys
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[2] / "demos" / "benchmarks" / "benchmarks.py"


@pytest.mark.slow
def test_all_claims_hold():
    run = subprocess.run([sys.executable, DEMO, "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 63
    assert (DEMO.parent / "out" / "quick" / "benchmarks.md").read_text().count("\n") == 65
