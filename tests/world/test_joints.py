"""Joints: what they hold stays together to round-off, momenta stay, and nothing gains energy."""

from dataclasses import replace

import numpy as np
import pytest
from test_rigid_motion import GROUND, LIES, G, momenta

import fenics_rom as fr
from fenics_rom.world.joints import Joint, ball, hinge, weld
from fenics_rom.world.shapes import Box


def box(position, **given):
    return fr.RigidBody(Box((0.1, 0.1, 0.2)), density=500, position=position, **given)


def test_a_pendulum_on_a_hinge_has_its_period():
    """That of small oscillations, with the first term of its amplitude; the hinge carries its weight."""
    length, angle, dt = 0.5, 0.1, 1e-2
    start = -length * np.array([np.sin(angle), 0, np.cos(angle)])
    bob = box(start, rotation=(np.cos(angle / 2), 0, np.sin(angle / 2), 0))
    world = fr.World({"bob": bob}, dt, gravity=(0, 0, -G), joints=[hinge("bob", "world", (0, 0, 0), (0, 0.2, 0))])
    mass, inertia = bob.mass_and_inertia()
    period = 2 * np.pi * np.sqrt((inertia[1, 1] + mass * length**2) / (mass * G * length)) * (1 + angle**2 / 16)
    places = []
    for _ in range(int(1.05 * period / dt)):
        world.step()
        places.append(world.pose("bob").position[0])
    x = np.array(places)
    rest = np.flatnonzero(x[:-1] * x[1:] < 0)
    times = (rest + 1 + x[rest] / (x[rest] - x[rest + 1])) * dt
    assert 2 * (times[1] - times[0]) == pytest.approx(period, rel=3e-4)
    assert np.linalg.norm(world.pose("bob").position) == pytest.approx(length, abs=1e-13)
    assert world.energy - world.ledger.supplied + world.ledger.dissipated == pytest.approx(0, abs=1e-13)
    assert world.ledger.dissipated < 1e-6
    assert world.joint_forces(0).shape == (2, 3)


def test_a_bob_stays_on_an_arm_that_is_turned():
    """At the end of an arm that goes round by 3 rad, in steps of 60 mrad: together to round-off."""
    ω, h = 3.0, 0.02

    def swung(t):
        turned = np.array([np.cos(ω * t / 2), 0, 0, np.sin(ω * t / 2)])
        return fr.BaseState(np.zeros(3), turned, np.zeros(3), np.array([0, 0, ω]))

    arm = fr.RigidBody(Box((0.4, 0.02, 0.02)), motion=swung)
    bob = box((0.2, 0, -0.15), velocity=(0, ω * 0.2, 0))
    world = fr.World({"arm": arm, "bob": bob}, h, gravity=(0, 0, -G), joints=[ball("bob", "arm", (0.2, 0, -0.05))])
    for step in range(1, 51):
        world.step()
        pose, (cos, sin) = world.pose("bob"), (np.cos(ω * h * step), np.sin(ω * h * step))
        w, x, y, z = pose.rotation
        upright = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        np.testing.assert_allclose(pose.position + 0.1 * upright, [0.2 * cos, 0.2 * sin, -0.05], atol=1e-13)


@pytest.mark.parametrize("first", [ball("a", "b", (0, 0, 0.1)), weld("a", "b", (0, 0, 0.1))])
def test_a_chain_that_flies_keeps_momenta_and_holds_together(first):
    """With steps of any length; what impulses at their ends take is booked, and never negative."""
    chain = {name: box((0, 0, 0.2 * k)) for k, name in enumerate("abcd")}
    chain["a"] = box((0, 0, 0), velocity=(1, 0, 0), angular_velocity=(0, -2, 3))
    joints = [first, ball("b", "c", (0, 0, 0.3)), hinge("c", "d", (0, 0, 0.5), (0.1, 0, 0))]
    world, random = fr.World(chain, 5e-3, joints=joints), np.random.default_rng(1)
    start, energy, lost = momenta(world), world.energy, world.ledger.dissipated
    assert lost > 0  # at the start: they did not move as joints let them
    for _ in range(25):
        world.dt = float(random.uniform(1e-3, 8e-3))
        world.step()
    for now, then in zip(momenta(world), start, strict=True):
        assert np.abs(now - then).max() < 1e-12
    assert world.energy + world.ledger.dissipated - lost == pytest.approx(energy, abs=1e-13)
    assert 0 <= world.ledger.dissipated - lost < 1e-5 * energy
    assert joint_gap(world) < 1e-12


