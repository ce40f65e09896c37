"""Whole faces of soft bodies in worlds: pins and sharp edges do not get in between nodes; momenta and accounts stay."""

import warnings

import numpy as np
import pytest
from pads import RUBS, UP, L, R, pad_scene, shape
from test_soft_motion import momenta, ride
from triangle_meshes import groove
from turning import spin

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics.frame_motion import quaternion_of_vector, rotation_matrix
from fenics_rom.world.collision.contacts import PlacedShape
from fenics_rom.world.collision.find import find_contacts
from fenics_rom.world.shapes import Box, Capsule, Cylinder, Hull, Mesh, Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
X, Y, LOW = 1.3 * L, 1.55 * L, 1.0001 * L  # between nodes, and where a pin begins
FAR = 'obstacles.far = { shape = "half-space", point = [0.0, 0.0, 1.0], normal = [0.0, 0.0, -1.0] }'
SPIKE = [(0.0, 0.0, 0.0), *((4 * R * x, 4 * R * y, 8 * R) for x in (-1, 1) for y in (-1, 1))]


def rom_of(folder, obstacle=FAR, frame="fixed", order=10, points="faces", **parts):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(pad_scene(folder, obstacle, None, frame, points, **parts)), order=order)


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """By its weight on what is above it."""
    return rom_of(tmp_path_factory.mktemp("pad"), **UP, **RUBS)


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """It may be touched all around."""
    return rom_of(
        tmp_path_factory.mktemp("free"), frame="moving", supports=None, contacts='[contacts.skin]\nsurface = "skin"'
    )


def depth_of(world, pin, soft="pad"):
    """How deep a rigid body is in the faces of a soft one, m."""
    body, pose = world.simulator(soft), world.pose("pin")
    placed = PlacedShape(pin, pose.position, rotation_matrix(pose.rotation))
    contacts = find_contacts(body.surface._replace(points=body.places()), placed, 0.0)
    return -contacts.gaps.min(initial=0.0)


def hull():
    spike = Hull(SPIKE)
    return spike, (X, Y, LOW + spike.shift[2])


@pytest.mark.parametrize("kind", ["ball", "peg", "cylinder", "log", "spike", "mesh"])
def test_a_pin_between_nodes_stays_outside(tmp_path, pressed, kind):
    """At rest; a ball and a peg with the force that they have as obstacles of the pad's own scene, to 1e-4."""
    half = (X, Y, LOW + R)
    pins = {"ball": (Sphere(R), half), "peg": (Box((2 * R,) * 3), half), "cylinder": (Cylinder(R, 2 * R), half)}
    pins["log"] = Cylinder(R, 2.2 * L), half
    pins["mesh"] = Mesh(*Box((2 * R,) * 3).surface()), half
    pin, place = {**pins, "spike": hull()}[kind]
    lies = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0) if kind == "log" else (1.0, 0.0, 0.0, 0.0)
    bodies = {"pad": fr.SoftBody(pressed), "pin": fr.RigidBody(pin, position=place, rotation=lies)}
    world = fr.World(bodies, 1e-3, friction=0.4, gravity=(0, 0, 0))
    gap, touching = ride(world, 60)
    assert touching >= 1
    assert depth_of(world, pin) <= (1e-3 if kind == "log" else 1e-4) * R
    assert gap <= 1e-13 * world.ledger.supplied
    force = world.force_between("pad", "pin")
    assert force[2] < -0.1
    if kind in {"ball", "peg"}:
        body = fr.Simulator(rom_of(tmp_path, shape(kind, X, Y, 1e-4 * L), **UP, **RUBS), 1e-3)
        for _ in range(60):
            body.step()
        assert np.abs(force - body.contact_forces("pin")).max() <= 1e-4 * np.abs(force).max()


def test_nodes_alone_let_it_in(tmp_path):
    """As a pad does whose scene does not say otherwise; it says so."""
    pad, pin = fr.SoftBody(rom_of(tmp_path, points="nodes", **UP)), fr.RigidBody(Sphere(R), position=(X, Y, LOW + R))
    world = fr.World({"pad": pad, "pin": pin}, 1e-3, gravity=(0, 0, 0))
    for _ in range(60):
        world.step()
    assert not world.force_between("pad", "pin").any()
    assert any("pin" in told for told in world.warnings)


