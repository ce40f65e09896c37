"""Contact on nodes of soft bodies of a world: pressure and traction are the forces between them."""

from functools import partial

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from soft_blocks import FAR, pressed
from test_patch import ABOVE, DT, PRESSED, RAMP, SIDE, THICK, YOUNG, block

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.records import RigidBody
from fenics_rom.world.shapes import HalfSpace, Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
ROUND_OFF = 1e-13  # of sums of some 100 numbers, of their sizes


def test_two_soft_blocks_press_one_another_as_they_are_told(tmp_path):
    """After each step, read before energies and after, as others know of a compiled step from there on."""
    low = block(tmp_path, (4, 3, 2), "top", "bottom", 0.0, "fixed")
    up = block(tmp_path, (3, 2, 2), "bottom", "top", THICK, "moving")
    hand = fr.RigidBody(Sphere(0.01), motion=partial(pressed, depth=PRESSED, ramp=RAMP, above=ABOVE))
    bodies = {"hand": hand, "low": fr.SoftBody(low), "up": fr.SoftBody(up, on="hand", position=(0, 0, -ABOVE))}
    world, steps = fr.World(bodies, DT, friction=0.3), 200
    recorder = WorldRecorder(world, steps, snapshots=4)
    for step in range(steps):
        world.step()
        force = world.force_between("low", "up")
        for name, sign in (("low", 1.0), ("up", -1.0)):
            body = world.simulator(name)
            traction, pressure = body.contact_traction(), body.contact_pressure()
            areas, size = body.contact_surface.areas, np.abs(force).max()
            np.testing.assert_allclose(areas @ traction, sign * force, atol=ROUND_OFF * size)
            pressing = pytest.approx(abs(force[2]), rel=1e-6, abs=ROUND_OFF)  # but for the tilt of faces
            assert areas @ pressure == pressing
            world.energy  # noqa: B018, it has all bodies told
            np.testing.assert_array_equal(body.contact_traction(), traction)
        recorder.sample(step + 1)
    exact = YOUNG * PRESSED / (2 * THICK)
    contact = world.simulator("low").nodal_contact
    assert world.simulator("low").contact_surface.areas @ world.simulator("low").contact_pressure() == pytest.approx(
        exact * SIDE**2, rel=1e-2
    )
    run = recorder.record("blocks")
    assert len(run.touched.nodes) == len(contact.nodes) + len(world.simulator("up").nodal_contact.nodes)
    of_low = run.touched.nodes < run.bodies["up"].rows[0]
    np.testing.assert_array_equal(run.touched.forces[-1][of_low], contact.forces)
    fr.write_trajectory(tmp_path / "run.h5", run)
    np.testing.assert_array_equal(fr.read_trajectory(tmp_path / "run.h5").touched.pressing, run.touched.pressing)


@pytest.mark.parametrize("alone", [True, False])
def test_a_body_that_is_put_turned_has_them_in_world_axes(tmp_path, alone):
    """On its side against a wall of its scene, and against one of the world."""
    points, cells = box_arrays((SIDE, SIDE, THICK), (2, 2, 1))
    wall = FAR.replace("-10.0", f"{THICK + 1e-7}").replace("1.0]", "-1.0]")
    text = scene_text(
        write_arrays(tmp_path / "pad.msh", points, cells),
        supports='clamped = ["bottom"]',
        contacts='[contacts.face]\nsurface = "top"',
        **{"effects.contact": "", "effects.contact.obstacles.wall": wall},
        **{"effects.prescribed.pull": 'surface = "top"\nforce = [0.0, 0.0, 10.0]'},
    )
    rom = fr.reduce(fr.assemble(parse_scene(text)), order=6)
    pad = fr.SoftBody(rom, rotation=(np.sqrt(0.5), 0, np.sqrt(0.5), 0))  # its z is x of the world
    bodies = {"pad": pad}
    if not alone:
        turned = (np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0)  # outward is -x
        bodies["wall"] = RigidBody(HalfSpace(), position=(THICK + 1e-7, 0, 0), rotation=turned)
    world = fr.World(bodies, 1e-3)
    for _ in range(200):
        world.step()
    body = world.simulator("pad")
    push = body.contact_surface.areas @ body.contact_traction()
    assert push[0] < -1.0
    assert np.abs(push[1:]).max() <= 1e-12 * -push[0]
