"""Bodies that turn as far as they like, from the scene to plots, films and the mouse: thrown, and carried by a base."""

import warnings

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization.contact_surface import divide_contact_triangles
from fenics_rom.visualization.optional_dependencies import pyvista_package
from fenics_rom.visualization.viewer.live_body import LiveBody

pyvista_package()  # before dolfinx
pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")  # coarse boxes lock, and bend
THROWN = {
    "supports": None,
    "effects": "inertia = {}",
    "run": "dt = 0.01\nduration = 0.6\nsnapshots = 6\n"
    "initial = { rotation = [0, 0, 2.0], velocity = [1.0, 0, 2.0], spin = [0.5, 6.0, 0.1] }",
}
CARRIED = {
    "effects": "inertia = {}\ndamping.beta = 1e-2\ngravity.acceleration = [0, 0, -9.81]\nbase_path.table = 'path.csv'",
    "run": "dt = 0.01\nduration = 2.0\nsnapshots = 8",
}
TURN = np.array([[0.0, 0, 0, 0, 1, 0, 0, 0], [0.5, 0, 0, 0.2, np.sqrt(0.5), 0, np.sqrt(0.5), 0]])


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("moving") / "box.msh", *box_arrays((0.4, 0.1, 0.06), (4, 1, 1)))


def made(mesh, parts):
    """The scene of a box in a moving frame, and its ROM."""
    text = 'frame = "moving"\n' + scene_text(mesh, **{"contacts": '[contacts.end]\nsurface = "right"'} | parts)
    scene = parse_scene(text, tables={"path.csv": TURN})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        return scene, fr.reduce(fr.assemble(scene), method="modal", order=6)


@pytest.fixture(scope="module")
def thrown(mesh):
    return made(mesh, THROWN)


def test_thrown_body_from_scene_to_film(thrown, tmp_path):
    _, rom = thrown
    fr.write_rom(tmp_path / "rom.h5", rom)
    run = fr.simulate(fr.read_rom(tmp_path / "rom.h5"))
    fr.write_trajectory(tmp_path / "run.h5", run)
    run = fr.read_trajectory(tmp_path / "run.h5")
    assert run.balance_error < 1e-13
    assert np.ptp(run.energy) < 1e-13 * run.energy[0]
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-13 * np.abs(run.momentum[0]).max()
    mass = rom.moving_frame.mass
    np.testing.assert_allclose(run.momentum[0, :3], mass * np.array([1.0, 0, 2.0]), rtol=1e-13)
    middle = rom.moving_frame.origin + np.outer(run.times, [1.0, 0, 2.0])
    np.testing.assert_allclose(run.pose[:, :3], middle, atol=1e-13)
    assert abs(run.pose[0, 3]) == pytest.approx(np.cos(1.0))  # turned by 2 rad at the start
    y = (run.nodes + run.snapshots[-1] - run.pose[-1, :3]) @ rotation_matrix(run.pose[-1, 3:])
    assert 1e-6 < np.abs(y - (run.nodes - rom.moving_frame.origin)).max() < 1e-3  # m: bent, and no more than that
    assert run.base_wrench is None
    fr.plot(run, tmp_path / "run.png", what=["momentum", "rotation"])
    film = fr.export(run, tmp_path / "run.gif", seconds=0.1)
    assert film.stat().st_size > 1000


def test_thrown_body_at_full_order_is_where_the_reduced_one_is(thrown):
    scene, rom = thrown
    differences = fr.compare(fr.simulate(rom), fr.simulate(scene))
    assert differences["position"].largest < 1e-12
    assert differences["shape"].relative < 1e-3
    assert differences["elastic shape"].relative < 0.2  # of six modes
    assert differences["momentum"].relative < 1e-12


