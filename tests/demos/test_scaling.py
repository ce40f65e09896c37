"""The demo of costs runs, on small meshes."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "demos" / "scaling"
pytestmark = [pytest.mark.alone, pytest.mark.slow]


def test_demo_of_costs_keeps_its_claims():
    run = subprocess.run(
        [sys.executable, FOLDER / "scaling.py", "--quick"], capture_output=True, text=True, env=dict(os.environ)
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("holds: ") == 4
    out = FOLDER / "out" / "quick"
    with (out / "costs.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["against"], row["ranks"], row["contact modes"]) for row in rows] == [
        *[("unknowns", "2", "2")] * 2,
        *[("contact modes", "1", "1"), ("contact modes", "1", "10")],
        *[("ranks", "1", "2"), ("ranks", "2", "2")],
    ]
    for row in rows:
        stages = [float(row[name]) for name in row if name.endswith(" (s)") and name != "assembly (s)"]
        assert sum(stages) == pytest.approx(2 * float(row["reduction (s)"]))
    assert "not in this run" in (out / "goals.md").read_text()
    assert (out / "scaling.png").stat().st_size > 10_000


def test_cubes_are_alike_by_factors_and_by_iterations():
    run = subprocess.run(
        [sys.executable, FOLDER / "cubes.py", "--quick"], capture_output=True, text=True, env=dict(os.environ)
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("holds: ") == 1
    rows = (FOLDER / "out" / "quick" / "cubes.md").read_text().splitlines()
    assert [row.split("|")[2].strip() for row in rows if row.startswith("| 4,")] == ["direct", "iterative"]
