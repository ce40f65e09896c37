"""The case that went unseen: a body that an obstacle holds, pulled six times as hard as in training."""

import numpy as np
import pytest
from bodies import write_box

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

SCENE = """
[mesh]
file = "{mesh}"
[material]
young = 4.0e5
poisson = 0.4
density = 1070.0
[supports]
clamped = ["left"]
[contacts.under]
near = {{ point = [0.09, 0.005, 0.0], radius = 0.02 }}
[outputs.tip]
points = [[0.1, 0.0, 0.0]]
[effects]
damping = {{ alpha = 1.0, beta = 2e-3 }}
inertia = {{}}
large_deformation = {{ material = "neo_hookean" }}
[effects.tendon.flexor]
points = [[0.0, 0.005, 0.0], [0.05, 0.005, 0.0], [0.1, 0.005, 0.0]]
[effects.contact.obstacles.box]
shape = "box"
center = [0.09, 0.005, -0.008]
size = [0.04, 0.04, 0.01]
[reduction]
order = 12
[run]
dt = 2e-3
duration = 0.3
[[run.load]]
actuator = "flexor"
force = [{force}]
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
def test_what_an_obstacle_holds_and_is_pulled_too_hard_is_told(tmp_path):
    """Trained with a tendon of 1 N and a box under the tip, run with 1 N and with 6 N."""
    mesh = write_box(tmp_path / "beam.msh", (0.1, 0.01, 0.01), (8, 1, 1))
    scenes = {force: parse_scene(SCENE.format(mesh=mesh, force=force)) for force in (1.0, 6.0)}
    rom = fr.reduce(fr.assemble(scenes[1.0]))
    runs = {force: fr.simulate(rom, scene=scene) for force, scene in scenes.items()}
    assert not runs[1.0].beyond_training
    assert np.linalg.norm(runs[6.0].forces["box"], axis=1).max() > 0
    (text,) = [warning for warning in runs[6.0].warnings if "beyond what" in warning]
    assert "input 'flexor' reached 6 N, 6 times the 1 N of training" in text
    assert "the strain of a kept point reached" in text
    assert not any("times as far" in warning for warning in runs[6.0].warnings)  # the box holds it