def test_carried_body_from_scene_to_plot(mesh, tmp_path):
    """Long after the swing the base carries the weight, and holds its moment about the origin."""
    _, rom = made(mesh, CARRIED)
    fr.write_rom(tmp_path / "rom.h5", rom)
    run = fr.simulate(fr.read_rom(tmp_path / "rom.h5"))
    assert run.balance_error < 1e-12
    origin, mass = rom.moving_frame.origin, rom.moving_frame.mass
    np.testing.assert_allclose(run.pose[-1], TURN[-1, 1:], atol=1e-12)
    np.testing.assert_allclose(run.base_wrench[-1, :3], [0, 0, 9.81 * mass], atol=0.005 * 9.81 * mass)  # it still rings
    clamped = np.flatnonzero(np.isclose(run.nodes[:, 0], 0))
    upright = (run.nodes[clamped] - origin) @ rotation_matrix(TURN[-1, 4:]).T + TURN[-1, 1:4]
    np.testing.assert_allclose((run.nodes + run.snapshots[-1])[clamped], upright, atol=1e-12)
    centre = run.node_mass @ (run.nodes + run.snapshots[-1]) / mass - TURN[-1, 1:4]
    np.testing.assert_allclose(run.base_wrench[-1, 3:], np.cross(centre, [0, 0, 9.81 * mass]), atol=0.01 * mass)
    text = fr.plot(run, tmp_path / "run.svg", what=["base_force", "base_torque"])[0].read_text()
    assert "base torque" in text


@pytest.mark.parametrize("dt", [1e-3, 0.02])
def test_mouse_throws_a_free_body(thrown, dt):
    """What the mouse gives is supplied, at any step; let go, the body keeps its momenta, however it is turned."""
    _, rom = thrown
    body = LiveBody(rom, dt)
    corner = rom.triangles[divide_contact_triangles(rom)["end"][0]]
    assert body.grab("end", corner, np.ones(3) / 3)
    at_rest = body.held_at
    np.testing.assert_allclose(at_rest, rom.nodes[corner].mean(axis=0), atol=1e-12)
    body.mouse = at_rest + np.array([0.0, 0.1, 0.3])
    body.step()
    assert np.dot(body.simulator.momentum[0], [0.0, 0.1, 0.3]) > 0
    for _ in range(40):
        body.step()
    assert body.account.supplied > 0
    body.release()
    before = np.concatenate(body.simulator.momentum)
    for _ in range(40):
        body.step()
    np.testing.assert_allclose(np.concatenate(body.simulator.momentum), before, atol=1e-12 * np.abs(before).max())
    account = body.account
    assert abs(account.stored - account.supplied) < 1e-11 * account.supplied  # nothing is damped


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
def test_mouse_feeds_no_body_that_it_holds_far_from_where_it_pulls(mesh, dt):
    """At a corner of a skin that is pushed as a whole: what the mouse gives is never more than its spring had."""
    skin = "[contacts.skin]\nnear = { point = [0.2, 0.05, 0.03], radius = 1.0 }"
    _, rom = made(mesh, THROWN | {"contacts": skin, "material": "young = 1e6\npoisson = 0.3\ndensity = 1000.0"})
    body = LiveBody(rom, dt)
    corner = rom.triangles[divide_contact_triangles(rom)["skin"][0]]
    assert body.grab("skin", corner, np.ones(3) / 3)
    before, away = body.simulator.energy, np.array([0.02, 0.1, 0.1])
    body.mouse = body.mouse + away
    for _ in range(round(1.0 / dt)):
        body.step()
        assert body.simulator.energy - before <= 1.01 * body.spring.largest * np.linalg.norm(away)
    assert body.account.supplied > 0


def test_mouse_takes_hold_elsewhere_in_flight(mesh):
    """Where what the next contact mode lacks of the shape is carried along."""
    ends = "".join(f'[contacts.{side}]\nsurface = "{side}"\n' for side in ("left", "right"))
    scene, _ = made(mesh, THROWN | {"contacts": ends, "effects": "inertia = {}\ndamping.beta = 1e-4"})
    rom = fr.reduce(fr.assemble(scene), order=6)
    body, orders = LiveBody(rom, 1e-3), []
    for side in ("left", "right", "left"):
        assert body.grab(side, rom.triangles[divide_contact_triangles(rom)[side][0]], np.ones(3) / 3)
        body.mouse = body.mouse + np.array([0.0, 0.01, 0.03])
        for _ in range(20):
            body.step()
        orders.append(len(body.simulator.state[0]))
        body.release()
    account = body.account
    assert orders == [6, 8, 8]
    assert abs(account.stored - account.supplied + account.dissipated + account.lost) < 1e-11 * account.supplied
