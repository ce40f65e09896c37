"""Compiled steps of worlds with drives and sliders are those of NumPy: motion, what joints bear, accounts."""

from contextlib import nullcontext

import numpy as np
import pytest
from test_compiled_joints import assert_same, swung
from test_compiled_world import both, told, without
from test_rigid_motion import GROUND
from test_soft_motion import momenta

import fenics_rom as fr
from fenics_rom.compilation import compiled
from fenics_rom.world.drives import Drive, Motor
from fenics_rom.world.joints import ball, hinge, slider, weld
from fenics_rom.world.shapes import Box, Sphere

pytestmark = [
    pytest.mark.skipif(not compiled(), reason="numba is not installed, or turned off"),
    pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning"),
]
EPS = float(np.finfo(float).eps)


def states_of(world):
    """Position, speed, rotor, by the motor and by all, of each joint that has a drive."""
    joints = (name for name, joint in world._joints.points.items() if joint.drive is not None)
    return np.array([world.joint_state(name) for name in joints])


def some_drive(random, sliding):
    """Of any of the things that a drive may have, of the size of links below."""
    size = 20.0 if sliding else 0.05
    given = {"friction": 0.2 * size, "damping": 0.05 * size, "armature": 2e-3 * size, "stiffness": size}
    given = {name: value * random.uniform() for name, value in given.items() if random.random() < 0.5}
    motors = [
        Motor("position", gain=10 * size, damping=0.1 * size),
        Motor("position", gain=100 * size, damping=size, most=0.5 * size),
        Motor("velocity", gain=size, most=0.3 * size),
        Motor("velocity", gain=size),
        Motor("torque", most=0.2 * size),
        None,
    ]
    reach = 0.01 if sliding else 0.3
    limits = (-reach * random.uniform(), reach * random.uniform()) if random.random() < 0.5 else None
    return Drive(limits=limits, motor=motors[random.integers(6)], rest=0.1 * random.normal() * reach, **given)


def links(random, count, fastened):
    """Links by joints with drives, sliders, balls and welds, one of which follows another; the first on an arm."""
    kinds = [
        lambda one, other, at, name: ball(one, other, at, name=name),
        lambda one, other, at, name: weld(one, other, at, 0.03, name=name),
        lambda one, other, at, name: hinge(one, other, at, 0.03 * random.normal(size=3), name=name),
        lambda one, other, at, name: slider(one, other, at, random.normal(size=3), name=name),
        lambda one, other, at, name: slider(
            one, other, at, random.normal(size=3), some_drive(random, sliding=True), name=name
        ),
        lambda one, other, at, name: hinge(
            one, other, at, random.normal(size=3), some_drive(random, sliding=False), name=name
        ),
    ]
    kinds += kinds[-1:]
    bodies, joints = {"arm": fr.RigidBody(Box((0.02, 0.02, 0.02)), motion=swung)} if fastened else {}, []
    for k in range(count):
        given = {"mass": random.uniform(0.02, 0.3), "position": (0.1 * k + 0.05, 0, 0)}
        if not fastened:
            given |= {"velocity": random.normal(size=3), "angular_velocity": random.normal(size=3)}
        bodies[f"link{k}"] = fr.RigidBody(Box((0.08, 0.03, 0.02)), **given)
        if k or fastened:
            before = f"link{k - 1}" if k else "arm"
            joints.append(kinds[random.integers(len(kinds))](before, f"link{k}", (0.1 * k, 0, 0), f"j{k}"))
    for k in range(2):
        at = (0.1 * count, 0.02 * k, 0)
        bodies[f"claw{k}"] = fr.RigidBody(Box((0.02, 0.01, 0.01)), mass=0.02, position=at)
        drive = Drive(follows=("grip0", -1.5, 0.0) if k else None, motor=None if k else Motor("velocity", 0.2))
        joints.append(hinge(f"link{count - 1}", f"claw{k}", at, (0, 0, 1), drive, name=f"grip{k}"))
    gravity = (0, 0, -9.81) if fastened else (0, 0, 0)
    return fr.World(bodies, 2e-3, joints=joints, gravity=gravity, apart=[list(bodies)])


