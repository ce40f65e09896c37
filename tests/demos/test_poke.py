"""The demo of pokes runs, with its first two."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "poke"
OUT = FOLDER / "out" / "quick"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def motion():
    """The ball's motion as it was before the demo wrote it."""
    return (FOLDER / "ball.csv").read_text()


@pytest.fixture(scope="module")
def run(motion):
    return subprocess.run([sys.executable, FOLDER / "poke.py", "--quick"], capture_output=True, text=True)


def test_all_claims_hold(run):
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 14
    assert "FAILS" not in run.stdout


def test_tables_and_picture_are_written(run):
    for file, heads in ("accuracy.md", ["full order"]), ("pokes.md", []):
        rows = [row.split("|")[1].strip() for row in (OUT / file).read_text().splitlines()[2:]]
        assert rows == [*heads, "reduced", "by balanced truncation", "without residual compliance too"]
    rows = [row.split("|")[2].strip() for row in (OUT / "from_rest.md").read_text().splitlines()[2:]]
    assert rows == ["full order at half the step", "reduced", "without residual compliance"]
    assert "contact, friction" in (OUT / "profile.md").read_text()
    assert (OUT / "poke.png").stat().st_size > 10_000


def test_the_motion_beside_the_scene_is_the_one_that_the_demo_writes(run, motion):
    assert (FOLDER / "ball.csv").read_text() == motion
