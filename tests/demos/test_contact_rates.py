"""The demo of what contact costs runs, in short loops: what touches is judged, and times are not."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "contact_rates"
OUT = FOLDER / "out" / "quick"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run():
    return subprocess.run([sys.executable, FOLDER / "contact_rates.py", "--quick"], capture_output=True, text=True)


def test_what_the_demo_claims_holds(run):
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 8
    assert "times as long" not in run.stdout  # times are not judged


def test_tables_are_written(run):
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in (OUT / "rates.md").read_text().splitlines()[2:]]
    assert [row[0] for row in rows][:4] == ["at rest", "sticks", "in part slides", "slides"]
    by_name = {row[0]: row for row in rows}
    assert by_name["nothing in reach"][1:4] == ["0", "0", "0"]
    assert by_name["neither"][1:4] == ["", "", ""]
    pads = [cell.strip() for cell in (OUT / "very_many.md").read_text().splitlines()[2].split("|")[1:-1]]
    assert pads[:3] == ["16", "40", "40.0"]
    assert "contact, friction" in (OUT / "effects.md").read_text()


def test_a_body_whose_whole_skin_may_touch_comes_to_rest():
    command = [sys.executable, FOLDER / "whole_skin.py", "--quick"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "  holds: forces at rest" in done.stdout
