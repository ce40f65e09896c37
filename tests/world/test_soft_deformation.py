"""Soft bodies that deform largely, among others."""

import re

import numpy as np
import pytest
from test_soft_motion import BOX, CLAMPED, LIES, reduced, ride

import fenics_rom as fr
from fenics_rom.world.shapes import Box, HalfSpace

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
DEPTH = 0.01  # m, of a floor below the beam
BENT = {
    **CLAMPED,
    "effects.large_deformation": 'material = "st_venant_kirchhoff"',
    "effects.contact": "",
    "effects.contact.obstacles.floor": f'shape = "half-space"\npoint = [0.0, 0.0, {-DEPTH}]\nnormal = [0.0, 0.0, 1.0]',
    "effects.friction": "coefficient = 0.5",
    "run": "dt = 2e-3\nduration = 0.1",
    "actuators.pull": 'surface = "right"',
    "[run.load]": 'actuator = "pull"\nforce = [0.0, 0.0, -0.15]',
}


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("bent"), frame="fixed", order=8, **BENT)


def test_on_a_half_space_it_moves_as_on_the_obstacle_of_its_scene(rom):
    ground = fr.RigidBody(HalfSpace(), motion=LIES._replace(position=np.array([0, 0, -DEPTH])))
    world = fr.World({"beam": fr.SoftBody(rom), "ground": ground}, 2e-3, friction=0.5)
    body, most = fr.Simulator(rom, 2e-3), 0.0
    for step in range(80):
        push = [0.02 if step > 40 else 0.0, 0, -0.15]
        world.step({"beam": {"pull": push}})
        body.step(pull=push)
        most = max(most, np.linalg.norm(world.force_between("ground", "beam")))
        np.testing.assert_allclose(world.force_between("beam", "ground"), body.obstacle_forces()[0], atol=1e-8)
    assert most > 0.05
    np.testing.assert_allclose(world.simulator("beam").displacement(), body.displacement(), rtol=0, atol=1e-10)


def test_a_box_falls_on_it_and_the_account_closes(rom):
    box = fr.RigidBody(**BOX, position=(0.25, 0.015, 0.037))
    world = fr.World({"beam": fr.SoftBody(rom), "box": box}, 1e-3, gravity=(0, 0, -9.81), friction=0.5)
    with pytest.warns(fr.FenicsRomWarning, match="strain|other bodies"):
        gap, touching = ride(world, 150)
    assert touching >= 2
    assert gap < 1e-13
    surface = world.simulator("beam").displacement()
    assert np.linalg.norm(surface, axis=1).max() > 0.03  # a tenth of its length


def test_a_box_that_fits_between_the_points_is_told(rom):
    """Of 24 mm, where points are up to 50 mm apart."""
    said = []
    for size in (0.024, 0.08):
        box = fr.RigidBody(Box((size,) * 3), density=500, position=(0.25, 0.015, 0.1))
        world = fr.World({"beam": fr.SoftBody(rom), "box": box}, 1e-3)
        said.append(world.warnings)
    assert said[1] == ()
    assert re.search(r"beam: contact: obstacle 'box' is 0.024 m across, and .* gaps of 0.0\d+ m", said[0][0])
