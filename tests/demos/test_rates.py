"""The demo of rates runs, in short loops: errors and memory are judged, and times are not."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "rates"
OUT = FOLDER / "out" / "quick"
SECTIONS = ["Forms of a step", "Rollout", "Batches", "Against the full order", "Memory", "Import", "What must hold"]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run():
    return subprocess.run(
        [sys.executable, FOLDER / "rates.py", "--quick"], capture_output=True, text=True, env=dict(os.environ)
    )


@pytest.fixture(scope="module")
def claims(run):
    assert run.returncode == 0, run.stdout + run.stderr
    return json.loads((OUT / "rates.json").read_text())["claims"]


def test_tables_and_picture_are_written(run, claims):
    tables = (OUT / "rates.md").read_text()
    headings = [line.removeprefix("## ") for line in tables.splitlines() if line.startswith("## ")]
    assert all(heading.startswith(section) for heading, section in zip(headings, SECTIONS, strict=True)), headings
    assert run.stdout.count("| holds ") == tables.count("| holds ") == 10
    assert tables.count("| not judged |") == len(claims) - 10
    assert (OUT / "rates.png").stat().st_size > 10_000


def test_every_way_to_step_is_right(claims):
    errors = {what: value for what, value in claims.items() if "error" in what}
    assert len(errors) == 5
    for what, error in errors.items():
        assert 0 < error < (1e-3 if "float32" in what else 1e-6 if "full order" in what else 1e-11), what
    assert claims["gap of the energy account, as a share of the work"] < 1e-12


def test_steps_leave_nothing_behind(claims):
    stays = {what: value for what, value in claims.items() if "stay" in what}
    assert len(stays) == 4
    assert max(stays.values()) < 2048
