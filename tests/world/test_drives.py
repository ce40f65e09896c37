"""What acts along a hinge or a slider: limits, friction, damping, rotors, springs, motors, followers.

Each against a closed form; accounts close to round-off, and what slides or turns does not drift.
"""

import math

import numpy as np
import pytest
from test_rigid_motion import G

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.world.drives import Drive, Motor
from fenics_rom.world.joints import ball, hinge, slider
from fenics_rom.world.shapes import Box

DOWN, UPRIGHT = (0, 0, -G), (1.0, 0, 0, 0)


def box(position=(0, 0, 0), mass=2.0, **given):
    return fr.RigidBody(Box((0.1, 0.06, 0.2)), mass=mass, position=position, **given)


def misses(world):
    """What the account lacks, J."""
    ledger = world.ledger
    return world.energy - ledger.supplied + ledger.dissipated + ledger.numerical


def turned(angle, axis=(0, 1, 0)):
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis))])


def wheel(drive, dt, gravity=(0, 0, 0), speed=0.0, **given):
    """A box on a hinge through its centre, and its moment about that."""
    body = box(angular_velocity=(0, speed, 0), **given)
    joint = hinge("world", "box", (0, 0, 0), (0, 0.1, 0), drive, name="axle")
    return fr.World({"box": body}, dt, gravity=gravity, joints=[joint]), body.mass_and_inertia()[1][1, 1]


def test_a_motor_that_holds_a_position_is_an_oscillator():
    """With the closed form of a spring and a damper, to the square of the step; its work closes the account."""
    errors, I0 = [], 3e-3
    for dt in (1e-2, 5e-3):
        motor = Motor("position", gain=0.9, damping=0.02)
        world, moment = wheel(Drive(armature=I0, motor=motor), dt)
        worst, start = 0.0, misses(world)
        δ, ω0 = 0.02 / 2 / (moment + I0), math.sqrt(0.9 / (moment + I0))
        ω = math.sqrt(ω0**2 - δ**2)
        for step in range(1, round(0.5 / dt) + 1):
            world.step({"axle": {"target": 0.5}})
            t = step * dt
            exact = 0.5 * (1 - math.exp(-δ * t) * (math.cos(ω * t) + δ / ω * math.sin(ω * t)))
            worst = max(worst, abs(world.joint_state("axle").position - exact))
        errors.append(worst)
        assert misses(world) == pytest.approx(start, abs=1e-14)
        assert world.ledger.supplied != 0
        assert abs(world.ledger.numerical) < 1e-13  # what sweeps leave of u, to 1e-13 of it
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    assert errors[1] < 5e-3


def test_a_rotor_and_a_spring_store_what_they_take():
    """A wheel with both swings as J θ'' = -k (θ - rest). It loses what an angle of a step is less than its tangent."""
    world, moment = wheel(Drive(armature=0.01, stiffness=2.0, rest=0.3), 4e-3)
    energy, crossed, before = world.energy, [], 0.0
    for step in range(1, 300):
        world.step()
        now = world.joint_state("axle").position - 0.3
        if before < 0 <= now:
            crossed.append((step - now / (now - before)) * 4e-3)
        before = now
    assert misses(world) == pytest.approx(energy, abs=1e-14)
    assert 0 <= world.ledger.dissipated < 1e-7 * energy
    period = np.diff(crossed).mean()
    assert period == pytest.approx(2 * math.pi * math.sqrt((moment + 0.01) / 2.0), rel=4e-4)


@pytest.mark.parametrize(("drive", "speed"), [(Drive(damping=0.02), 2.0), (Drive(friction=0.03), 2.0)])
def test_a_wheel_runs_down(drive, speed):
    """By exp(-d t/I), and by F/I until it stands still: to the last bit, with all of its energy booked."""
    world, moment = wheel(drive, 5e-3, speed=speed)
    start = world.energy
    for _ in range(120):
        world.step()
    t, state = 0.6, world.joint_state("axle")
    if drive.damping:
        assert state.position == pytest.approx(
            speed * moment / drive.damping * (1 - math.exp(-drive.damping * t / moment)), rel=1e-4
        )
    else:
        assert state.position == pytest.approx(speed**2 * moment / (2 * drive.friction), rel=1e-4)
        assert world.energy < 1e-30
        assert world.ledger.dissipated == pytest.approx(start, rel=1e-13)
    assert misses(world) == pytest.approx(start, abs=1e-15)


