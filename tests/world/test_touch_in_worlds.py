"""A sense of touch of bodies of a world: what a rigid body does to them is what an obstacle of a scene does."""

import warnings

import numpy as np
import pytest
from pads import RUBS, UP, L, pad_scene

import fenics_rom as fr
from fenics_rom.mechanics.touch import TOUCH
from fenics_rom.visualization import optional_dependencies
from fenics_rom.visualization.viewer.live_world import LiveWorld
from fenics_rom.visualization.viewer.world_page import WorldPage
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
DT, STEPS, PRESSED = 1e-3, 50, 0.02
AT, RADIUS, SPEED = np.array([1.9 * L, 2.05 * L, 21.0001 * L]), 20.0 * L, np.array([15 * L, 0.0, -2 * L])
FELT = 'quantity = "touch"\nsurface = "top"\ntaxels = { rows = 4, columns = 5 }\n'
SENSES = {"outputs.pad": FELT, "outputs.late": FELT + "sensor = { rate = 100.0, delay = 0.005 }"}
# Normals of a world are those that were expected in the middle of the step: they turn by its motion over the radius.
TURNED = 2e-3


def went(t):
    """Of the ball, m."""
    return SPEED * [max(0.0, t - PRESSED), 0.0, t]


def moved(t):
    """The ball as a body of a world."""
    return fr.BaseState(AT + went(t), np.array([1.0, 0, 0, 0]), SPEED * [t > PRESSED, 0, 1], np.zeros(3))


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    ball = f'obstacles.pin = {{ shape = "sphere", center = {AT.tolist()}, radius = {RADIUS} }}'
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = pad_scene(tmp_path_factory.mktemp("worlds"), ball, points="nodes", **UP, **RUBS, **SENSES)
        return fr.reduce(fr.assemble(scene), order=10)


def test_a_body_of_a_world_feels_what_one_among_obstacles_does(rom, tmp_path):
    single = fr.Simulator(rom, DT, signals={"pin": went})
    world = fr.World({"pad": fr.SoftBody(rom), "ball": fr.RigidBody(Sphere(RADIUS), motion=moved)}, DT, friction=0.4)
    recorder, body, slides, felt = WorldRecorder(world, STEPS, snapshots=2), world.simulator("pad"), 0, []
    for step in range(1, STEPS + 1):
        before = body.node_places()
        single.step()
        world.step()
        one, other, nodes, _, pressing = single.touch("pad"), body.touch("pad"), *body.nodal_contact
        felt.append(other.force)
        np.testing.assert_allclose(other.force, world.force_between("pad", "ball"), atol=1e-12)
        if step * DT <= PRESSED:
            size = np.abs(one.force).max()
            np.testing.assert_allclose(other.force, one.force, atol=TURNED * size)
            np.testing.assert_allclose(other.torque, one.torque, atol=TURNED * L * size)
            np.testing.assert_allclose(other.patches.margin, one.patches.margin, atol=TURNED)
            np.testing.assert_allclose(other.pressures, one.pressures, atol=TURNED * one.pressures.max())
        if other.touching == 1:
            middle, goes = ((before + body.node_places()) / 2)[nodes], (went(step * DT) - went((step - 1) * DT)) / DT
            n = middle - AT - went((step - 0.5) * DT)
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            way = (body.node_places() - before)[nodes] / DT - goes
            along = pressing @ (way - (n * way).sum(axis=1)[:, None] * n) / pressing.sum()
            np.testing.assert_allclose(other.patches.slip[0], along, atol=TURNED * np.linalg.norm(SPEED))
        slides += other.patches.sliding[0] > 0.9
        look = max(0, step - 5) // 10 * 10
        np.testing.assert_array_equal(body.touch("late").force, felt[look - 1] if look else np.zeros(3))
        world.energy  # noqa: B018, it has all bodies told
        np.testing.assert_array_equal(body.touch("pad").patches.slip, other.patches.slip)
        recorder.sample(step)
    assert slides
    run = recorder.record("pad")
    fr.write_trajectory(tmp_path / "run.h5", run)
    read = fr.read_trajectory(tmp_path / "run.h5").readings["pad-pad"]
    assert read.quantity == TOUCH
    np.testing.assert_array_equal(read.touch.force[1:], felt)


def test_sensors_look_after_each_of_many_steps(rom):
    worlds = [fr.World({"pad": fr.SoftBody(rom), "ball": fr.RigidBody(Sphere(RADIUS), motion=moved)}, DT) for _ in "ab"]
    worlds[0].step(count=38)
    for _ in range(38):
        worlds[1].step()
    shown = [world.simulator("pad").touch("late").force for world in worlds]
    assert shown[0].any()
    np.testing.assert_array_equal(*shown)


def test_a_live_world_has_the_colours_of_taxels(rom, viser_server):
    """Those of several bodies by one name at once, also beside a body that has none of that name."""
    pads = {name: fr.SoftBody(rom, position=place) for name, place in {"pad": np.zeros(3), "far": (1.0, 0, 0)}.items()}
    live = LiveWorld(fr.World({**pads, "ball": fr.RigidBody(Sphere(RADIUS), motion=moved)}, DT))
    live.world.step(count=10)
    page = WorldPage(optional_dependencies.viser_package(), viser_server, live, "world")
    one, other = (page._soft[name] for name in pads)
    assert list(one.readings) == ["reading pad (Pa)", "reading late (Pa)"]
    shown, taxels = one.field("reading pad (Pa)"), live.world.simulator("pad").touch("pad").pressures
    on_top = one._surface.places[one._surface.node_of][:, 2] > 0.999 * one._surface.places[:, 2].max()
    assert 0.3 * taxels.max() < shown.max() <= taxels.max()
    assert not shown[~on_top].any()
    assert not other.field("reading pad (Pa)").any()
    assert not one.field("reading of others (Pa)").any()
