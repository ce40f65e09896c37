"""The demo of the diamond and the trunk, in its short form."""

import subprocess
import sys
from pathlib import Path

import pytest

import fenics_rom as fr

DEMO = Path(__file__).parents[2] / "demos" / "robots"


@pytest.mark.slow
def test_all_claims_hold():
    run = subprocess.run([sys.executable, DEMO / "robots.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "FAILS" not in run.stdout
    out = DEMO / "out" / "quick"
    assert {"diamond.h5", "robots.md", "robots.png"} <= {file.name for file in out.iterdir()}
    assert set(fr.read_rom(out / "diamond.h5").deformation.tendons) == {"north", "west", "south", "east"}


@pytest.mark.slow
def test_trunk_reaches_a_point():
    run = subprocess.run([sys.executable, DEMO / "reaching.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 2
    assert (DEMO / "out" / "reaching.png").is_file()


def test_cables_of_the_trunk_lead_through_its_discs():
    """Two points in each disc, on straight lines that come to 2 mm from the axis at 195 mm."""
    tendons = fr.read_scene(DEMO / "trunk.toml").effects.tendon
    assert [len(tendon.points) for tendon in tendons.values()] == [21] * 4 + [11] * 4
    for tendon in tendons.values():
        for x, y, z in tendon.points[:-1]:
            k = round((z - 0.024) / 0.0174853)
            assert (x * x + y * y) ** 0.5 == pytest.approx(0.010 - 0.00071735 * k, abs=2e-6)
            assert min(abs(z - 0.021 - 0.0174853 * k), abs(z - 0.027 - 0.0174853 * k)) <= 2e-6
