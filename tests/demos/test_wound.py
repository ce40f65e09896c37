"""The demo of the wound finger, in its short form, and its closed form."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "demos" / "wound"))
from wound import HERE, Tube, closed_form


def test_threads_that_do_not_give_keep_their_length():
    """Wound in both directions at α, λ_θ cos α and λ sin α make 1; as strong in one, the tube turns by its sign."""
    for angle in (0.3, 0.8):
        both = closed_form(Tube(6e-3, 8e-3, 3e4, 1e7, (angle, -angle)), 1e3)
        outer = np.sqrt(both.radius**2 + (8e-3**2 - 6e-3**2) / both.stretch) / 8e-3
        assert np.hypot(outer * np.cos(angle), both.stretch * np.sin(angle)) == pytest.approx(1, abs=1e-4)
        assert abs(both.twist) < 1e-3
    turned = [closed_form(Tube(6e-3, 8e-3, 3e4, 3e3, (angle,)), 1e3).twist for angle in (0.4, -0.4)]
    assert turned[0] == pytest.approx(-turned[1], rel=1e-4)
    assert turned[0] < -2


@pytest.mark.slow
def test_all_claims_hold():
    run = subprocess.run([sys.executable, HERE / "wound.py", "--quick"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "FAILS" not in run.stdout
    assert len((HERE / "out" / "quick" / "wound.md").read_text().splitlines()) == 8
