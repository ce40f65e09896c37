"""The demo of the silicone beam: what recordings say, the law that relaxes, and the whole demo."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr

FOLDER = Path(__file__).parents[2] / "demos" / "beam"


@pytest.fixture(scope="module")
def demo():
    """The modules of the demo."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        import recordings
        import relaxation

        yield recordings, relaxation


def test_recordings_say_what_the_page_prints(demo):
    read = {name: demo[0].read_recording(FOLDER / "data" / f"{name}.csv") for name in ("alone_a", "weight52_b")}
    assert [-1e3 * one.at_rest[:, 2].mean() for one in read.values()] == pytest.approx([6.46, 17.08], abs=0.01)
    assert [one.ringing.frequency for one in read.values()] == pytest.approx([7.72, 4.31], abs=0.01)


def test_a_vibration_about_a_middle_that_creeps_is_found(demo):
    t = np.arange(0.01, 2.0, 0.01)
    z = -0.01 - 3e-4 * np.log(t) + 5e-3 * np.exp(-1.7 * t) * np.cos(2 * np.pi * 4.4 * t + 1.0)
    found = demo[0].Ringing.of(t, z, 0.2, 1.2)
    assert [found.frequency, found.decay, found.middle, found.creep] == pytest.approx(
        [4.4, 1.7, -0.01, -3e-4], rel=1e-6
    )


def test_the_law_relaxes_and_vibrates_as_its_branches_do(demo):
    law = demo[1].Law.of(fr.read_scene(FOLDER / "relaxing.toml"))
    assert law.after(0.0) == pytest.approx(law.young * (1 + 4 * law.ratio), rel=1e-12)
    assert law.after(1e3) == pytest.approx(law.young, rel=1e-12)
    ω, τ = 30.0, np.array(law.times)
    stored = law.young * (1 + law.ratio * np.sum((ω * τ) ** 2 / (1 + (ω * τ) ** 2)))
    assert law.vibrating(ω / (2 * np.pi)) == pytest.approx(stored, rel=1e-12)


@pytest.mark.slow
def test_a_weight_that_was_not_fitted_is_foretold():
    run = subprocess.run([sys.executable, FOLDER / "beam.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("  holds: ") == 4
    out = FOLDER / "out" / "quick"
    assert {"52g.md", "moduli.md", "beam.png"} <= {file.name for file in out.iterdir()}
