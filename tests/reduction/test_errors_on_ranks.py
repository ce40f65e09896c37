"""Runs state the same errors whatever number of ranks made their ROM."""

import json

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from ranks import run_ranks

import fenics_rom as fr

pytestmark = pytest.mark.ranks
EFFECTS = "inertia = {{}}\ngravity = {{ acceleration = [0, 0, -9.81] }}\n[effects.damping]\nbeta = 1e-3\n{others}"
OIL = 'alpha = 2.0\n[effects.damping.dashpots.oil]\nsurface = "front"\ncoefficient = 30.0'
BODIES = {"held": ("alpha = 2.0", {}), "dashpots": (OIL, {}), "free": ("", {"supports": None})}
REDUCE = """import sys
from fenics_rom.cli.main import main
for name in sys.argv[1:]:
    try:
        main(["reduce", name + ".toml", "--errors", "--order", "8", "-o", name + ".h5"])
    except SystemExit as end:
        if end.code:
            raise
"""


def test_errors_are_the_same_on_two_ranks(tmp_path):
    mesh = write_arrays(tmp_path / "box.msh", *box_arrays((1.0, 0.4, 0.3), (4, 2, 2), shake=0.2))
    output = {"outputs.tip": "points = [[1.0, 0.4, 0.3]]"}
    for name, (others, parts) in BODIES.items():
        text = scene_text(mesh, effects=EFFECTS.format(others=others), **output, **parts)
        (tmp_path / f"{name}.toml").write_text(text)
    done = run_ranks(2, "-c", REDUCE, *BODIES, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    for name in BODIES:
        here = fr.reduce(fr.assemble(fr.read_scene(tmp_path / f"{name}.toml")), order=8, errors=True)
        told = []
        for rom in (here, fr.read_rom(tmp_path / f"{name}.h5")):
            body = fr.Simulator(rom, 1e-3)
            for _ in range(50):
                body.step([1.0, 2.0, 3.0])
            bound, estimate = body.error_bound, body.error_estimate
            told.append([bound.norm, estimate.norm, *bound.output("tip").ravel(), *estimate.output("tip").ravel()])
        assert told[0][0] > told[0][1] > 0
        np.testing.assert_allclose(told[1], told[0], rtol=1e-6, err_msg=json.dumps(told))
