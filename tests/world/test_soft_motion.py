"""Soft bodies among others, held, free and carried: momenta and accounts to round-off."""

import warnings

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.mechanics.base_path import quaternion_product
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.runtime.steppers.pushed_step import PushedPoints, PushedStep
from fenics_rom.scene.file import parse_scene
from fenics_rom.world.handed_forces import handed
from fenics_rom.world.joints import Joint, weld
from fenics_rom.world.shapes import Box, Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
LIES = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
CLAMPED = {"supports": 'clamped = ["left"]'}
TOUCHED = {
    "effects.contact": "",
    "effects.contact.obstacles.floor": 'shape = "half-space"\npoint = [0.0, 0.0, -10.0]\nnormal = [0.0, 0.0, 1.0]',
}


def assembled_beam(folder, *, frame, **parts):
    """A beam of 0.3 m along x, whose end and top may be touched."""
    mesh = write_arrays(folder / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (6, 1, 1)))
    material = "young = 5e5\npoisson = 0.4\ndensity = 1100.0"
    text = scene_text(mesh, material=material, damping="alpha = 0.5, beta = 2e-4", **{"supports": None, **parts})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.assemble(parse_scene(f'frame = "{frame}"\n{text}'))


def reduced(folder, *, frame, order=12, **parts):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(assembled_beam(folder, frame=frame, **parts), order=order)


@pytest.fixture(scope="module")
def roms(tmp_path_factory):
    kinds = {
        "held": {"frame": "fixed", **CLAMPED},
        "free": {"frame": "moving"},
        "carried": {"frame": "moving", "effects.base_path": "origin = [0.0, 0.015, 0.01]", **CLAMPED},
    }
    return {kind: reduced(tmp_path_factory.mktemp(kind), **parts, **TOUCHED) for kind, parts in kinds.items()}


def momenta(world):
    """Of all bodies, linear and angular about the origin."""
    linear, angular = np.zeros(3), np.zeros(3)
    for name, record in world.bodies.items():
        pose = world.pose(name)
        if isinstance(record, fr.SoftBody):
            P, L = world.simulator(name).momentum
        else:
            mass, inertia = record.mass_and_inertia()
            w, *v = pose.rotation
            cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
            R = np.eye(3) + 2 * w * cross + 2 * cross @ cross
            P, L = mass * pose.velocity, R @ inertia @ R.T @ pose.angular_velocity
        linear, angular = linear + P, angular + L + np.cross(pose.position, P)
    return linear, angular


def ride(world, steps):
    """Takes steps; the largest gap of the account, J, and how many pairs of points touched at most."""
    start, gap, touching = world.energy, 0.0, 0
    for _ in range(steps):
        world.step()
        gone = world.ledger
        gap = max(gap, abs(world.energy - start - gone.supplied + gone.dissipated + gone.lost_in_switching))
        touching = max(touching, world.touching)
    return gap, touching


BOX = {"shape": Box((0.06, 0.06, 0.03)), "density": 500}


def test_a_box_falls_on_a_held_beam_and_the_account_closes(roms):
    box = fr.RigidBody(**BOX, position=(0.25, 0.015, 0.037))
    world = fr.World({"beam": fr.SoftBody(roms["held"]), "box": box}, 1e-3, gravity=(0, 0, -9.81), friction=0.5)
    gap, touching = ride(world, 60)
    assert touching >= 2
    assert gap < 1e-13
    np.testing.assert_array_equal(world.force_between("box", "beam"), -world.force_between("beam", "box"))
    assert world.account("beam").obstacles > 0
    assert world.ledger.contact > 0


def test_a_beam_that_is_put_turned_bends_alike(roms):
    """By 90° about z, elsewhere: the same, to round-off."""
    half = np.sqrt(0.5)
    turns = []
    for rotation, place, corner in (((1, 0, 0, 0), (0.25, 0.015), (0, 0)), ((half, 0, 0, half), (0.985, 2.25), (1, 2))):
        box = fr.RigidBody(**BOX, position=(*place, 0.037), rotation=rotation)
        beam = fr.SoftBody(roms["held"], position=(*corner, 0), rotation=rotation)
        world = fr.World({"beam": beam, "box": box}, 1e-3, gravity=(0, 0, -9.81), friction=0.5)
        ride(world, 40)
        turns.append(world.simulator("beam").displacement())
    assert np.abs(turns[0]).max() > 1e-4
    np.testing.assert_allclose(turns[1], turns[0], atol=1e-12)


