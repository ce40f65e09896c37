"""Rigid bodies by themselves, and on the ground: closed forms, and momenta and energy to round-off."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fenics_rom as fr
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.world.bodies import Points
from fenics_rom.world.recorder import WorldRecorder
from fenics_rom.world.rigid import Rigid
from fenics_rom.world.shapes import Box, HalfSpace, Sphere

G = 9.81
LIES = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
GROUND = fr.RigidBody(HalfSpace(), motion=LIES)


def on_incline(body, angle, friction, steps, dt=2e-3):
    gravity = (G * np.sin(angle), 0, -G * np.cos(angle))
    world = fr.World({"ground": GROUND, "body": body}, dt, gravity=gravity, friction=friction)
    for _ in range(steps):
        world.step()
    return world


def momenta(world):
    """Of all bodies that move freely, linear and angular about the origin."""
    linear, angular = np.zeros(3), np.zeros(3)
    for name, record in world.bodies.items():
        pose = world.pose(name)
        mass, inertia = record.mass_and_inertia()
        w, *v = pose.rotation
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        R = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        linear += mass * pose.velocity
        angular += mass * np.cross(pose.position, pose.velocity) + R @ inertia @ R.T @ pose.angular_velocity
    return linear, angular


def test_points_of_a_body_that_turns_answer_forces_by_its_operator():
    """Against central differences of tries, which are exact but for their squares; the operator is not symmetric."""
    random = np.random.default_rng(0)
    body, h = fr.RigidBody(Box((0.1, 0.2, 0.3)), density=500, rotation=(0.6, 0, 0.8, 0)), 0.01
    mass, inertia = body.mass_and_inertia()
    pose = body.pose("")._replace(velocity=random.standard_normal(3), angular_velocity=5 * random.standard_normal(3))
    rigid, points = Rigid(body.shape, mass, inertia, pose, np.zeros(3)), Points(*np.empty((4, 2, 0)))
    points = points._replace(arms=np.empty((0, 3)))
    rigid.begin(h)
    places, forces = pose.position + 0.1 * random.standard_normal((2, 3)), 10 * random.standard_normal((2, 3))
    rigid.attempt(points, places, forces)
    operator, step = rigid.delassus(points, places), 1e-3
    columns = [
        (rigid.attempt(points, places, forces + change) - rigid.attempt(points, places, forces - change)).ravel()
        for change in step * np.eye(6).reshape(6, 2, 3)
    ]
    tried = np.array(columns).T / (2 * step)
    np.testing.assert_allclose(operator, tried, rtol=0, atol=1e-8 * np.abs(tried).max())
    assert np.abs(operator - operator.T).max() > 1e-3 * np.abs(operator).max()


@pytest.mark.parametrize("steps", [2000, pytest.param(30_000, marks=pytest.mark.slow)])
def test_a_top_keeps_energy_and_angular_momentum_to_round_off(steps):
    world = fr.World({"top": fr.RigidBody(Box((0.1, 0.2, 0.3)), density=500, angular_velocity=(0.3, 8, 0.2))}, 1e-2)
    energy, (_, start) = world.energy, momenta(world)
    for _ in range(steps):
        world.step()
    assert world.energy == pytest.approx(energy, rel=1e-12, abs=0)
    assert np.abs(momenta(world)[1] - start).max() < 1e-12 * np.linalg.norm(start)


def test_a_push_and_a_torque_do_what_newton_and_euler_say():
    """Both constant, the torque about a principal axis; the account has the work."""
    body, h, steps = fr.RigidBody(Box((0.1, 0.2, 0.3)), density=500), 1e-2, 100
    mass, inertia = body.mass_and_inertia()
    force, torque, t = np.array([0.3, -0.2, 0.1]), 2e-3, steps * h
    world = fr.World({"body": body}, h, gravity=(0, 0, -G))
    for _ in range(steps):
        world.step({"body": {"force": force, "torque": (0, 0, torque)}})
    pose, acceleration = world.pose("body"), force / mass - [0, 0, G]
    np.testing.assert_allclose(pose.velocity, acceleration * t, rtol=1e-12)
    np.testing.assert_allclose(pose.position, acceleration * t**2 / 2, rtol=1e-12)
    assert pose.angular_velocity == pytest.approx([0, 0, torque / inertia[2, 2] * t], rel=1e-12)
    assert world.ledger.supplied == pytest.approx(world.energy, rel=1e-12)
    world.step()  # what is not given is 0
    np.testing.assert_allclose(world.pose("body").velocity, acceleration * t - [0, 0, G * h], rtol=1e-12)


def test_a_body_without_mass_stands_still_and_has_none():
    bodies = {
        "shelf": fr.RigidBody(Box((0.2, 0.2, 0.02)), position=(0, 0, 1)),
        "ball": fr.RigidBody(Sphere(0.1), mass=1),
    }
    bodies["ball"] = replace(bodies["ball"], position=(0, 0, 1.11))
    world = fr.World(bodies, 1e-2, gravity=(0, 0, -G))
    recorder = WorldRecorder(world, 10)
    for step in range(10):
        world.step()
        recorder.sample(step + 1)
    assert world.pose("shelf").position.tolist() == [0, 0, 1]
    assert world.force_between("ball", "shelf")[2] == pytest.approx(G, rel=1e-12)
    run = recorder.record("shelf")
    assert run.node_mass.sum() == pytest.approx(1.0, rel=1e-12)
    assert run.settings["order"] == 6


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"motion": LIES, "position": (0, 0, 1)}, "position has no effect beside its motion"),
        ({"motion": LIES, "mass": 1.0}, "mass has no effect beside its motion"),
        ({"velocity": (0, 0, 1)}, "velocity: it has neither density nor mass, so it stands still"),
        ({"inertia": np.eye(3)}, "density = None, mass = None: use one of both"),
    ],
)
def test_what_has_no_effect_on_a_body_is_refused(given, said):
    with pytest.raises(fr.SceneError, match=f"body 'ball': {said}"):
        fr.World({"ball": fr.RigidBody(Sphere(0.1), **given)}, 1e-2)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"pairs": {("a", "b"): ContactLaw(), ("b", "a"): ContactLaw()}}, "pairs: b and a: are named twice"),
        (
            {"pairs": {("a", "b"): ContactLaw()}, "apart": [("b", "ground", "a")]},
            "a and b: have no contact, as `apart`",
        ),
        ({"pairs": {("ground", "wall"): ContactLaw()}}, "ground and wall: both move as they are told"),
        ({"pairs": {("a", "b"): ContactLaw(stiffness=1.0)}}, "use a law without stiffness between bodies"),
    ],
)
def test_laws_that_say_two_things_or_nothing_are_refused(given, said):
    balls = {name: fr.RigidBody(Sphere(0.1), mass=1.0, position=(k, 0, 1)) for k, name in enumerate("ab")}
    with pytest.raises(fr.SceneError, match=said):
        fr.World({"ground": GROUND, "wall": GROUND, **balls}, 1e-2, **given)


def test_a_world_begins_anew():
    world = fr.World({"body": fr.RigidBody(Sphere(0.1), mass=1.0)}, 1e-2, gravity=(0, 0, -G))
    world.step({"body": {"force": (1.0, 0, 0)}})
    again = world.anew()
    assert (again.steps, again.energy, again.dt) == (0, 0.0, 1e-2)
    again.step({"body": {"force": (1.0, 0, 0)}})
    assert np.array_equal(again.pose("body").velocity, world.pose("body").velocity)


def test_a_torque_that_is_given_supplies_its_work_and_nobody_else_does():
    """About a principal axis it turns faster and faster: I ω = τ t, and ½ I ω² is supplied."""
    rod, torque = fr.RigidBody(Box((0.1, 0.2, 0.3)), mass=2.0), 0.01
    world = fr.World({"rod": rod}, 1e-2)
    for _ in range(50):
        world.step({"rod": {"torque": (0, 0, torque)}})
    inertia = rod.mass_and_inertia()[1][2, 2]
    assert world.pose("rod").angular_velocity[2] == pytest.approx(torque * 0.5 / inertia, rel=1e-12)
    account, energy = world.account("rod"), inertia * (torque * 0.5 / inertia) ** 2 / 2
    assert (account.supplied, account.obstacles) == (pytest.approx(energy, rel=1e-12), 0.0)


def test_the_end_of_a_rod_that_turns_stops_at_the_ground():
    """Its centre hardly falls; that its end comes nearer by 20 mm a step is foreseen, wherever it was before."""
    for height in np.linspace(0.1, 0.12, 8):
        rod = fr.RigidBody(Box((1.0, 0.02, 0.02)), mass=1.0, position=(0, 0, height), angular_velocity=(0, 10.0, 0))
        world = fr.World({"ground": GROUND, "rod": rod}, 4e-3)
        lowest = []
        for _ in range(12):
            world.step()
            w, x, y, z = world.pose("rod").rotation
            lowest.append(world.pose("rod").position[2] - (w * y - x * z) - 0.01 * (1 - 2 * (x * x + y * y)))
        assert world.pose("rod").velocity[2] > 0.1  # it was hit
        assert min(lowest) > -1e-3


@pytest.mark.parametrize("steps", [100, 400])
def test_a_ball_slides_off_a_plane_that_turns(steps):
    """As r e^(ωt), a bead on a wire; it sinks by what the plane turns in a step on its way, and by no more."""
    ω, r, ρ, h = 1.0, 0.3, 0.05, 1.0 / steps

    def turning(t):
        """Below its axis by the radius of the ball, so that the ball's centre is on a line through it."""
        along, out = np.array([np.cos(ω * t), 0, np.sin(ω * t)]), np.array([-np.sin(ω * t), 0, np.cos(ω * t)])
        turned = np.array([np.cos(ω * t / 2), 0, -np.sin(ω * t / 2), 0])
        return fr.BaseState(-ρ * out, turned, ω * ρ * along, np.array([0, -ω, 0]))

    ball = fr.RigidBody(Sphere(ρ), mass=1.0, position=(r, 0, 0), velocity=(ω * r, 0, ω * r))
    world = fr.World({"plane": fr.RigidBody(HalfSpace(), motion=turning), "ball": ball}, h)
    for _ in range(steps):
        world.step()
    along, out = np.array([np.cos(ω), 0, np.sin(ω)]), np.array([-np.sin(ω), 0, np.cos(ω)])
    place, sinks = world.pose("ball").position, h * ω * r * (np.e - 1)
    assert place @ along == pytest.approx(r * np.e, abs=sinks)
    assert -sinks < place @ out < 0