def test_friction_holds_below_its_torque_and_no_more():
    """A pendulum that leans stays where it is, for ever, or falls."""
    weight = 2.0 * G * 0.3
    for share, moves in ((1.001, False), (0.999, True)):
        joint = hinge("world", "box", (0, 0, 0), (0, 0.1, 0), Drive(friction=share * weight), name="axle")
        world = fr.World({"box": box((0.3, 0, 0))}, 5e-3, gravity=DOWN, joints=[joint])
        for _ in range(100):
            world.step()
        assert (abs(world.joint_state("axle").position) > 1e-4) == moves
        if not moves:
            assert abs(world.joint_state("axle").position) < 1e-15


def test_a_slider_on_a_slope():
    """Goes as gravity along it less friction says, exactly in its mean, and leaves the axis by nothing."""
    slope, μ = 0.5, 4.0
    axis = np.array([math.cos(slope), 0, -math.sin(slope)])
    joint = slider("world", "box", (0, 0, 0), axis, Drive(friction=μ), name="rail")
    world = fr.World({"box": box(rotation=turned(0.3))}, 5e-3, gravity=DOWN, joints=[joint])
    for _ in range(100):
        world.step()
    state = world.joint_state("rail")
    assert state.position == pytest.approx((G * math.sin(slope) - μ / 2.0) * 0.5**2 / 2, rel=1e-10)
    place = world.pose("box").position
    assert np.abs(place - state.position * axis).max() < 1e-14
    assert np.abs(world.pose("box").rotation - turned(0.3)).max() < 1e-15
    assert misses(world) == pytest.approx(0, abs=1e-14)


def test_a_slider_in_a_hub_that_flies_keeps_momenta():
    """Two bodies that slide on one another as both tumble, with a motor between them: momenta and account close."""
    bodies = {
        "hub": box(mass=3.0, angular_velocity=(1.0, 2.0, -3.0)),
        "rod": box(
            (0.3, 0, 0), mass=1.0, velocity=np.cross((1.0, 2.0, -3.0), (0.3, 0, 0)), angular_velocity=(1, 2, -3)
        ),
    }
    motor = Motor("position", gain=200.0, damping=3.0)
    joint = slider("hub", "rod", (0.2, 0.1, 0), (1, 0, 0.2), Drive(motor=motor, armature=0.2), name="rail")
    world = fr.World(bodies, 5e-3, joints=[joint], apart=[["hub", "rod"]])

    def momenta():
        p, spins = np.zeros((2, 3))
        for name in bodies:
            body = world._body(name)
            linear, spin = body.momenta
            p, spins = p + linear, spins + spin + np.cross(body.pose.position, linear)
        return p, spins

    then, start = momenta(), misses(world)
    for step in range(200):
        world.step({"rail": {"target": 0.1 * math.sin(0.02 * step)}})
    for now, before in zip(momenta(), then, strict=True):
        assert np.abs(now - before).max() < 1e-12
    assert misses(world) == pytest.approx(start, abs=1e-12)
    hub, rod, start = world.pose("hub"), world.pose("rod"), np.array([0.2, 0.1, 0])
    R = rotation_matrix(hub.rotation)
    assert np.abs(R.T @ rotation_matrix(rod.rotation) - np.eye(3)).max() < 1e-13
    gone = R.T @ (rod.position + R @ (start - [0.3, 0, 0]) - hub.position) - start
    along = np.array([1, 0, 0.2]) / np.hypot(1, 0.2)
    assert np.abs(gone - world.joint_state("rail").position * along).max() < 1e-12
    assert abs(world.joint_state("rail").position) > 1e-3


