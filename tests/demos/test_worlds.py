"""The demos of worlds run for a part, and what they claim holds."""

import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parents[2] / "demos"


@pytest.mark.slow
@pytest.mark.parametrize("demo", ["stack", "gripper", "robot", "hold"])
def test_what_the_demo_claims_holds(demo):
    script = DEMOS / demo / f"{demo}.py"
    done = subprocess.run([sys.executable, script, "--quick"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("  holds: ") >= 2