@pytest.mark.parametrize(
    ("inputs", "says"),
    [
        ({"body": {"forse": (1, 0, 0)}}, "body 'body': no input 'forse'; there is force, torque; did you mean 'force'"),
        ({"body": {"force": (1, 0)}}, r"body 'body': input 'force' = \(1, 0\): use 3 real numbers"),
        ({"ground": {"force": (1, 0, 0)}}, "body 'ground': it moves as it is told"),
        ({"body": [1, 0, 0]}, r"body 'body': use inputs by name, a mapping \(got \[1, 0, 0\]\)"),
        ([1, 0], r"inputs = \[1, 0\]: use a mapping of bodies to their inputs by name"),
        ({"boddy": {}}, "no body 'boddy'; there is body, ground; did you mean 'body'"),
    ],
)
def test_inputs_that_are_none_are_refused(inputs, says):
    world = fr.World({"ground": GROUND, "body": fr.RigidBody(Sphere(0.1), mass=1.0, position=(0, 0, 1))}, 1e-2)
    with pytest.raises(fr.StepError, match=says):
        world.step(inputs)
    assert world.steps == 0


def test_a_block_slides_from_where_the_slope_is_the_coefficient_of_friction():
    """To 0.1 %: at 0.9995 of it it stays to round-off, at 1.0005 it goes as Coulomb's law says."""
    block, μ, steps, h = fr.RigidBody(Box((0.2, 0.2, 0.1)), density=500, position=(0, 0, 0.05)), 0.5, 50, 2e-3
    held, slides = (on_incline(block, np.arctan(μ * share), μ, steps, h).pose("body") for share in (0.9995, 1.0005))
    assert abs(held.position[0]) < 1e-14
    angle = np.arctan(μ * 1.0005)
    assert slides.velocity[0] == pytest.approx(G * (np.sin(angle) - μ * np.cos(angle)) * steps * h, rel=1e-6)
    assert slides.position[2] == pytest.approx(0.05, abs=1e-14)


