"""Soft bodies made of any parts among others: momenta, accounts, and what bodies answer forces with."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays
from soft_rom import in_frame, soft_rom
from test_soft_motion import LIES, TOUCHED, momenta
from test_soft_products import run

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.viscoelasticity import PronySeries
from fenics_rom.runtime.steppers.pushed_step import PushedPoints, PushedStep
from fenics_rom.scene.file import parse_scene
from fenics_rom.world import fast_motion
from fenics_rom.world.joints import Joint, SurfaceJoint, hinge
from fenics_rom.world.shapes import Box, HalfSpace, Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
ROPE = "points = [[0.05, 0.015, 0.004], [0.15, 0.015, 0.002], [0.2, 0.015, 0.005], [0.3, 0.015, 0.004]]"
PULLED = {  # a scene that trains a free beam with its rope and with forces at one end
    "effects.tendon.rope": ROPE,
    "actuators.pull": 'surface = "right"',
    "run": "dt = 5e-3\nduration = 0.05",
    "[run.load]": 'actuator = "pull"\nforce = [0.0, 0.0, -0.15]\n[[run.load]]\nactuator = "rope"\nforce = [0.5]',
}
STRAINS = {
    "small": {},
    "rubs": {"effects.tendon_friction": "coefficient = 0.3"},
    "large": {"effects.large_deformation": 'material = "st_venant_kirchhoff"'},
}


def acting(rom, **parts):
    return replace(rom, environment=replace(rom.environment, **parts))


KINDS = {
    "plain": lambda rom: rom,
    "stroke": lambda rom: acting(rom, controls={"rope": "length"}),
    "relaxes": lambda rom: acting(rom, viscoelasticity=PronySeries((0.5,), (0.03,))),
}
AMPLITUDE = {"stroke": 2e-3, "plain": 1.5, "relaxes": 1.5}


@pytest.fixture(scope="module")
def free(tmp_path_factory):
    """A beam that nothing holds, of small strains, with a rope that rubs, and of large strains."""
    mesh = write_arrays(tmp_path_factory.mktemp("free") / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))
    material = "young = 5e5\npoisson = 0.4\ndensity = 1100.0"
    roms = {}
    for strains, effects in STRAINS.items():
        parts = {"supports": None, "damping": "alpha = 0.5, beta = 2e-4", **TOUCHED, **PULLED, **effects}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = parse_scene('frame = "moving"\n' + scene_text(mesh, material=material, **parts))
            roms[strains] = fr.reduce(fr.assemble(scene), order=6)
    return roms


def pulls(kind, *names):
    """Inputs of bodies at a time: of their ropes, as far as they are pulled."""
    return lambda t: {name: {"rope": AMPLITUDE[kind] * np.sin(t / 0.03) ** 2} for name in names}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("strains", "dt"), [("small", 1e-3), ("rubs", 1e-3), ("large", 1e-3), ("large", 2e-2)])
def test_two_free_bodies_that_meet_keep_both_momenta(monkeypatch, free, kind, strains, dt):
    """By both steps of large deformation: momenta and account to round-off, however they bend and are pulled."""
    monkeypatch.setattr(fast_motion, "SHARE", np.inf)  # long steps are not cut
    rom, tilted = KINDS[kind](free[strains]), (0, np.cos(0.1), np.sin(0.1), 0)
    above = fr.SoftBody(rom, position=(0.02, 0.004, 0.026), rotation=tilted, velocity=(0, 0, -0.6))
    bodies = {"below": fr.SoftBody(rom, angular_velocity=(1, 0.5, 2)), "above": above}
    world = fr.World(bodies, dt, friction=0.5)
    start, pulled, force = momenta(world), pulls(kind, "below", "above"), 0.0
    for step in range(25):
        assert run(world, 1, lambda _, t=(step + 1) * dt: pulled(t)) < 1e-12
        force = max(force, np.abs(world.force_between("below", "above")).max())
    assert force > 0.1
    for now, then, bound in zip(momenta(world), start, (1e-15, 1e-16), strict=True):
        assert np.abs(now - then).max() < 10 * bound


@pytest.mark.parametrize("strains", ["small", "large"])
@pytest.mark.parametrize("dt", [1e-3, 3e-3])
def test_points_of_a_body_that_a_stroke_holds_answer_forces_as_they_then_move(free, strains, dt):
    """W is what differences say, also at points of others and of couples; the stroke goes as it is to."""
    body, random = fr.Simulator(KINDS["stroke"](free[strains]), dt), np.random.default_rng(0)
    body.place(LIES._replace(angular_velocity=np.array([2.0, -1.0, 1.5])))
    kernel, follows = body._stepper.kernel, np.array([False, True, False, False])
    nodes, weights = np.array([[0, 1, 2], [3, 3, 3], [4, 5, 2], [0, 1, 3]]), np.tile([0.2, 0.3, 0.5], (4, 1))
    points, u = PushedPoints.of(kernel, nodes, weights, follows, np.array([3])), np.zeros(body.inputs)
    for stroke in (1e-3, 2e-3):
        u[-1] = stroke
        step = PushedStep(kernel, u)
        step.begin_at(points)
        forces, places = 0.05 * random.standard_normal((4, 3)), 0.1 * random.standard_normal((4, 3))
        forces[3] *= 1e-2  # a couple, N m
        step.velocities(forces, places)
        W, small = step.operator(), np.repeat([1e-4, 1e-6], [9, 3])[:, None, None] * np.eye(12).reshape(12, 4, 3)
        answers = [step.velocities(forces + s, places) - step.velocities(forces - s, places) for s in small]
        slopes, size = np.reshape(answers, (12, 12)).T / (2 * small.sum(axis=(1, 2))), np.sqrt(W.diagonal())
        np.testing.assert_allclose((W - slopes) / np.outer(size, size), 0, atol=1e-7)
        rates, *_ = kernel.found_at(step._x)
        np.testing.assert_allclose(rates, kernel.found.targets.rates, rtol=1e-10)
        assert kernel.reactions_found[0] > 0.1
        step.close(None)
    assert kernel.reactions[0] > 0.1


CARRIED = {
    "plain": lambda rom: rom,
    "stroke": lambda rom: acting(rom, controls={"cable": "length"}),
    "relaxes": KINDS["relaxes"],
    "yields": lambda rom: replace(rom, residual_compliance=None),
}


def swings(t):
    """A palm that turns to and fro and goes up and down."""
    θ, ω = 0.25 * (1 - np.cos(6 * t)), 1.5 * np.sin(6 * t)
    rotation = np.array([np.cos(θ / 2), 0, -np.sin(θ / 2), 0])
    position, velocity = np.array([0, 0, 0.02 * np.sin(5 * t)]), np.array([0, 0, 0.1 * np.cos(5 * t)])
    return fr.BaseState(position, rotation, velocity, np.array([0, -ω, 0]))


def fingers(kind, frame, **choices):
    """A body that bends far, held or on a palm."""
    rom = CARRIED[kind](soft_rom(order=8, contact=True, **choices))
    if frame == "held":
        return {"finger": fr.SoftBody(rom)}
    return {"finger": fr.SoftBody(in_frame(rom), on="palm"), "palm": fr.RigidBody(Sphere(1e-3), motion=swings)}


@pytest.mark.parametrize("frame", ["held", "carried"])
@pytest.mark.parametrize("kind", CARRIED)
@pytest.mark.parametrize("dt", [1e-3, 2e-2])
def test_a_box_meets_a_finger_that_bends_far(frame, kind, dt):
    """From below, where its tip has points; the account closes to round-off by both steps."""
    box = fr.RigidBody(Box((0.12, 0.06, 0.03)), density=200, position=(0.28, 0.01, -0.017), velocity=(0.1, 0, 0.8))
    bodies = fingers(kind, frame) | {"box": box}
    apart = [("palm", "finger"), ("palm", "box")] if frame == "carried" else []
    world = fr.World(bodies, dt, friction=0.5, apart=apart)
    amplitude, force = (1e-3 if kind == "stroke" else 0.5), 0.0
    for step in range(15):
        pull = amplitude * np.sin((step + 1) * dt / 0.03) ** 2
        assert run(world, 1, lambda _, pull=pull: {"finger": {"cable": pull}}) < 1e-12
        force = max(force, np.linalg.norm(world.force_between("box", "finger")))
    assert force > 0.1


@pytest.mark.parametrize("frame", ["held", "carried", "free"])
@pytest.mark.parametrize("kind", ["plain", "stroke", "relaxes"])
def test_far_from_others_a_body_moves_as_its_simulator(free, frame, kind):
    """Of large strains: to round-off."""
    bodies = {"finger": fr.SoftBody(KINDS[kind](free["large"]), angular_velocity=(1, 2, 3))}
    bodies = bodies if frame == "free" else fingers(kind, frame)
    rom, pulled = bodies["finger"].rom, "rope" if frame == "free" else "cable"
    bodies["box"] = fr.RigidBody(Box((0.1, 0.1, 0.1)), density=200, position=(0, 0, 3.0))
    world = fr.World(bodies, 2e-3, apart=[("palm", "finger")] if frame == "carried" else ())
    alone = fr.Simulator(rom, 2e-3, signals={"floor": [0, 0, -3.0]})
    if frame != "held":
        alone.place(world.pose("finger"))
    for step in range(20):
        u = {pulled: (2e-3 if kind == "stroke" else 0.3) * np.sin(step / 15) ** 2}
        world.step({"finger": u})
        alone.step(u, base=swings(2e-3 * (step + 1)) if frame == "carried" else None)
    there = rom.nodes + alone.displacement()
    np.testing.assert_allclose(world.simulator("finger").node_places(), there, rtol=0, atol=1e-13)
    assert world.energy_of("finger") == pytest.approx(alone.energy, rel=1e-11)
    assert np.abs(alone.state[0]).max() > 1e-5


def test_what_rests_on_a_half_space_of_a_world_rests_on_that_of_its_scene():
    """Of large strains with a stroke: to the tolerance of contact forces."""
    rom = CARRIED["stroke"](soft_rom(order=8, contact=True))
    rom = replace(rom, residual_compliance=None)
    ground = fr.RigidBody(HalfSpace(), motion=LIES._replace(position=np.array([0, 0, -8e-3])))
    world = fr.World({"beam": fr.SoftBody(rom), "ground": ground}, 2e-3, friction=0.4, restitution=0.5)
    body = fr.Simulator(rom, 2e-3)
    for step in range(80):
        u = {"cable": 5e-3 * np.sin(step / 50) ** 2}
        world.step({"beam": u})
        body.step(u)
    assert np.abs(body.obstacle_forces()).max() > 1e-2
    np.testing.assert_allclose(world.simulator("beam").displacement(), body.displacement(), rtol=0, atol=1e-9)


@pytest.mark.parametrize("frame", ["held", "carried", "free"])
@pytest.mark.parametrize("kind", ["plain", "stroke", "relaxes"])
def test_a_box_is_joined_to_a_body_that_bends_far(free, frame, kind):
    """At points of its tip, which stay where they are on the box, but for what a palm's twists miss of its poses."""
    bodies = {"finger": fr.SoftBody(KINDS[kind](free["large"]))} if frame == "free" else fingers(kind, frame)
    alone = fr.World({**bodies, "far": fr.RigidBody(Sphere(1.0), motion=LIES._replace(position=[0, 0, 9.0]))}, 1e-3)
    places = alone.simulator("finger").places()
    tip = places[places[:, 0] > places[:, 0].max() - 1e-6][:2]
    middle = tip.mean(axis=0) + np.array([0.03, 0, 0])
    bodies["box"] = fr.RigidBody(Box((0.05, 0.05, 0.05)), density=200, position=middle, velocity=(0, 0, 0.3))
    joint, apart = Joint("finger", "box", tuple(map(tuple, tip))), [("palm", "finger"), ("palm", "box")]
    world = fr.World(bodies, 2e-3, joints=[joint], apart=apart if frame == "carried" else ())
    name, amplitude = ("rope" if frame == "free" else "cable"), (1e-3 if kind == "stroke" else 0.3)
    assert run(world, 25, lambda t: {"finger": {name: amplitude * np.sin(t / 0.03) ** 2}}) < 1e-12
    pose, finger = world.pose("box"), world.simulator("finger")
    ends = [int(np.abs(places - point).sum(axis=1).argmin()) for point in tip]
    on_box = pose.position + (tip - middle) @ rotation_matrix(pose.rotation).T
    np.testing.assert_allclose(finger.places()[ends], on_box, rtol=0, atol=1e-6 if frame == "carried" else 1e-12)
    takes_none = frame != "carried" or kind == "stroke"  # impulses, so that it is told how fast they part
    assert any("takes no impulse" in text for text in world.warnings) == takes_none


