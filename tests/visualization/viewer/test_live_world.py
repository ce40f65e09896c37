"""A world that somebody pulls at: mouse, account and reset, without a page."""

import warnings

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.viewer.live_world import LiveWorld
from fenics_rom.world.joints import SurfaceJoint
from fenics_rom.world.shapes import Box, HalfSpace, Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
G = 9.81
LIES = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
GROUND = fr.RigidBody(HalfSpace(), motion=LIES)
EDGE, MASS = 0.1, 0.5


def box_world(dt=2e-3, **given):
    box = fr.RigidBody(Box((EDGE,) * 3), mass=MASS, position=(0, 0, EDGE / 2), **given)
    return fr.World({"ground": GROUND, "box": box}, dt, gravity=(0, 0, -G), friction=0.5)


def gap(live, start=0.0):
    account = live.account
    return account.stored - start - account.supplied + account.dissipated + account.lost


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_a_box_is_lifted_and_hangs_below_the_mouse(dt):
    """By what its weight stretches the spring; the account has the work, and it falls when it is let go."""
    live = LiveWorld(box_world(dt))
    top = np.array([0.0, 0.0, EDGE])
    assert live.grab_rigid("box", top)
    np.testing.assert_allclose(live.held_at, top, atol=1e-15)
    live.mouse = top + np.array([0.0, 0.0, 0.2])
    for _ in range(round(1.0 / dt)):
        live.step()
    sag = MASS * G / live._spring.stiffness
    assert sag < 0.02
    assert live.held_at == pytest.approx(live.mouse - np.array([0, 0, sag]), abs=1e-6)
    assert live.force == pytest.approx([0, 0, MASS * G], abs=1e-4)
    assert not live.world.force_between("box", "ground").any()
    assert abs(gap(live)) < 1e-13
    live.release()
    assert (live.held, live.held_at) == (None, None)
    for _ in range(round(1.0 / dt)):
        live.step()
    assert live.world.pose("box").position[2] == pytest.approx(EDGE / 2, abs=1.8 * dt)  # it lands within a step
    assert abs(gap(live)) < 1e-12


@pytest.mark.parametrize("dt", [pytest.param(1e-4, marks=pytest.mark.slow), 1e-2, 0.1])
def test_the_mouse_is_stable_at_any_step_and_never_too_strong(dt):
    """Held at a corner, so that the box turns; the mouse leaps to and fro."""
    live = LiveWorld(fr.World({"box": fr.RigidBody(Box((EDGE,) * 3), mass=MASS)}, dt))
    corner = np.full(3, EDGE / 2)
    assert live.grab_rigid("box", corner)
    for leap in (1.0, -1.0, 1e-3):
        live.mouse = corner + leap
        live.step()
        assert np.linalg.norm(live.force) <= live._spring.largest * (1 + 1e-12)
        assert live.pulls_its_most == (np.linalg.norm(live.force) > live._spring.largest * (1 - 1e-6))
    for _ in range(max(300, round(3.0 / dt))):
        live.step()
    assert live.held_at == pytest.approx(live.mouse, abs=1e-3)
    assert live.account.stored < 1e-6


def test_what_moves_as_it_is_told_is_not_held():
    live = LiveWorld(box_world())
    assert not live.grab_rigid("ground", np.zeros(3))
    assert live.held is None


def test_reset_is_the_start_and_the_world_that_was_given_stays():
    world = box_world(velocity=(1.0, 0, 0))
    live = LiveWorld(world)
    live.grab_rigid("box", np.zeros(3))
    live.mouse = np.ones(3)
    for _ in range(5):
        live.step()
    live.dt = 1e-3
    live.reset()
    assert (live.time, live.held, live.dt, live.steps) == (0.0, None, 1e-3, 5)
    assert live.account == (pytest.approx(MASS / 2), 0, 0, 0, 0)
    assert world.steps == 0