def test_a_free_beam_and_a_box_keep_both_momenta(roms):
    box = fr.RigidBody(**BOX, position=(0.1, 0, 0.04), velocity=(0.1, 0, -0.5), angular_velocity=(1, 2, 3))
    world = fr.World({"beam": fr.SoftBody(roms["free"]), "box": box}, 1e-3, friction=0.5)
    start = momenta(world)
    gap, touching = ride(world, 60)
    assert touching >= 2
    assert gap < 1e-13
    for now, then in zip(momenta(world), start, strict=True):
        assert np.abs(now - then).max() < 1e-12


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_two_free_beams_that_meet_keep_both_momenta(roms, friction):
    """Across the gap that is left, too: one of them is pushed where the other has its point, off its own surface."""
    above = fr.SoftBody(
        roms["free"], position=(0.02, 0.004, 0.026), rotation=(0, np.cos(0.1), np.sin(0.1), 0), velocity=(0, 0, -0.3)
    )
    world = fr.World({"below": fr.SoftBody(roms["free"]), "above": above}, 1e-3, friction=friction)
    (P, L), (gap, touching) = momenta(world), ride(world, 25)
    assert touching >= 1
    assert gap < 1e-13
    assert np.abs(momenta(world)[0] - P).max() < 1e-13
    assert np.abs(momenta(world)[1] - L).max() < 1e-15


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
def test_the_face_of_a_beam_is_welded_to_a_box_that_flies(roms, dt):
    """All nodes of the face stay where they are on the box, to round-off, and both momenta and the account do."""
    places = fr.Simulator(roms["free"], dt).contact_coordinates
    places = places - roms["free"].moving_frame.origin
    face = np.flatnonzero(places[:, 0] > places[:, 0].max() - 1e-9)
    middle = (places[face[0], 0] + 0.03, 0, 0)
    box = fr.RigidBody(
        Box((0.06, 0.06, 0.06)), density=500, position=middle, velocity=(0, 0.1, 0.2), angular_velocity=(0, 2, 1)
    )
    weld = Joint("beam", "box", tuple(map(tuple, places[face].tolist())))
    world = fr.World({"beam": fr.SoftBody(roms["free"]), "box": box}, dt, joints=[weld])
    (P, L), (gap, _) = momenta(world), ride(world, 60)
    assert gap < 1e-13
    for now, then in zip(momenta(world), (P, L), strict=True):
        assert np.abs(now - then).max() < 1e-14
    pose = world.pose("box")
    on_box = pose.position + (places[face] - middle) @ rotation_matrix(pose.rotation).T
    np.testing.assert_allclose(world.simulator("beam").places()[face], on_box, rtol=0, atol=1e-13)
    assert np.linalg.norm(world.force_between("beam", "box")) > 1e-3


@pytest.mark.parametrize("kind", ["held", "free"])
def test_a_body_goes_to_the_contact_mode_that_is_touched(roms, kind):
    """A box falls on the top, with the end as the contact mode to begin with: the account closes."""
    place = (0.2, 0.015, 0.037) if kind == "held" else (0.05, 0, 0.027)
    box = fr.RigidBody(**BOX, position=place, velocity=(0, 0, -0.3))
    world = fr.World({"beam": fr.SoftBody(roms[kind]), "box": box}, 1e-3, friction=0.5, restitution=0.5)
    assert world.simulator("beam").contact == "right"
    gap, touching = ride(world, 20)
    assert touching >= 1
    assert world.simulator("beam").contact == "top"
    assert gap < 1e-13


def test_a_carried_beam_lifts_a_box(roms):
    """The work of what carries it is supplied."""
    rises = np.array([0, 0, 0.1])
    palm = fr.RigidBody(Sphere(0.005), motion=lambda t: LIES._replace(position=t * rises, velocity=rises))
    box = fr.RigidBody(**BOX, position=(0.2, 0.0, 0.0255))
    beam = fr.SoftBody(roms["carried"], on="palm")
    world = fr.World(
        {"palm": palm, "beam": beam, "box": box}, 1e-3, gravity=(0, 0, -9.81), friction=0.5, apart=[("palm", "beam")]
    )
    gap, touching = ride(world, 30)
    assert touching >= 2
    assert gap < 1e-12