@pytest.mark.parametrize("kind", ["plain", "stroke"])
def test_what_takes_no_impulses_leaves_joints_of_others_theirs(free, kind):
    """Of a beam that is welded to a box, to which another one is hinged: the hinge is stopped after steps."""
    rom, at = KINDS[kind](free["small"]), np.array([0.18, 0.0, 0.0])
    boxes = {
        name: fr.RigidBody(Box((0.06,) * 3), density=200, position=at + np.array([x, 0, 0]))
        for name, x in (("a", 0), ("b", 0.07))
    }
    joints = [SurfaceJoint("beam", "a", "right"), hinge("a", "b", at + np.array([0.035, 0, 0]), (0, 0.05, 0))]
    world = fr.World({"beam": fr.SoftBody(rom), **boxes}, 1e-3, joints=joints)
    for step in range(20):
        world.step({"beam": {"rope": AMPLITUDE[kind] * np.sin(step / 15) ** 2}, "b": {"force": [0, 0, 0.05]}})
    poses, ends = [world.pose(name) for name in "ab"], []
    for pose, arm in zip(poses, ((0.035, 0, 0), (-0.035, 0, 0)), strict=True):
        turned = rotation_matrix(pose.rotation) @ arm
        ends.append(pose.velocity + np.cross(pose.angular_velocity, turned))
    assert np.abs(ends[0]).max() > 1e-3
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-12)