@pytest.mark.parametrize("dt", [4e-3, 2e-2])
def test_limits_hold(dt):
    """A pendulum falls on its limit, at which it is from then on, to round-off; nothing gains energy."""
    joint = hinge("world", "box", (0, 0, 0), (0, 0.1, 0), Drive(limits=(-0.4, 0.7), armature=0.02), name="axle")
    world = fr.World({"box": box((0.3, 0, 0))}, dt, gravity=DOWN, joints=[joint])
    lost = 0.0
    for _ in range(round(0.8 / dt)):
        world.step()
        assert world.joint_state("axle").position <= 0.7 + 1e-14
        assert world.ledger.dissipated >= lost - 1e-14
        lost = world.ledger.dissipated
    assert world.joint_state("axle").position == pytest.approx(0.7, abs=1e-13)
    assert world.joint_state("axle").force == pytest.approx(-2.0 * G * 0.3 * math.cos(0.7), rel=1e-10)
    assert world.energy < 1e-25
    assert misses(world) == pytest.approx(0, abs=1e-14)


def test_a_motor_pushes_no_more_than_it_can():
    """One that is to hold a leaning pendulum and is too weak: it sinks as under that torque alone."""
    paths = []
    for motor, given in ((Motor("position", gain=1e6, most=3.0), 0.0), (Motor("torque"), -3.0)):
        joint = hinge("world", "box", (0, 0, 0), (0, 0.1, 0), Drive(motor=motor), name="axle")
        world = fr.World({"box": box((0.3, 0, 0))}, 2e-3, gravity=DOWN, joints=[joint])
        for _ in range(100):
            world.step({"axle": {"target": given}})
        paths.append(world.joint_state("axle").position)
        assert world.joint_state("axle").by_motor == -3.0
    assert paths[0] == pytest.approx(paths[1], abs=1e-3)  # at first it holds


def test_a_follower_goes_with_its_leader():
    """Two fingers on sliders, one that follows the other with a ratio, against a leader of their mass together."""
    motor = Motor("torque")
    bodies = {"left": box((0, 0, 0)), "right": box((0, 1, 0), mass=1.0)}
    drives = Drive(motor=motor), Drive(0.05, follows=("lead", -2.0, 0.05))
    joints = [
        slider("world", name, (0, y, 0), (1, 0, 0), drive, name=of)
        for name, y, drive, of in zip(bodies, (0, 1), drives, ("lead", "follow"), strict=True)
    ]
    world = fr.World(bodies, 2e-3, joints=joints)
    for _ in range(50):
        world.step({"lead": {"target": 3.0}})
    lead, follow = world.joint_state("lead").position, world.joint_state("follow").position
    assert lead == pytest.approx(3.0 / (2.0 + 4 * 1.0) * 0.1**2 / 2, rel=1e-12)
    assert follow == pytest.approx(0.05 - 2 * lead, abs=1e-15)
    assert misses(world) == pytest.approx(0, abs=1e-15)


def test_drives_that_cannot_be_are_refused():
    with pytest.raises(SceneError, match="use two numbers"):
        Drive(limits=(1, 0))
    with pytest.raises(SceneError, match="use one within its limits"):
        Drive(2.0, (0.0, 1.0))
    with pytest.raises(SceneError, match="friction = -1: use a finite number >= 0"):
        Drive(friction=-1)
    with pytest.raises(SceneError, match="gain > 0 of a position"):
        Motor("position")
    world, _ = wheel(Drive(), 1e-3)
    with pytest.raises(StepError, match="no body"):
        world.step({"axle": {"target": 1.0}})
    world, _ = wheel(Drive(motor=Motor("torque")), 1e-3)
    with pytest.raises(StepError, match="aim"):
        world.step({"axle": {"aim": 1.0}})
    with pytest.raises(StepError, match="no drive"):
        fr.World({"a": box()}, 1e-3, joints=[ball("world", "a", (0, 0, 0))]).joint_state(0)
