"""Soft bodies of any effects among others: without contact, with springs for it, without inertia."""

import numpy as np
import pytest
from soft_rom import in_frame, soft_rom
from test_soft_motion import BOX, CLAMPED, LIES, TOUCHED, assembled_beam, momenta, reduced

import fenics_rom as fr
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.world.joints import SurfaceJoint
from fenics_rom.world.shapes import Box, HalfSpace, Sphere
from fenics_rom.world.surfaces import area_shares

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
GRAVITY = (0.0, 0.0, -9.81)
ROPE = "points = [[0.0, 0.015, 0.004], [0.15, 0.015, 0.004], [0.3, 0.015, 0.004]]"
PATCHES = '[contacts.right]\nsurface = "right"\n[contacts.top]\nsurface = "top"\n[contacts.bottom]\nsurface = "bottom"'
FRAMES = {
    "held": {"frame": "fixed", **CLAMPED},
    "still": {"frame": "fixed", "effects": "", **CLAMPED},
    "carried": {"frame": "moving", "effects.base_path": "origin = [0.0, 0.015, 0.01]", **CLAMPED},
    "free": {"frame": "moving"},
}


def run(world, steps, inputs=None):
    """Takes steps; by how much the account misses at most, as a share of what went through it."""
    gap, start, turnover = 0.0, None, 0.0
    for step in range(steps + 1):
        if step:
            world.step(None if inputs is None else inputs(step * world.dt))
        account = world.ledger
        gone = account.dissipated + account.lost_in_switching + account.numerical
        missed = world.energy - account.supplied + gone
        start = missed if start is None else start
        gap, turnover = max(gap, abs(missed - start)), max(turnover, abs(account.supplied), world.energy)
    return gap / turnover


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", ["weld", "ball", "hinge"])
def test_a_body_that_nothing_can_touch_is_joined_to_a_box(tmp_path, frame, kind):
    """Its scene names no contact: joints hold it, and others pass through it."""
    rom = fr.reduce(assembled_beam(tmp_path, **FRAMES[frame]), order=10, method="modal")
    origin = {"held": 0.0, "still": 0.0, "carried": [0, 0.015, 0.01], "free": [0.15, 0.015, 0.01]}[frame]
    end = np.array([0.3, 0.015, 0.01]) - origin
    box = fr.RigidBody(Box((0.06, 0.06, 0.06)), density=50, position=end + np.array([0.03, 0, 0]), velocity=(0, 0, 0.1))
    rises = np.array([0, 0, 0.1])
    palm = fr.RigidBody(Sphere(0.005), motion=lambda t: LIES._replace(position=t * rises, velocity=rises))
    bodies = {"beam": fr.SoftBody(rom, on="palm" if frame == "carried" else None), "box": box}
    bodies |= {"palm": palm} if frame == "carried" else {}
    joint = SurfaceJoint("beam", "box", "right", kind, axis=(0, 1, 0) if kind == "hinge" else None)
    world = fr.World(bodies, 1e-3, joints=[joint], gravity=(0, 0, 0) if frame == "free" else GRAVITY)
    start = momenta(world) if frame == "free" else ()
    assert run(world, 60) < 1e-11
    for now, then in zip(momenta(world) if frame == "free" else (), start, strict=True):
        assert np.abs(now - then).max() < 1e-14
    pose, beam = world.pose("box"), world.simulator("beam")
    face = np.searchsorted(beam.contact_points, beam.rom.contact_models["right"].contact_points)
    triangles = [tuple(face.tolist().index(k) for k in t) for t in beam.contact_triangles.tolist() if set(t) <= {*face}]
    there = area_shares(beam.contact_coordinates[face], np.array(triangles)) @ beam.places()[face]
    gap = there - pose.position - rotation_matrix(pose.rotation) @ (-0.03, 0, 0)
    assert np.abs(gap).max() < (1e-11 if kind != "hinge" else 1e-6)  # which holds two points: their middle is near
    assert np.linalg.norm(world.force_between("beam", "box")) > 1e-3


def test_looking_ahead_moves_nothing(tmp_path):
    """Of a body without inertia that its weight bends: it is as it was until a step is taken, joints made or let go."""
    gravity = {"effects.gravity": "acceleration = [0.0, 0.0, -9.81]"}
    rom = reduced(tmp_path, order=8, frame="fixed", effects="", **CLAMPED, **TOUCHED, **gravity)
    box = fr.RigidBody(Box((0.06, 0.06, 0.06)), density=50, position=(0.33, 0.015, 0.01))
    joints = [SurfaceJoint("beam", "box", "right", "ball", name="pin")]
    world = fr.World({"beam": fr.SoftBody(rom), "box": box}, 1e-3, joints=joints)
    assert world.energy == 0
    assert not world.simulator("beam").displacement().any()
    world.step()
    before = world.simulator("beam").displacement()
    assert np.abs(before).max() > 1e-5
    world.release("pin")
    np.testing.assert_array_equal(world.simulator("beam").displacement(), before)


