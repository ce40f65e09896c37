"""Soft bodies that deform largely, among others."""

import re
from contextlib import nullcontext

import numpy as np
import pytest
from soft_rom import in_frame, soft_rom
from test_compiled_world import EPS, assert_closes, both, told, upside_down, without
from test_soft_motion import BOX, CLAMPED, LIES, momenta, reduced, ride

import fenics_rom as fr
from fenics_rom.compilation import compiled
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.world.joints import ball
from fenics_rom.world.shapes import Box, HalfSpace, Sphere

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


def pulled(law, kind):
    """A beam, at whose tip a box hangs, is struck by another one from below; a base shakes it, or it stands turned."""

    def motion(time):
        angle, rate = 0.1 * np.sin(20 * time) * np.ones(3), 2 * np.cos(20 * time) * np.ones(3)
        return fr.BaseState(np.zeros(3), quaternion_of_vector(angle), np.zeros(3), rate)

    rom, bodies = soft_rom(law, order=6, contact=True, touched_from=0.2), {}
    given = {"rotation": quaternion_of_vector(np.array([0.3, 0.0, 0.0]))}
    if kind == "carried":
        bodies["palm"] = fr.RigidBody(Sphere(1e-3), motion=motion)
        rom, given = in_frame(rom), {"on": "palm"}
    bodies["beam"] = fr.SoftBody(rom, **given)
    x, y, z = fr.World({**bodies, "away": fr.RigidBody(**BOX, position=(9, 0, 0))}, 1e-3).simulator("beam").places()[-1]
    bodies["hangs"] = fr.RigidBody(Box((0.02,) * 3), mass=0.01, position=(x + 0.02, y, z))
    strikes = {"mass": 0.02, "position": (0.24, 0.01, -0.02), "velocity": (0, 0, 0.5), "angular_velocity": (0.5, 1, 0)}
    bodies["strikes"] = fr.RigidBody(Box((0.05, 0.05, 0.02)), **strikes)
    return fr.World(bodies, 1e-3, friction=0.4, restitution=0.2, joints=[ball("beam", "hangs", (x, y, z))])


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    parts = {key: value for key, value in BENT.items() if key != "supports"}
    return reduced(tmp_path_factory.mktemp("free"), frame="moving", order=6, **parts)


def flying(rom):
    """Two free beams fly into one another; nothing else acts."""
    turned = {"rotation": upside_down(0.3), "velocity": (0, 0, -0.4), "angular_velocity": (1.0, 2.0, -1.0)}
    bodies = {"beam": fr.SoftBody(rom), "high": fr.SoftBody(rom, position=(0.2, 0.01, 0.024), **turned)}
    return fr.World(bodies, 1e-3, friction=0.4, restitution=0.2)


@pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")
@pytest.mark.parametrize(
    "kind",
    [("st_venant_kirchhoff", "held"), ("neo_hookean", "carried"), pytest.param("free", marks=pytest.mark.slow)],
    ids=str,
)
def test_compiled_steps_are_those_of_numpy(request, kind):
    """Either takes over from the other. One that is free takes long to reduce, and to compile."""
    rom = request.getfixturevalue("free") if kind == "free" else None
    worlds, touching = both(lambda: flying(rom) if kind == "free" else pulled(*kind)), 0
    random, begun = np.random.default_rng(0), worlds[0].ledger
    start = worlds[0].energy + begun.dissipated - begun.supplied
    before = momenta(worlds[0]) if kind == "free" else None
    for step in range(40):
        inputs = {} if kind == "free" else {"beam": {"cable": 0.2 * np.sin(0.2 * step) ** 2, "air": 50.0}}
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step(inputs)
        worlds[1].step(inputs)
        touching += worlds[0].touching
        if step % 5 == 4:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
            assert worlds[0].touching == worlds[1].touching
    assert_closes(worlds[0], start, 40)
    if kind == "free":
        np.testing.assert_allclose(momenta(worlds[0]), before, rtol=0, atol=40 * 10 * EPS * np.abs(before).max())
    assert touching > 3
    assert worlds[0].compiled_steps > 0.6 * 40
    for name in {"beam", "high"} & set(worlds[0].names):
        ours, theirs = (world.simulator(name) for world in worlds)
        assert ours.warnings == theirs.warnings  # of training, too