def test_a_block_tips_from_where_its_centre_leaves_its_base():
    block = fr.RigidBody(Box((0.1, 0.1, 0.2)), density=500, position=(0, 0, 0.1))
    stands, tips = (on_incline(block, np.arctan(0.5 * share), 2.0, 50).pose("body") for share in (0.9995, 1.0005))
    assert np.abs(stands.angular_velocity).max() < 1e-12
    assert tips.angular_velocity[1] > 1e-3


@pytest.mark.parametrize("friction", [1.0, 0.03])
def test_a_ball_rolls_down_a_slope_with_and_without_slip(friction):
    angle, steps, h = 0.2, 100, 2e-3
    world = on_incline(fr.RigidBody(Sphere(0.1), density=500, position=(0, 0, 0.1)), angle, friction, steps, h)
    rolls = friction > 2 / 7 * np.tan(angle)
    speeds_up = G * np.sin(angle) * 5 / 7 if rolls else G * (np.sin(angle) - friction * np.cos(angle))
    turns = speeds_up / 0.1 if rolls else 5 / 2 * friction * G * np.cos(angle) / 0.1
    ball = world.pose("body")
    assert ball.velocity[0] == pytest.approx(speeds_up * steps * h, rel=1e-5)
    assert ball.angular_velocity[1] == pytest.approx(turns * steps * h, rel=1e-4)
    assert abs(ball.position[2] - 0.1) < 1e-8
    assert world.energy == pytest.approx(world.ledger.supplied - world.ledger.dissipated, abs=1e-13)
    assert (world.ledger.friction > 1e-3) is not rolls