@pytest.mark.parametrize(("order", "told"), [(3, True), (8, False)])
def test_a_weld_of_too_few_shapes_is_told(tmp_path, order, told):
    rom = fr.reduce(assembled_beam(tmp_path, **FRAMES["still"]), order=order, method="modal")
    box = fr.RigidBody(Box((0.06, 0.06, 0.06)), density=50, position=(0.33, 0.015, 0.01))
    joints = [SurfaceJoint("beam", "box", "right", name="clamp")]
    world = fr.World({"beam": fr.SoftBody(rom), "box": box}, 1e-3, joints=joints)
    assert [text.startswith("clamp: contact mode 'right' of 'beam' has 3 shapes") for text in world.warnings] == [
        True
    ] * told


def test_what_nothing_can_touch_has_no_law_of_contact(tmp_path):
    rom = reduced(tmp_path, order=6, **FRAMES["held"])
    bodies = {"beam": fr.SoftBody(rom), "box": fr.RigidBody(**BOX, position=(0.25, 0.015, 0.01))}
    assert run(fr.World(bodies, 1e-3, gravity=GRAVITY), 5) < 1e-13
    with pytest.raises(fr.SceneError, match=r"beam and box: have no contact, as the scene of one of them names no"):
        fr.World(bodies, 1e-3, pairs={("beam", "box"): ContactLaw(friction=0.5)})
    M, K = np.eye(6), np.diag(np.arange(1.0, 7))
    matrices = fr.reduce(fr.System(mass=M, damping=M, stiffness=K, contacts={"tip": M[:, :1]}), order=2)
    with pytest.raises(fr.SceneError, match=r"body 'beam': ROM .* was made from matrices, which do not say where"):
        fr.World({**bodies, "beam": fr.SoftBody(matrices)}, 1e-3)


def test_springs_of_a_scene_give_way_to_the_rigid_law(tmp_path):
    """A box lies on a beam as on one that was made with the rigid law, and the world says what it leaves out."""
    places, parts = [], {**TOUCHED, "effects.contact": 'method = "penalty"\nstiffness = 1e3'}
    for effects in (parts, TOUCHED):
        box = fr.RigidBody(Box((0.12, 0.06, 0.03)), density=25, position=(0.15, 0.015, 0.0351))
        beam = fr.SoftBody(reduced(tmp_path, frame="fixed", **CLAMPED, **effects))
        world = fr.World({"beam": beam, "box": box}, 1e-3, gravity=GRAVITY, friction=0.5)
        assert run(world, 100) < 1e-12
        places.append(world.pose("box").position)
        assert [("springs of 1000 N/m" in text) for text in world.warnings] == [True] * (effects is parts)
    np.testing.assert_array_equal(*places)


@pytest.mark.parametrize("speed", [0.0, -0.1])
def test_a_box_comes_to_rest_on_a_body_without_inertia(tmp_path, speed):
    """Its weight is what the beam bears, and what presses is neither off the box nor in it."""
    rom = reduced(tmp_path, frame="fixed", effects="", order=8, **CLAMPED, **TOUCHED)
    box = fr.RigidBody(Box((0.12, 0.06, 0.03)), density=25, position=(0.15, 0.015, 0.0352), velocity=(0, 0, speed))
    world = fr.World({"beam": fr.SoftBody(rom), "box": box}, 5e-3, gravity=GRAVITY, friction=0.5)
    assert run(world, 400) < 1e-12
    weight = 25 * 0.12 * 0.06 * 0.03 * 9.81
    np.testing.assert_allclose(world.force_between("box", "beam"), [0, 0, weight], rtol=0, atol=1e-9 * weight)
    assert np.abs(world.velocity("box")[0]).max() < 1e-9
    pose, beam = world.pose("box"), world.simulator("beam")
    pressed = np.linalg.norm(beam.contact_forces(), axis=1) > 1e-6 * weight
    above = -0.015 - ((beam.places() - pose.position) @ rotation_matrix(pose.rotation))[:, 2]
    assert pressed.sum() >= 3
    assert np.abs(above[pressed]).max() < 1e-7


ACTUATED = {
    "tendon": ({"effects.tendon.rope": ROPE}, 3.0),
    "stroke": ({"effects.tendon.rope": f'{ROPE}\ncontrol = "length"'}, 1.5e-3),
    "large": (soft_rom, 0.5),
}


