"""A screw that turns drives a soft nut in a world: by a pitch a turn, with the work that the nut's load takes."""

import numpy as np
import pytest
from bodies import box_arrays, box_surfaces, write_arrays
from turning import spin

import fenics_rom as fr
from fenics_rom.mechanics.obstacle_poses import distance_from, pose_row
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.shapes import Mesh

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
PITCH, CORE, THREAD, CLEARANCE = 0.01, 0.018, 2e-3, 2.5e-4  # m; the threads are a sine
NUT, CELLS = (0.02, 0.006, 0.008), (16, 2, 2)  # m: two pitches long
LOAD, RATE = 0.05, 4 * np.pi  # N against which it goes, rad/s
SCENE = """
[mesh]
file = "nut.msh"
[material]
young = 1e6
poisson = 0.3
density = 1000.0
[[supports.held]]
plane = {{ point = [0, 0, {top}], normal = [0, 0, 1] }}
normal = [0, 0, 1]
[[supports.held]]
plane = {{ point = [0, 0, {top}], normal = [0, 0, 1] }}
normal = [0, 1, 0]
[contacts.skin]
surface = "bottom"
[outputs.end]
points = [[{end}, 0.0, {top}]]
[effects]
inertia = {{}}
damping = {{ alpha = 0.0, beta = 2e-3 }}
contact.obstacles.floor = {{ shape = "half-space", point = [0, 0, -10], normal = [0, 0, 1] }}
[effects.prescribed.load]
point = [{end}, 0.0, {top}]
force = [-{load}, 0, 0]
"""


def radius(x, around):
    """Of the screw: its threads climb by a pitch a turn."""
    return CORE - THREAD * np.cos(2 * np.pi * x / PITCH - around)


def screw(turns=5, about=32, along=12):
    """An open surface, whose inside is solid, along x."""
    x, around = np.linspace(-turns / 2, turns / 2, turns * along + 1) * PITCH, 2 * np.pi * np.arange(about) / about
    r = radius(x[:, None], around)
    places = np.stack([np.broadcast_to(x[:, None], r.shape), r * np.sin(around), r * np.cos(around)], axis=-1)
    row = np.arange(len(x) - 1)[:, None] * about
    a, b = (row + np.arange(about)).ravel(), (row + (np.arange(about) + 1) % about).ravel()
    triangles = np.concatenate([np.stack(each, axis=1) for each in ((a, a + about, b), (b, a + about, b + about))])
    return Mesh(places.reshape(-1, 3), triangles, open=True)


def nut(folder):
    """A block on the screw, whose threads it has."""
    points, cells = box_arrays(NUT, CELLS)
    surfaces, (x, y, z) = box_surfaces(points, cells), points.T
    x, y = x - NUT[0] / 2, y - NUT[1] / 2
    low = np.full(len(x), CORE)
    for _ in range(50):  # where it is over the screw
        low = np.sqrt((radius(x, np.arctan2(y, low)) + CLEARANCE) ** 2 - y**2)
    top = CORE + THREAD + NUT[2]
    points = np.stack([x, y, low + (top - low) * z / NUT[2]], axis=1)
    write_arrays(folder / "nut.msh", points, cells, surfaces)
    text = SCENE.format(top=top, end=NUT[0] / 2, load=LOAD)
    return fr.reduce(fr.assemble(parse_scene(text, folder=folder)), order=8)


def test_a_screw_drives_a_soft_nut(tmp_path):
    """The last turn advances it by a pitch; what the screw gives the load takes, or is dissipated or stored."""
    rom, thread, dt = nut(tmp_path), screw(), 1e-3
    bodies = {"screw": fr.RigidBody(thread, motion=spin([0, 0, 0], [1, 0, 0], RATE, 0.1)), "nut": fr.SoftBody(rom)}
    world, places, pushed = fr.World(bodies, dt), [0.0], [0.0]
    begun, soft, left = world.energy, world.simulator("nut"), 0.0
    while world.time < 0.7:
        world.step()
        places.append(soft.displacement("end")[0, 0])
        pushed.append(soft.contact_forces()[:, 0].sum())
        gone = world.ledger
        lost = gone.dissipated + gone.lost_in_switching + gone.numerical
        left = max(left, abs(world.energy - begun - gone.supplied + lost))
    turn = round(2 * np.pi / RATE / dt)
    assert places[-1] - places[-1 - turn] == pytest.approx(PITCH, rel=1e-3)
    assert np.mean(pushed[-turn:]) == pytest.approx(LOAD, rel=1e-2)
    work, of_load = -world.account("screw").obstacles, -LOAD * places[-1]
    assert work > -of_load > 0
    supplied = pytest.approx(work + of_load, abs=1e-4 * work)  # its point yields beyond the basis, too
    assert gone.supplied == supplied
    assert left <= 1e-13 * work
    assert min(gone.contact, gone.friction) >= -1e-12 * work
    pose = pose_row(world.pose("screw"), np.zeros(3))
    gaps, _ = distance_from(thread.obstacle, rom.nodes + soft.displacement(), pose)
    assert gaps.min() > -5e-5  # as it turns in a step