@pytest.mark.parametrize("dt", [1e-3, 1e-2, 3e-2])
def test_a_ball_that_bounces_does_not_gain_energy_at_any_step(dt):
    ball = fr.RigidBody(Sphere(0.1), mass=2.0, position=(0, 0, 0.5))
    world = fr.World({"ground": GROUND, "ball": ball}, dt, gravity=(0, 0, -G), restitution=1.0)
    start = 2.0 * G * 0.5
    for _ in range(100):
        world.step()
        whole = world.energy + 2.0 * G * world.pose("ball").position[2]
        assert whole <= start * (1 + 1e-12)
    assert whole == pytest.approx(start, rel=1e-8)


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_a_box_that_leaves_the_ground_comes_back_to_it(dt):
    """Nothing holds it where it was when it was last near: thrown up at 2 m/s it is back after 2 v/g, at that speed."""
    speed = 2.0
    box = fr.RigidBody(Box((0.1,) * 3), mass=1.0, position=(0, 0, 0.05), velocity=(0, 0, speed))
    world = fr.World({"ground": GROUND, "box": box}, dt, gravity=(0, 0, -G))
    while world.time < 2 * speed / G - 2 * dt:
        world.step()
        t = world.time
        assert world.pose("box").position[2] == pytest.approx(0.05 + speed * t - G * t**2 / 2, abs=1e-12)
    while world.time < 1.0:
        world.step()
    assert world.pose("box").position[2] == pytest.approx(0.05, abs=speed * dt / 2)
    assert world.touching == 4


@pytest.mark.parametrize("restitution", [1.0, 0.5])
def test_a_cradle_hands_on_what_restitution_says(restitution):
    """Balls that are a little apart meet one after the other: each keeps (1 - e)/2 of what it gets."""
    balls = {
        f"ball{k}": fr.RigidBody(Sphere(0.1), mass=1.0, position=(0.21 * k, 0, 0), velocity=(float(k == 0), 0, 0))
        for k in range(4)
    }
    world, steps = fr.World(balls, 1e-3, restitution=restitution), 45
    for _ in range(steps if restitution == 1 else 2 * steps):
        world.step()
    gets = ((1 + restitution) / 2) ** np.arange(4)
    expected = gets * (1 - restitution) / 2
    expected[-1] = gets[-1]
    speeds = [world.pose(name).velocity[0] for name in balls]
    np.testing.assert_allclose(speeds, expected, atol=1e-12)
    assert world.energy + world.ledger.dissipated == pytest.approx(0.5, abs=1e-12)