@pytest.mark.parametrize("seed", [1, 2, 3, 6, 7])
def test_driven_chains_do_as_with_numpy(seed):
    """Hung from an arm that swings, or flying; either takes over from the other."""
    fastened = seed % 2 == 0
    worlds = both(lambda: links(np.random.default_rng(seed), 5, fastened))
    random, start, begun = np.random.default_rng(seed), worlds[0].energy, worlds[0].ledger
    motors = sorted(worlds[0]._motors)
    before = np.empty(0) if fastened else np.concatenate(momenta(worlds[0]))
    for step in range(60):
        inputs = {name: {"target": 0.3 * np.sin(0.1 * step + k)} for k, name in enumerate(motors)}
        with nullcontext() if random.random() < 0.8 else without(worlds[0]):
            worlds[0].step(inputs)
        worlds[1].step(inputs)
        if step % 10 == 9:
            assert_same(worlds)
            ours, theirs = map(states_of, worlds)
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    account = worlds[0].ledger
    turnover = max(start, worlds[0].energy, abs(account.supplied), account.dissipated)
    gap = worlds[0].energy - start - account.supplied + begun.supplied + account.numerical
    gap += account.dissipated - begun.dissipated
    assert abs(gap) < 10 * 60 * EPS * turnover
    if not fastened:
        after = np.concatenate(momenta(worlds[0]))
        np.testing.assert_allclose(after, before, atol=10 * 60 * EPS * np.abs(before).max())
    assert worlds[0].compiled_steps > 0.9 * 40


def grasp():
    """A gripper on a rail whose fingers, one of which follows the other, close on a ball and lift it."""
    bodies = {"ground": GROUND, "ball": fr.RigidBody(Sphere(0.02), mass=0.1, position=(0, 0, 0.02))}
    bodies["palm"] = fr.RigidBody(Box((0.2, 0.04, 0.02)), mass=0.5, position=(0, 0, 0.1))
    for name, x in (("left", -0.05), ("right", 0.05)):
        bodies[name] = fr.RigidBody(Box((0.02, 0.03, 0.06)), mass=0.05, position=(x, 0, 0.05))
    lift = Drive(-0.01, limits=(-0.011, 0.2), motor=Motor("position", gain=800.0, damping=60.0))
    close = Drive(limits=(0, 0.04), motor=Motor("position", gain=2e3, damping=20.0, most=8.0))
    also = Drive(limits=(0, 0.04), follows=("close", 1.0, 0.0))
    joints = [
        slider("world", "palm", (0, 0, 0.1), (0, 0, 1), lift, name="lift"),
        slider("palm", "left", (-0.05, 0, 0.08), (1, 0, 0), close, name="close"),
        slider("palm", "right", (0.05, 0, 0.08), (-1, 0, 0), also, name="also"),
    ]
    return fr.World(bodies, 2e-3, joints=joints, gravity=(0, 0, -9.81), friction=0.6, apart=[["palm", "left", "right"]])


def test_a_grasp_is_that_of_numpy():
    """From fingers at rest at their limits, where both limits hold what one follows the other by twice."""
    worlds = both(grasp)
    start, begun = worlds[0].energy, worlds[0].ledger
    for step in range(180):
        inputs = {"close": {"target": 0.04 if step > 20 else -0.01}, "lift": {"target": 0.03 if step > 80 else -0.01}}
        for world in worlds:
            world.step(inputs)
        if step % 20 == 19:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-8)
            np.testing.assert_allclose(*map(states_of, worlds), atol=1e-8)
    assert worlds[0].pose("ball").position[2] > 0.03  # lifted
    account = worlds[0].ledger
    gap = worlds[0].energy - start - account.supplied + begun.supplied + account.numerical
    gap += account.dissipated - begun.dissipated
    assert abs(gap) < 10 * 180 * EPS * max(worlds[0].energy, abs(account.supplied))
    assert worlds[0].compiled_steps > 0.7 * 180


def test_shapes_off_the_centre_of_mass_do_as_with_numpy():
    """A ball and a box whose mass is off the middle of their shapes fall, and rock on the ground."""

    def make():
        given = {"mass": 0.4, "inertia": np.diag([3e-4, 4e-4, 5e-4]), "angular_velocity": (1.0, 2.0, 0.0)}
        off = {"shape_position": (0.01, 0.005, -0.01), "shape_rotation": (0.8, 0.0, 0.6, 0.0)}
        bodies = {"ground": GROUND}
        for k, shape in enumerate((Sphere(0.05), Box((0.08, 0.06, 0.1)))):
            bodies[f"body{k}"] = fr.RigidBody(shape, position=(0.3 * k, 0, 0.08), **given, **off)
        return fr.World(bodies, 2e-3, gravity=(0, 0, -9.81), friction=0.5)

    worlds = both(make)
    for step in range(100):
        for world in worlds:
            world.step()
        if step % 20 == 19:
            np.testing.assert_allclose(told(worlds[0]), told(worlds[1]), atol=1e-10)
    assert worlds[0].compiled_steps > 40