@pytest.mark.parametrize("kind", ACTUATED)
def test_a_finger_without_inertia_presses_a_box_on_the_ground(tmp_path, kind):
    """The ground bears its weight and what the finger presses, in balance."""
    parts, amplitude = ACTUATED[kind]
    if kind == "large":
        rom, name, middle = soft_rom(order=8, contact=True, inertia=False), "cable", 0.01
    else:
        parts = {**CLAMPED, **TOUCHED, **parts, "contacts": PATCHES, "effects": ""}
        rom, name, middle = reduced(tmp_path, frame="fixed", order=8, **parts), "rope", 0.015
    box = fr.RigidBody(Box((0.12, 0.06, 0.03)), density=500, position=(0.26, middle, -0.0165))
    ground = fr.RigidBody(HalfSpace(), motion=LIES._replace(position=np.array([0, 0, -0.0315])))
    bodies = {"finger": fr.SoftBody(rom), "box": box, "ground": ground}
    world = fr.World(bodies, 1e-2, gravity=GRAVITY, friction=0.5)
    assert run(world, 40, lambda t: {"finger": {name: amplitude * min(1, 5 * t)}}) < 1e-12
    weight, pressed = 500 * 0.12 * 0.06 * 0.03 * 9.81, world.force_between("box", "finger")
    assert pressed[2] < -5e-3
    np.testing.assert_allclose(world.force_between("box", "ground") + pressed, [0, 0, weight], rtol=0, atol=1e-8)


def lowered(t):
    """A palm that is lowered and turned."""
    θ, ω = 0.15 * (1 - np.cos(6 * t)), 0.9 * np.sin(6 * t)
    rotation = np.array([np.cos(θ / 2), 0, np.sin(θ / 2), 0])
    position, velocity = np.array([0, 0, -0.02 * np.sin(5 * t)]), np.array([0, 0, -0.1 * np.cos(5 * t)])
    return fr.BaseState(position, rotation, velocity, np.array([0, ω, 0]))


@pytest.mark.parametrize("strains", ["small", "large"])
def test_a_palm_presses_a_finger_without_inertia_on_a_box(tmp_path, strains):
    """What the palm bears is the weight of the finger and what the box does; the account closes, its work included."""
    if strains == "large":
        rom, origin, weight = in_frame(soft_rom(order=8, contact=True, inertia=False)), np.zeros(3), 0.0
    else:
        gravity = {"effects.gravity": "acceleration = [0.0, 0.0, -9.81]"}
        parts = {**FRAMES["carried"], **TOUCHED, **gravity, "contacts": PATCHES, "effects": ""}
        rom, origin, weight = reduced(tmp_path, order=8, **parts), np.array([0, 0.015, 0.01]), 1.8e-4 * 1100 * 9.81
    place = np.array([0.25, 0.015, -0.0185]) - origin
    box = fr.RigidBody(Box((0.12, 0.06, 0.03)), density=300, position=place)
    ground = fr.RigidBody(HalfSpace(), motion=LIES._replace(position=np.array([0, 0, -0.0335]) - origin))
    bodies = {"finger": fr.SoftBody(rom, on="palm"), "palm": fr.RigidBody(Sphere(1e-3), motion=lowered)}
    world = fr.World(
        bodies | {"box": box, "ground": ground},
        4e-3,
        gravity=GRAVITY,
        friction=0.5,
        apart=[("palm", "finger"), ("palm", "box")],
    )
    assert run(world, 30) < 1e-12
    pressed = world.force_between("finger", "box")
    assert pressed[2] > 0.1
    force, _ = world.simulator("finger").base_wrench
    np.testing.assert_allclose(force + pressed, [0, 0, weight], rtol=0, atol=1e-11)
    assert abs(world.account("finger").supplied - world.account("finger").obstacles) > 1e-4  # by the palm


@pytest.mark.parametrize("dt", [1e-3, 5e-3])
@pytest.mark.parametrize("touches", [True, False])
def test_a_rigid_face_of_a_free_body_is_welded_to_a_box_that_flies(tmp_path, dt, touches):
    """As a whole, by forces and couples: momenta and account to round-off."""
    parts = {"contacts": PATCHES.replace("[contacts.top]", 'force = "wrench"\n[contacts.top]', 1)}
    rom = reduced(tmp_path, frame="moving", **parts, **(TOUCHED if touches else {}), supports='rigid = ["right"]')
    thrown = {"velocity": (0, 0.1, 0.2), "angular_velocity": (0, 2, 1)}
    bodies = {
        "beam": fr.SoftBody(rom),
        "box": fr.RigidBody(Box((0.06,) * 3), density=500, position=(0.18, 0, 0), **thrown),
    }
    world = fr.World(bodies, dt, joints=[SurfaceJoint("beam", "box", "right")])
    start = momenta(world)
    assert run(world, 40) < 1e-12
    for now, then in zip(momenta(world), start, strict=True):
        assert np.abs(now - then).max() < 1e-15
    assert world.joint_forces(0).shape == (2, 3)
    assert np.abs(world.joint_forces(0)).max() > 1e-2