def test_boxes_that_tumble_into_each_other_keep_momenta_and_account():
    random = np.random.default_rng(0)
    boxes = {}
    for k in range(5):
        place = np.array([0.4 * (k % 3) - 0.4, 0.4 * (k // 3) - 0.2, 0.0])
        velocity, turning = 0.1 * random.standard_normal(3) - 2 * place, 2 * random.standard_normal(3)
        size = random.uniform(0.1, 0.3, 3)
        boxes[f"box{k}"] = fr.RigidBody(
            Box(size), density=500, position=place, velocity=velocity, angular_velocity=turning
        )
    world = fr.World(boxes, 2e-3, friction=0.4, restitution=0.3)
    start, energy, touched, before = momenta(world), world.energy, 0, world.energy
    for _ in range(150):
        world.step()
        touched += world.touching
        assert world.energy <= before * (1 + 1e-12)
        before = world.energy
    assert touched > 5
    for now, then in zip(momenta(world), start, strict=True):
        assert np.abs(now - then).max() < 1e-12
    assert world.energy + world.ledger.dissipated == pytest.approx(energy, rel=1e-12)
    assert world.ledger.friction > 0
    assert world.ledger.contact > 0


def test_ten_boxes_stay_where_they_are_stacked():
    boxes = {f"box{k}": fr.RigidBody(Box((0.1,) * 3), density=500, position=(0, 0, 0.05 + 0.1 * k)) for k in range(10)}
    world = fr.World({"ground": GROUND, **boxes}, 2e-3, gravity=(0, 0, -G), friction=0.5)
    for _ in range(30):
        world.step()
    for name, record in boxes.items():
        assert np.abs(world.pose(name).position - record.position).max() < 1e-12
        assert np.abs(world.velocity(name)).max() < 1e-12
    np.testing.assert_allclose(world.force_between("box0", "ground"), [0, 0, 5 * G], atol=1e-9)
    np.testing.assert_allclose(world.force_between("box8", "box9"), [0, 0, -0.5 * G], atol=1e-9)
    assert not world.force_between("box0", "box5").any()


@pytest.mark.parametrize("seconds", [0.2, pytest.param(20.0, marks=pytest.mark.slow)])
def test_a_box_that_friction_holds_does_not_creep_when_shaken_with_1_g(seconds):
    """At 1.3 times what it needs; where it needs 1 % more than there is, it slips in every swing."""
    rate = 2 * np.pi * 5
    reach = G / rate**2

    def shaken(t):
        velocity = np.array([reach * rate * np.sin(rate * t), 0, 0])
        return LIES._replace(position=np.array([reach * (1 - np.cos(rate * t)), 0, 0]), velocity=velocity)

    rubbed = []
    for friction, duration in ((1.3, seconds), (0.99, 0.2)):
        plate = fr.RigidBody(HalfSpace(), motion=shaken)
        box = fr.RigidBody(Box((0.1, 0.1, 0.05)), density=500, position=(0, 0, 0.025))
        world = fr.World({"plate": plate, "box": box}, 2e-3, gravity=(0, 0, -G), friction=friction)
        slipped = 0.0
        for _ in range(round(duration / 2e-3)):
            world.step()
            slipped = max(slipped, abs(world.pose("box").position[0] - world.pose("plate").position[0]))
        if friction == 1.3:
            assert slipped < 1e-5  # what poses and twists, as they are told, differ by in a step
        rubbed.append(world.ledger.friction / duration)
    assert rubbed[1] > 1.2 * rubbed[0]


def test_pairs_have_laws_of_their_own_and_groups_do_not_touch():
    """Two blocks slide on one ground, each with its own friction, and one ball bounces where another does not."""
    block = fr.RigidBody(Box((0.2, 0.2, 0.1)), density=500, position=(0, 0, 0.05), velocity=(1.0, 0, 0))
    ball = fr.RigidBody(Sphere(0.05), mass=0.1, position=(0, 0, 0.25))
    bodies = {"ground": GROUND, "rough": block, "ice": replace(block, position=(0.05, 0, 0.05))}
    bodies |= {"bounces": replace(ball, position=(0, 2, 0.25)), "falls": replace(ball, position=(0, 3, 0.25))}
    bodies["ghost"] = replace(ball, position=(0, 3, 0.15))
    laws = {("ice", "ground"): ContactLaw(0.0, 0.05), ("ground", "bounces"): ContactLaw(0.8, 0.0)}
    apart = [("rough", "ice"), ("ground", "ghost", "falls")]
    world = fr.World(bodies, 1e-3, gravity=(0, 0, -G), friction=0.2, pairs=laws, apart=apart)
    steps = 260
    for _ in range(steps):
        world.step()
    for name, μ in (("rough", 0.2), ("ice", 0.05)):
        assert world.velocity(name)[0][0] == pytest.approx(1 - μ * G * steps * 1e-3, rel=1e-9)
        assert world.pose(name).position[2] == pytest.approx(0.05, abs=1e-12)
    landed = np.sqrt(2 * 0.2 / G)
    rises = 0.8 * G * landed - G * (steps * 1e-3 - landed)
    assert world.velocity("bounces")[0][2] == pytest.approx(rises, abs=3 * G * 1e-3)
    for name in ("falls", "ghost"):  # through the ground, and one of them behind the other, which it does not meet
        assert world.velocity(name)[0][2] == pytest.approx(-G * steps * 1e-3, rel=1e-12)
    assert not world.force_between("rough", "ice").any()


def test_what_cannot_be_is_refused_with_where_and_how_much():
    box = fr.RigidBody(Box((0.1,) * 3), density=500, position=(0, 0, 0.04))
    with pytest.raises(fr.StepError, match=r"'ground' is 0\.01 m inside 'box'"):
        fr.World({"ground": GROUND, "box": box}, 1e-3)
    fr.World({"ground": GROUND, "box": box}, 1e-3, apart=[("ground", "box")]).step()
    with pytest.raises(fr.SceneError, match=r"apart: .*'boxes'.*did you mean 'box'"):
        fr.World({"ground": GROUND, "box": box}, 1e-3, apart=[("ground", "boxes")])
    with pytest.raises(fr.SceneError, match="body 'box': density = 2, mass = 1: use one of both"):
        fr.World({"box": fr.RigidBody(Box((0.1,) * 3), density=2, mass=1)}, 1e-3)
    with pytest.raises(fr.SceneError, match="'soft': on = 'soft': use another body"):
        fr.World({"soft": fr.SoftBody("plate.h5", on="soft")}, 1e-3)
    with pytest.raises(fr.SceneError, match="'a': on: a is on b is on a: use a chain without a circle"):
        fr.World({"a": fr.SoftBody("plate.h5", on="b"), "b": fr.SoftBody("plate.h5", on="a")}, 1e-3)
    with pytest.raises(fr.SceneError, match=r"body 'b': on: .*'nobody'"):
        fr.World({"a": fr.SoftBody("plate.h5", on="b"), "b": fr.SoftBody("plate.h5", on="nobody")}, 1e-3)
    with pytest.raises(fr.StepError, match="body 'top': it would turn by 5 rad"):
        fr.World({"top": fr.RigidBody(Sphere(0.1), mass=1.0, angular_velocity=(0, 0, 500))}, 1e-2).step()


def test_masses_of_a_million_to_one_touch():
    """The light one below: it carries the heavy one."""
    light = fr.RigidBody(Box((0.1,) * 3), mass=1e-3, position=(0, 0, 0.05))
    heavy = fr.RigidBody(Box((0.1,) * 3), mass=1e3, position=(0, 0, 0.15))
    world = fr.World({"ground": GROUND, "light": light, "heavy": heavy}, 2e-3, gravity=(0, 0, -G), friction=0.5)
    for _ in range(3):
        world.step()
    assert world.pose("heavy").position[2] == pytest.approx(0.15, abs=1e-9)
    assert world.force_between("light", "ground")[2] == pytest.approx(1000.001 * G, rel=1e-6)


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (
            lambda t: still._replace(position=np.array([0.0, 0, t > 0.004])),
            "in a step it went 1 m and turned 0 rad other",
        ),
        (lambda t: still._replace(velocity=np.array([5.0, 0, 0])), "in a step it went 0.005 m and turned 0 rad other"),
        (lambda t: still._replace(rotation=quaternion_of_vector((0, 0, 1.5 * (t > 0.004)))), "0 m and turned 1.5 rad"),
        (lambda t: still._replace(angular_velocity=np.array([0.0, 30, 0])), "0 m and turned 0.03 rad"),
        (lambda t: turning(t, 3.0), ""),
        (lambda t: turning(t, 600.0), ""),
        (lambda t: still, ""),
    ],
)
def test_a_driven_body_that_jumps_or_whose_twists_do_not_fit_is_told(motion, said):
    """Not one that turns and swings as its velocities say, 0.6 rad in a step, too."""
    world = fr.World({"hand": fr.RigidBody(Box((0.1,) * 3), motion=motion)}, 1e-3)
    for _ in range(10):
        world.step()
    told = [text for text in world.warnings if text.startswith("hand: ")]
    assert len(told) == bool(said)
    assert said in "".join(told)


def test_a_path_of_few_digits_is_no_jump():
    """Of a demo, whose base begins slowly: 1e-6 rad in a step, of poses and twists that each have six digits."""
    scene = fr.read_scene(Path(__file__).parents[2] / "demos" / "swing" / "swing.toml")
    assert scene.environment.base_path is not None
    world = fr.World({"hand": fr.RigidBody(Box((0.1,) * 3), motion=scene.environment.base_path)}, scene.run.dt)
    for _ in range(round(scene.run.duration / scene.run.dt)):
        world.step()
    assert not world.warnings


still = BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))


def turning(time, rate):
    """About an axis, and on a line that it swings along."""
    place, velocity = np.sin(10 * time) * np.ones(3), 10 * np.cos(10 * time) * np.ones(3)
    ω = rate * np.array([0.6, 0.0, 0.8])
    return BaseState(place, quaternion_of_vector(time * ω), velocity, ω)
