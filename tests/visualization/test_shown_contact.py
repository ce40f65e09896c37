"""Contact pressure on pages: in colours where bodies can be touched, with arrows, through what hides it."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene
from fenics_rom.visualization import optional_dependencies
from fenics_rom.visualization.contact_fields import ContactFields
from fenics_rom.visualization.viewer.live_body import LiveBody
from fenics_rom.visualization.viewer.live_page import LivePage
from fenics_rom.visualization.viewer.live_world import LiveWorld
from fenics_rom.visualization.viewer.run_page import RunPage
from fenics_rom.visualization.viewer.surface import Surface
from fenics_rom.visualization.viewer.world_page import WorldPage
from fenics_rom.world.shapes import HalfSpace

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
SIDE = 0.1
PRESSED = {
    "contacts": '[contacts.sole]\nsurface = "bottom"',
    "supports": 'clamped = ["top"]',
    "effects.contact.obstacles.floor": 'shape = "half-space"\npoint = [0, 0, -1e-5]\nnormal = [0, 0, 1]',
    "effects.gravity": "acceleration = [0.0, 0.0, -500.0]",
    "run": "dt = 1e-3\nduration = 0.1\nsnapshots = 4",
}


@pytest.fixture(scope="module")
def rom(tmp_path_factory):
    """Of a block that its weight presses on a floor."""
    file = write_arrays(tmp_path_factory.mktemp("block") / "block.msh", *box_arrays((SIDE,) * 3, (3, 3, 3)))
    material = "young = 1e5\npoisson = 0.3\ndensity = 1000.0"
    return fr.reduce(fr.assemble(parse_scene(scene_text(file, material=material, **PRESSED))), order=8)


def shown(page, server, prefix):
    """The arrows (k, 2, 3), m, that are seen, and how far obstacles can be seen through."""
    page._draw(*([page._seen()] if hasattr(page, "_seen") else [len(page._times) - 1]))
    next_picture = getattr(page, "next_picture", None) or page._next_picture
    next_picture.show()
    nodes = server.scene._handle_from_node_name
    arrows = nodes[f"{prefix}/tractions"]
    return (arrows.points if arrows.visible else np.empty((0, 2, 3))), nodes


def check_pressed(page, server, prefix, floor):
    """Arrows end below the block, and both they and the floor go back with another colour."""
    before = server.scene._handle_from_node_name[floor].opacity
    page._field.value = "contact pressure"
    arrows, nodes = shown(page, server, prefix)
    assert len(arrows) >= 4
    assert np.abs(arrows[:, 1, 2]).max() < 0.05  # of the block
    assert (arrows[:, 0, 2] < arrows[:, 1, 2]).all()
    assert nodes[floor].opacity < 0.5
    assert page._colours.largest > 500.0  # Pa; the weight is up to 50 kPa, and most hangs
    page._field.value = "displacement"
    page._colours.clear()
    arrows, nodes = shown(page, server, prefix)
    assert not len(arrows)
    assert nodes[floor].opacity == before


def test_runs_beside_each_other(rom, viser_server):
    run = fr.simulate(rom)
    page = RunPage(optional_dependencies.viser_package(), [run, run], ["one", "other"]).show_on(viser_server)
    check_pressed(page, viser_server, "/run_0", "/run_0/obstacles/floor")
    page._field.value = "contact pressure"
    page._draw(3)
    assert "contact pressure up to" in page._status.content


def test_a_live_body(rom, viser_server, tmp_path):
    body = LiveBody(rom)
    page = LivePage(optional_dependencies.viser_package(), viser_server, body, tmp_path, "block", print)
    for _ in range(100):
        body.step()
    check_pressed(page, viser_server, "/body", "/body/obstacles/floor")


def test_a_live_world(rom, viser_server):
    world = fr.World({"floor": fr.RigidBody(HalfSpace(), position=(0, 0, -1e-5)), "block": fr.SoftBody(rom)}, 1e-3)
    live = LiveWorld(world)
    page = WorldPage(optional_dependencies.viser_package(), viser_server, live, "world")
    for _ in range(100):
        live.step()
    check_pressed(page, viser_server, "/block", "/floor")


def test_colours_end_at_edges_of_the_contact_surface(rom):
    """Sides of the block have none, though nodes of its lower edges are touched."""
    fields, surface = ContactFields(fr.simulate(rom)), Surface(rom.nodes, rom.triangles)
    pressure = fields.pressure(3)
    values = surface.of_nodes(pressure[surface.nodes], fields.touchable)
    assert pressure[rom.triangles[~fields.touchable]].any()
    assert not values[surface.faces[~fields.touchable]].any()
    np.testing.assert_array_equal(values[surface.faces[fields.touchable]], pressure[rom.triangles[fields.touchable]])


def test_bodies_without_contact_are_not_asked_for_it(plate_rom, viser_server):
    run = fr.simulate(plate_rom)
    assert run.touched is None
    page = RunPage(optional_dependencies.viser_package(), [run], ["one"]).show_on(viser_server)
    assert "contact pressure" not in page._field.options