@pytest.mark.parametrize(
    ("pin", "axis", "rate", "deep"),
    [
        (Sphere(R), [0, 1, 0], 20.0, 1e-5),
        (Capsule(R, 2 * L), [0, 0, 1], 10.0, 2e-2),
        (Box((2 * R,) * 3), [0, 0.6, 0.8], 3.0, 1e-3),
    ],
    ids=["ball", "rod", "peg"],
)
def test_a_pin_that_is_driven_turns_between_nodes(pressed, pin, axis, rate, deep):
    """Its work closes the account; it sinks in by what it turns in a step times what it slides."""
    turns, lies = spin((X, Y, LOW + R), axis, rate, 0.02), isinstance(pin, Capsule)

    def motion(time):
        state = turns(time)
        if not lies:
            return state
        angle = 2 * np.arctan2(state.rotation[3], state.rotation[0])  # about z, of what lies along x
        c, s = np.cos(angle / 2) / np.sqrt(2), np.sin(angle / 2) / np.sqrt(2)
        return state._replace(rotation=np.array([c, -s, c, s]))

    pad, driven = fr.SoftBody(pressed), fr.RigidBody(pin, motion=motion)
    world, deepest = fr.World({"pad": pad, "pin": driven}, 1e-3, friction=0.4, gravity=(0, 0, 0)), 0.0
    for _ in range(60):
        world.step()
        deepest = max(deepest, depth_of(world, pin))
    gone = world.ledger
    assert abs(world.energy - gone.supplied + gone.dissipated) <= 1e-13 * gone.supplied
    assert world.force_between("pad", "pin")[2] < -0.1
    assert deepest <= deep * R
    assert world.account("pin").obstacles != 0.0


def test_a_free_pad_and_a_pin_that_flies_keep_both_momenta(free):
    pin = fr.RigidBody(Sphere(R), density=5e4, position=(-0.7 * L, -0.45 * L, 0.5 * L + 1.2 * R), velocity=(0, 0, -0.3))
    world = fr.World({"pad": fr.SoftBody(free), "pin": pin}, 1e-3, friction=0.4, gravity=(0, 0, 0))
    begun, energy = momenta(world), world.energy
    gap, touching = ride(world, 40)
    assert touching >= 1
    assert gap <= 1e-13 * energy
    for now, then in zip(momenta(world), begun, strict=True):
        np.testing.assert_allclose(now, then, rtol=0, atol=1e-14 * np.linalg.norm(begun[0]))
    assert world.pose("pin").velocity[2] > -0.1


@pytest.mark.parametrize("points", ["faces", "nodes"])
def test_sharp_edges_of_two_pads_do_not_pass_through_one_another(tmp_path, points):
    """Crossed, with no node near where they meet: of whole faces they bounce, of points they are through."""
    skin = {"supports": None, "contacts": '[contacts.skin]\nsurface = "skin"'}
    rom = rom_of(tmp_path, frame="moving", points=points, **skin)
    high = np.hypot(2 * L, L / 2)  # of the edge over the middle
    tilt = np.arctan2(2 * L, L / 2)
    low, up = quaternion_of_vector([0.0, tilt, 0.0]), quaternion_of_vector([np.pi - tilt, 0.0, 0.0])
    bodies = {
        "low": fr.SoftBody(rom, position=(0.0, 0.0, 0.0), rotation=low),
        "up": fr.SoftBody(rom, position=(0.4 * L, 0.4 * L, 2 * high + 2e-4), rotation=up, velocity=(0.0, 0.0, -0.2)),
    }
    world = fr.World(bodies, 1e-3, friction=0.3, gravity=(0, 0, 0))
    begun, energy = momenta(world), world.energy
    gap, touching = ride(world, 5)
    assert gap <= 1e-13 * energy
    for now, then in zip(momenta(world), begun, strict=True):
        np.testing.assert_allclose(now, then, rtol=0, atol=1e-13 * np.linalg.norm(begun[0]))
    assert (touching > 0) == (points == "faces")


def test_a_pad_is_thrown_into_a_groove(free):
    """Thrown on a mesh that is not convex, whose edge bends in, and meets no face."""
    ground = groove(0.3)
    vee = fr.RigidBody(Mesh(ground.vertices, ground.triangles, bool(ground.open)))
    bodies = {"ground": vee, "pad": fr.SoftBody(free, position=(0.0, 0.0, 3 * L), velocity=(0.0, 0.0, -0.4))}
    world = fr.World(bodies, 2e-3, friction=0.3, gravity=(0, 0, 0))
    begun = world.energy
    gap, touching = ride(world, 100)
    assert touching >= 2
    assert gap <= 1e-13 * begun
    assert ground.distance(world.simulator("pad").places())[0].min() > -1e-6


@pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off")
def test_compiled_steps_are_those_of_numpy(pressed):
    def run():
        bodies = {"pad": fr.SoftBody(pressed), "pin": fr.RigidBody(Box((2 * R,) * 3), position=(X, Y, LOW + R))}
        world = fr.World(bodies, 1e-3, friction=0.4, gravity=(0, 0, 0))
        for _ in range(30):
            world.step()
        return world

    world = run()
    assert world._loops is not None
    assert world._loops.is_ahead
    with numpy_alone():
        other = run()
    force = other.force_between("pad", "pin")
    np.testing.assert_allclose(world.force_between("pad", "pin"), force, rtol=0, atol=1e-9 * np.abs(force).max())