@pytest.fixture(scope="module")
def roms(tmp_path_factory):
    """A beam along x, held at its left end or free, whose right end and top may be touched."""
    folder = tmp_path_factory.mktemp("beam")
    mesh = write_arrays(folder / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    floor = 'shape = "half-space"\npoint = [0.0, 0.0, -10.0]\nnormal = [0.0, 0.0, 1.0]'
    parts = {
        "effects.contact": "",
        "effects.contact.obstacles.floor": floor,
        "actuators.pull": 'surface = "right"\nforce = "normal"',
    }
    material = "young = 5e5\npoisson = 0.4\ndensity = 1100.0"
    found = {}
    for frame, supports in (("fixed", 'clamped = ["left"]'), ("moving", None)):
        text = scene_text(mesh, material=material, damping="alpha = 0.5, beta = 2e-3", supports=supports, **parts)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found[frame] = fr.reduce(fr.assemble(parse_scene(f'frame = "{frame}"\n{text}')), order=12)
    return found


def end_of(rom):
    """The triangle of the right end that is nearest to its middle, to be held in its middle."""
    corners = rom.nodes[rom.triangles]
    on_it = np.flatnonzero(np.isclose(corners[:, :, 0], corners[:, :, 0].max()).all(axis=1))
    return rom.triangles[on_it[0]], np.full(3, 1 / 3)


def test_a_held_beam_that_is_put_turned_is_pulled_in_the_worlds_axes(roms):
    """It comes to rest where spring and beam agree, as the mouse says, and stays in the mode that is held."""
    half = np.sqrt(0.5)
    turned = fr.SoftBody(roms["fixed"], position=(1.0, 2.0, 3.0), rotation=(half, 0, 0, half))  # x becomes y
    ball = fr.RigidBody(Sphere(0.02), mass=0.01, position=(0, 0, 0))
    live = LiveWorld(fr.World({"beam": turned, "ball": ball}, 2e-3))
    assert live.grab_soft("beam", "right", *end_of(roms["fixed"]))
    start = live.held_at
    assert start[1] == pytest.approx(2.3, abs=1e-12)
    live.mouse = start + np.array([0, 0, 2e-3])
    for _ in range(4000):
        live.step()
    stiffness = live._spring.spring.stiffness
    assert live.contact == live.world.simulator("beam").contact == "right"
    own = live._spring.spring.columns.T @ live.world.simulator("beam").state[0]  # y = Pᵀq, x and y of its own axes
    assert live.force[2] == pytest.approx(stiffness * (2e-3 - own[2]), rel=1e-3)
    assert 1e-3 < (live.held_at - start)[2] < 2e-3
    assert live.account.supplied > 0
    assert abs(gap(live)) < 1e-12 * live.account.supplied
    live.release()
    assert not live.world.simulator("beam").keeps_contact_mode
    live.step()


def test_a_free_beam_follows_the_mouse_and_pushes_a_box(roms):
    """What it pushes has what the mouse supplies, and the account closes."""
    beam = fr.SoftBody(roms["moving"], position=(0.0, 0.0, 0.0))
    box = fr.RigidBody(Box((0.06,) * 3), density=300, position=(0.23, 0, 0))
    live = LiveWorld(fr.World({"beam": beam, "box": box}, 1e-3, friction=0.5))
    assert live.grab_soft("beam", "right", *end_of(roms["moving"]))
    live.mouse = live.held_at + np.array([0.1, 0.0, 0.0])
    for _ in range(300):
        live.step()
    assert live.world.pose("box").velocity[0] > 1e-3
    assert abs(gap(live)) < 1e-10 * live.account.supplied


def test_a_box_that_is_welded_to_a_beam_is_pulled_by_the_mouse(roms):
    """It takes the beam with it, and is where it was after a reset; the account closes."""
    box = fr.RigidBody(Box((0.06,) * 3), density=300, position=(0.33, 0.015, 0.01))
    joints = [SurfaceJoint("beam", "box", "right")]
    live = LiveWorld(fr.World({"beam": fr.SoftBody(roms["fixed"]), "box": box}, 2e-3, joints=joints))
    assert live.grab_rigid("box", np.array((0.36, 0.015, 0.01)))
    live.mouse = live.held_at + np.array((0, 0, 5e-3))
    for _ in range(100):
        live.step()
    assert live.world.pose("box").position[2] > 0.011
    assert np.abs(live.world.simulator("beam").displacement()).max() > 1e-3
    assert abs(gap(live)) < 1e-10 * live.account.supplied
    live.reset()
    np.testing.assert_array_equal(live.world.pose("box").position, box.position)


def test_actuators_of_all_soft_bodies_and_the_history_act_together(roms):
    beams = {name: fr.SoftBody(roms["fixed"], position=(0, y, 0)) for name, y in (("one", 0.0), ("other", 1.0))}

    def history(time, world):
        return {"other": {"pull": 0.01}}

    live = LiveWorld(fr.World(beams, 2e-3), history)
    assert [actuator.name for actuator in live.actuators] == ["one pull", "other pull"]
    live.values[0] = 0.01
    for _ in range(10):
        live.step()
    one, other = (live.world.simulator(name).displacement() for name in beams)
    assert np.abs(one).max() > 0
    np.testing.assert_array_equal(one, other)