def test_a_mounted_beam_moves_as_one_whose_carrier_is_where_the_mount_is(roms):
    """On a palm that turns and rises it is where a carrier of its own would be, and strikes a box alike."""
    at, mounted = np.array([0.02, -0.01, 0.03]), np.array([0.8, 0, 0.6, 0])
    spin, rises = np.array([0, -3.0, 0]), np.array([0, 0, 0.2])

    def palm(t):
        return fr.BaseState(t * rises, np.array([np.cos(1.5 * t), 0, -np.sin(1.5 * t), 0]), rises, spin)

    def root(t):
        state = palm(t)
        arm = rotation_matrix(state.rotation) @ at
        turned = quaternion_product(state.rotation, mounted)
        return fr.BaseState(state.position + arm, turned, rises + np.cross(spin, arm), spin)

    middle = at + rotation_matrix(mounted) @ (0.2, 0, 0.0256)
    box = fr.RigidBody(**BOX, position=middle, rotation=mounted)
    worlds = [
        fr.World(
            {"palm": fr.RigidBody(Sphere(0.001), motion=motion), "beam": beam, "box": box},
            1e-3,
            apart=[("palm", "beam")],
        )
        for motion, beam in (
            (palm, fr.SoftBody(roms["carried"], on="palm", position=at, rotation=mounted)),
            (root, fr.SoftBody(roms["carried"], on="palm")),
        )
    ]
    for _ in range(30):
        for world in worlds:
            world.step()
    one, other = worlds
    assert np.linalg.norm(other.velocity("box")[0]) > 0.5
    for velocities in zip(one.velocity("box"), other.velocity("box"), strict=True):
        np.testing.assert_allclose(*velocities, rtol=0, atol=1e-11)
    places = [world.simulator("beam").places() for world in worlds]
    np.testing.assert_allclose(*places, rtol=0, atol=1e-13)
    for numbers in zip(one.pose("beam"), other.pose("beam"), strict=True):
        np.testing.assert_allclose(*numbers, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", ["held", "carried"])
def test_points_answer_forces_as_they_then_move(roms, kind):
    """Also on a base that turns and speeds up: to round-off of the velocities, which the sweeps of a step rely on."""
    body = fr.Simulator(roms[kind], 5e-3)
    kernel, random = body._stepper.kernel, np.random.default_rng(0)
    u = np.zeros(body.inputs)
    for step in range(3):
        if kind == "carried":
            half = 0.01 * step
            turned = np.array([np.cos(half), 0.6 * np.sin(half), 0.8 * np.sin(half), 0])
            kernel.base = fr.BaseState(
                np.array([0, 0, 1e-3 * step]), turned, np.array([0, 1.0, step]), 3.0 * turned[1:]
            )
        free, some = kernel.open(u), np.array([1, 4, 0])
        forces = np.zeros((len(free), 3))
        forces[some] = 0.1 * random.standard_normal((3, 3))
        answered = free[some] + (kernel.answer(some) @ forces[some].ravel()).reshape(3, 3)
        contact = ContactSolution(forces, 0, some, 0 * forces[some], forces[some], np.zeros((1, 3)), None)
        kernel.close(contact)
        np.testing.assert_allclose(kernel.touched[some], answered, rtol=0, atol=1e-13 * np.abs(kernel.touched).max())


def test_points_of_a_free_body_answer_forces_as_they_then_move(roms):
    """As a body that whirls is pushed at places of its own and of others: W is what differences say, momenta and
    the account grow by what forces do there, and points of its own go as they answered."""
    h, random = 5e-3, np.random.default_rng(0)
    body = fr.Simulator(roms["free"], h)
    spin, speed = np.array([20.0, -10, 15]), np.array([0.1, 0.2, -0.3])
    body.place(LIES._replace(velocity=speed, angular_velocity=spin))
    kernel, follows = body._stepper.kernel, np.array([False, True, False, True])
    nodes, weights = np.array([[0, 1, 2], [3, 3, 3], [1, 1, 1], [4, 5, 2]]), np.tile([0.2, 0.3, 0.5], (4, 1))
    points = PushedPoints.of(kernel, nodes, weights, follows)
    for _ in range(3):
        step = PushedStep(kernel, np.zeros(body.inputs))
        step.begin_at(points)
        forces, places = 2 * random.standard_normal((4, 3)), 0.1 * random.standard_normal((4, 3))
        step.velocities(forces, places)
        W = step.operator()
        small = 1e-3 * np.eye(12).reshape(12, 4, 3)
        answers = [step.velocities(forces + s, places) - step.velocities(forces - s, places) for s in small]
        np.testing.assert_allclose(W, np.reshape(answers, (12, 12)).T / 2e-3, rtol=0, atol=1e-8 * np.abs(W).max())
        before, energy, (P, L), p = kernel.point_places(), kernel.energy, kernel.momenta, kernel.frame.position
        supplied, heat = body.ledger.supplied, body.ledger.dissipated
        moved, spread = step.velocities(forces, places), np.zeros(before.shape)
        np.add.at(spread, nodes, weights[:, :, None] * forces[:, None])
        step.close(handed(spread, np.unique(nodes)))
        kernel.flush()
        went = points.mean(kernel.point_places() - before) / h
        np.testing.assert_allclose(went[~follows], moved[~follows], rtol=0, atol=1e-15 / h)
        (P_end, L_end), p_end = kernel.momenta, kernel.frame.position
        np.testing.assert_allclose(P_end, P + h * forces.sum(axis=0), rtol=0, atol=1e-14)
        about = L_end + np.cross(p_end, P_end) - L - np.cross(p, P)
        np.testing.assert_allclose(about, h * np.cross(places, forces).sum(axis=0), rtol=0, atol=1e-15)
        by_forces = h * float((forces * moved).sum())
        assert body.ledger.supplied - supplied == pytest.approx(by_forces, rel=1e-12)
        gone = body.ledger.dissipated - heat
        assert kernel.energy - energy == pytest.approx(by_forces - gone, abs=1e-14)
        assert abs(by_forces) > 1e-3


def test_what_a_world_refuses_of_soft_bodies(roms):
    with pytest.raises(fr.SceneError, match=r"body 'beam': ROM .* is carried: use on = BODY"):
        fr.World({"beam": fr.SoftBody(roms["carried"]), "box": fr.RigidBody(**BOX)}, 1e-3)
    with pytest.raises(fr.SceneError, match=r"body 'beam': ROM .* is not carried"):
        fr.World({"beam": fr.SoftBody(roms["held"], on="palm"), "palm": fr.RigidBody(Sphere(0.1), motion=LIES)}, 1e-3)
    with pytest.raises(fr.SceneError, match="on = 'box': use a rigid body with a motion"):
        fr.World({"beam": fr.SoftBody(roms["carried"], on="box"), "box": fr.RigidBody(**BOX)}, 1e-3)
    with pytest.raises(
        fr.SceneError, match=r"weld at \[9.0, 0.0, 0.0\], which holds three points about it, 0.1 m from .*"
    ):
        fr.World({"beam": fr.SoftBody(roms["free"])}, 1e-3, joints=[weld("beam", "world", (9, 0, 0))])
    for kind, on in (("held", None), ("carried", "palm")):
        thrown = {
            "beam": fr.SoftBody(roms[kind], on=on, velocity=(0, 0, 1)),
            "palm": fr.RigidBody(Sphere(1), motion=LIES),
        }
        with pytest.raises(fr.SceneError, match=r"velocity = \(0, 0, 1\).*: use 0 of a body that is held or"):
            fr.World(thrown, 1e-3)
    world = fr.World({"beam": fr.SoftBody(roms["held"]), "box": fr.RigidBody(**BOX, position=(0, 0, 1))}, 1e-3)
    with pytest.raises(fr.StepError, match="body 'box': no input 'push'; there is force, torque"):
        world.step({"box": {"push": 1.0}})
    with pytest.raises(fr.StepError, match="no input 'flexor'; there is right"):
        world.step({"beam": {"flexor": 1.0}})


def test_a_world_of_one_body_steps_as_its_simulator(roms):
    """To the bit, with the obstacles of its scene."""
    world, body = fr.World({"beam": fr.SoftBody(roms["held"])}, 1e-3), fr.Simulator(roms["held"], 1e-3)
    for _ in range(5):
        world.step({"beam": {"right": [0, 0, 0.1]}})
        body.step(right=[0, 0, 0.1])
    np.testing.assert_array_equal(world.simulator("beam").displacement(), body.displacement())
    assert world.energy == body.energy > 0
    assert world.ledger.supplied == body.ledger.supplied
    with pytest.raises(fr.StepError, match="no body 'beams'"):
        world.step({"beams": {}})
    world.step()
    body.step(right=[0, 0, 0])
    assert (world.energy, world.steps, world.time) == (body.energy, 6, body.time)


def test_a_world_of_one_body_needs_no_contact(tmp_path):
    world = fr.World({"beam": fr.SoftBody(reduced(tmp_path, frame="fixed", order=4, **CLAMPED))}, 1e-3)
    world.step({"beam": [0, 0, 0.1]})
    assert world.energy == pytest.approx(world.ledger.supplied - world.ledger.dissipated, rel=1e-12)
    assert world.energy > 0
