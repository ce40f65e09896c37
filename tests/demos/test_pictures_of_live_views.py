"""The scripts that photograph the live view, with a hand on the mouse of a real browser, still find their way."""

import shutil
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

DEMOS = Path(__file__).parents[2] / "demos"


@pytest.mark.slow
@pytest.mark.parametrize("command", [["finger"], ["gripper", "--picture"]], ids=lambda command: command[0])
def test_live_view_is_photographed_as_on_the_page(command, tmp_path):
    demo, *options = command
    (tmp_path / "meshes").symlink_to(DEMOS.parent / "meshes")
    here = shutil.copytree(DEMOS / demo, tmp_path / "demos" / demo, ignore=shutil.ignore_patterns("out"))
    known = iio.imread(here / "view.png")
    (here / "view.png").unlink()
    done = subprocess.run([sys.executable, here / "live_view.py", *options], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    made = iio.imread(here / "view.png")
    assert made.shape == known.shape
    # In other runs 2 % of the places, if nothing is pulled 6 %: by how much it moves is the machine's.
    other = np.abs(made[..., :3].astype(int) - known[..., :3].astype(int)).max(axis=-1) > 40
    assert other.mean() < 0.1
