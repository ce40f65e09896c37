"""Large deformation gives the same run on any number of ranks."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from ranks import run_ranks

import fenics_rom as fr

ALL = """large_deformation = { material = "neo_hookean" }
[effects.gravity]
acceleration = [0, 0, -9.81]
[effects.springs.bed]
surface = "front"
stiffness = 50.0
[effects.pressure.air]
surface = "top"
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -0.01]
normal = [0, 0, 1]
[effects.tendon.rope]
points = [[0.01, 0.1, 0.15], [0.25, 0.1, 0.15], [0.49, 0.1, 0.15]]
"""
BRANCHES = "[effects.viscoelasticity]\nratios = [0.8, 0.4]\ntimes = [5e-3, 0.1]\n"
BY_LENGTH = 'control = "length"\n'
MOVING = """inertia = {}
damping = { alpha = 1.0, beta = 1e-3, materials.material = { alpha = 2.0, beta = 2e-3 } }
friction = { coefficient = 0.2 }
"""
LOADS = 'load = [{{ actuator = "air", force = [9000.0] }}, {{ actuator = "rope", start = 0.02, force = [{}] }}]'
BOTH = """import sys
from contextlib import suppress
from fenics_rom.cli.main import main
for name in sys.argv[1:]:
    with suppress(SystemExit):
        main(["simulate", name + ".toml", "-o", name + ".h5"])
"""
pytestmark = [pytest.mark.ranks, pytest.mark.slow]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folders of what 1 and 2 ranks made of the same scenes."""
    folder = tmp_path_factory.mktemp("ranks")
    mesh = write_arrays(folder / "box.msh", *box_arrays((0.5, 0.2, 0.15), (3, 1, 1), shake=0.2))
    parts = {"contacts": '[contacts.bottom]\nsurface = "bottom"', "outputs.tip": 'surface = "right"'}
    soft = {"material": "young = 1e6\npoisson = 0.35\ndensity = 1000.0"}
    unsprung = ALL.replace('[effects.springs.bed]\nsurface = "front"\nstiffness = 50.0\n', BRANCHES)
    scenes = {
        "relaxing": (MOVING, unsprung, f"dt = 5e-3\nduration = 0.05\n{LOADS.format(60.0)}"),
        "moving": (MOVING, ALL, f"dt = 5e-3\nduration = 0.05\n{LOADS.format(60.0)}"),
        "still": ("", ALL + BY_LENGTH, f"dt = 0.1\nduration = 0.2\n{LOADS.format(5e-3)}"),
    }
    for ranks in (1, 2):
        made = folder / str(ranks)
        made.mkdir()
        for name, (kind, effects, run) in scenes.items():
            text = scene_text(mesh, degree=2, effects=kind + effects, run=run, **parts, **soft)
            (made / f"{name}.toml").write_text(text)
        done = run_ranks(ranks, "-c", BOTH, *scenes, cwd=made)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.parametrize("name", ["moving", "relaxing", "still"])
def test_runs_do_not_depend_on_the_number_of_ranks(results, name):
    one, other = (fr.read_trajectory(results / str(ranks) / f"{name}.h5") for ranks in (1, 2))
    scale = np.abs(one.snapshots).max()
    assert scale > 5e-3
    assert np.abs(other.snapshots - one.snapshots).max() <= 1e-8 * scale
    assert np.abs(other.outputs["tip"] - one.outputs["tip"]).max() <= 1e-8 * scale
    assert np.abs(other.energy - one.energy).max() <= 1e-8 * one.energy.max()
    assert np.abs(one.forces["floor"]).max() > 0.1
    assert np.abs(other.forces["floor"] - one.forces["floor"]).max() <= 1e-6 * np.abs(one.forces["floor"]).max()
    assert max(one.balance_error, other.balance_error) <= 1e-10