def joint_gap(world):
    """Of the ball of b and c, m."""
    ends = []
    for name, along in (("b", 0.1), ("c", -0.1)):
        w, x, y, z = world.pose(name).rotation
        upright = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        ends.append(world.pose(name).position + along * upright)
    return np.abs(ends[0] - ends[1]).max()


def test_a_chain_that_falls_on_the_ground_closes_its_account():
    chain = {name: box((0, 0, 0.35 + 0.2 * k), angular_velocity=(0.5, 0.2, 0)) for k, name in enumerate("ab")}
    joints = [ball("a", "b", (0, 0, 0.45))]
    world = fr.World(
        {"ground": GROUND, **chain}, 4e-3, gravity=(0, 0, -G), friction=0.5, restitution=0.2, joints=joints
    )
    start, lost, touched = world.energy, world.ledger.dissipated, 0
    for _ in range(90):
        world.step()
        touched += world.touching
    assert touched > 10
    gone = world.ledger
    stored = world.energy - gone.supplied + gone.dissipated + gone.numerical - lost
    assert stored == pytest.approx(start, abs=1e-11 * gone.supplied)
    assert gone.contact > 0


def test_joints_that_cannot_be_are_refused():
    with pytest.raises(fr.SceneError, match=r"joint of 'a' and 'c': no body 'c'"):
        fr.World({"a": box((0, 0, 0))}, 1e-3, joints=[ball("a", "c", (0, 0, 0))])
    with pytest.raises(fr.SceneError, match="'a' with itself"):
        ball("a", "a", (0, 0, 0))
    with pytest.raises(fr.SceneError, match="both move as they are told"):
        fr.World({"ground": GROUND}, 1e-3, joints=[ball("ground", "world", (0, 0, 0))])
    with pytest.raises(fr.SceneError, match="three finite numbers"):
        Joint("a", "b", ((0, 0, np.nan),))
    with pytest.raises(fr.SceneError, match="hinge: axis"):
        hinge("a", "b", (0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize(("restitution", "dt"), [(0.0, 2e-3), (0.5, 1e-3), (0.5, 2e-3), (1.0, 2e-3)])
def test_hinged_boxes_land_flat(restitution, dt):
    """On eight corners with friction, more than the boxes have freedoms: forces are found, and the account closes."""
    side = fr.RigidBody(Box((0.1, 0.1, 0.1)), density=500, position=(0, 0, 0.1))
    boxes = {"ground": GROUND, "a": side, "b": replace(side, position=(0.1, 0, 0.1))}
    joints = [hinge("a", "b", (0.05, 0, 0.1), (0, 1, 0))]
    world = fr.World(boxes, dt, gravity=(0, 0, -G), friction=0.5, restitution=restitution, joints=joints)
    touched, sweeps, scale = 0, [], 0.1 * G
    for _ in range(round(0.3 / dt)):
        world.step()
        touched = max(touched, world.touching)
        sweeps.append(world.sweeps)
        gone = world.ledger
        assert world.energy - gone.supplied + gone.dissipated + gone.numerical == pytest.approx(0, abs=1e-12 * scale)
    assert touched == 8
    assert np.mean(sweeps) < 20  # round-off, so each CPU, decides which few steps take all that are allowed
    for name in "ab":
        assert world.pose(name).rotation[0] == pytest.approx(1, abs=1e-6)


def wall(point, slope):
    """A half-space whose face rises by a slope along x."""
    half = -np.arctan(slope) / 2
    return replace(GROUND, motion=LIES._replace(position=np.array(point), rotation=(np.cos(half), 0, np.sin(half), 0)))


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_hinged_boxes_land_on_two_walls(restitution, friction):
    """In a wedge of 90 degrees, fold about the hinge, and jump: forces are found, and the account closes."""
    side = fr.RigidBody(Box((0.1, 0.1, 0.1)), density=500, position=(0, 0, 0.22), velocity=(0.2, 0, 0))
    boxes = {"a": side, "b": replace(side, position=(0.1, 0, 0.22))}
    walls = {"left": wall((0.05, 0, -0.05), -1.0), "right": wall((0.05, 0, -0.05), 1.0)}
    joints = [hinge("a", "b", (0.05, 0, 0.22), (0, 1, 0))]
    world = fr.World(walls | boxes, 2e-3, gravity=(0, 0, -G), friction=friction, restitution=restitution, joints=joints)
    start, touched, folded = world.energy, 0, 0.0
    for _ in range(200):
        world.step()
        gone = world.ledger
        assert world.energy - gone.supplied + gone.dissipated + gone.numerical == pytest.approx(start, abs=1e-12)
        touched = max(touched, world.touching)
        folded = max(folded, abs(2 * world.pose("a").rotation[2]))
    assert touched >= 2
    assert folded > 0.05
    assert world.sweeps < 20
