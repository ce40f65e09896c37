"""The demos of worlds and contact run for a part, and what they claim holds."""

import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parents[2] / "demos"


@pytest.mark.slow
@pytest.mark.parametrize(
    "script",
    [
        "stack/stack",
        "gripper/gripper",
        "gripper/full_order",
        "gripper/ball",
        "gripper/wrap",
        "robot/robot",
        "robot/whip",
        "hold/hold",
        "account/account",
        "weld/weld",
        "folds/folds",
        "feed/feed",
        "feed/drops",
        "feed/rest",
        "squeeze/squeeze",
        "ironing/ironing",
        "impact/impact",
        "pipe/pipe",
        "touch/touch",
    ],
)
def test_what_the_demo_claims_holds(script):
    script = DEMOS / f"{script}.py"
    done = subprocess.run([sys.executable, script, "--quick"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("  holds: ") >= 1
