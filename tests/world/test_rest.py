"""What comes to rest lies on the floor, at any step: heights against the exact ones, and energy that never grows."""

from dataclasses import replace

import numpy as np
import pytest
from turning import NOTHING, spin

import fenics_rom as fr
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.world import world as world_module
from fenics_rom.world.shapes import Box, Capsule, Cylinder, HalfSpace, Sphere
from fenics_rom.world.tolerances import PENETRATION_TOLERANCE

G = 9.81
LIES = fr.BaseState(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
GROUND = fr.RigidBody(HalfSpace(), motion=LIES)
SIZE = 0.1  # m, at least the radius around each body
EXACT = 10 * PENETRATION_TOLERANCE * SIZE  # what is less deep is left as it is; and a margin of ten
FALLS = [(Box((0.1, 0.1, 0.1)), 0.05), (Sphere(0.05), 0.05), (Capsule(0.04, 0.1), 0.09), (Cylinder(0.05, 0.1), 0.05)]


def lowest(world, name):
    """Of a box or a capsule above the ground, m."""
    pose, shape = world.pose(name), world.bodies[name].shape
    R = rotation_matrix(pose.rotation)
    if isinstance(shape, Capsule):
        return float(pose.position[2] - abs(R[2, 2]) * shape.length / 2 - shape.radius)
    return float((shape.vertices @ R.T + pose.position)[:, 2].min())


def mechanical_energy(world):
    """Kinetic and of gravity, J."""
    free = {name: body for name, body in world.bodies.items() if body.motion is None}
    return world.energy + sum(
        G * body.mass_and_inertia()[0] * world.pose(name).position[2] for name, body in free.items()
    )


@pytest.mark.parametrize(
    ("dt", "restitution"), [(1e-3, 0.0), *((dt, e) for dt in (5e-3, 1e-2, 2e-2, 5e-2) for e in (0.0, 0.5))]
)
@pytest.mark.parametrize(("shape", "height"), FALLS, ids=["box", "sphere", "capsule", "cylinder"])
def test_what_has_fallen_lies_on_the_floor(shape, height, dt, restitution):
    body = fr.RigidBody(shape, density=500, position=(0, 0, height + 0.3))
    world = fr.World({"ground": GROUND, "body": body}, dt, gravity=(0, 0, -G), friction=0.5, restitution=restitution)
    start = most = mechanical_energy(world)
    for _ in range(round((1.0 if restitution == 0 else 2.5) / dt)):
        world.step()
        now = mechanical_energy(world)
        assert now <= most + 1e-13 * start
        most = now
        assert world.pose("body").position[2] > height - EXACT
    assert world.pose("body").position[2] == pytest.approx(height, abs=EXACT)
    assert np.abs(world.velocity("body")).max() < 1e-9
    assert world.force_between("body", "ground")[2] == pytest.approx(G * body.mass_and_inertia()[0], rel=1e-9)


@pytest.mark.parametrize("dt", [1e-2, 5e-2])
@pytest.mark.parametrize("shape", [Box((0.1, 0.14, 0.2)), Capsule(0.05, 0.2)], ids=["box", "capsule"])
def test_what_has_tumbled_lies_on_the_floor(shape, dt):
    """It gets in as it turns far in a step, is let out as it rests, and has never more energy than before the fall."""
    deepest = 0.0
    for seed in range(3):
        random = np.random.default_rng(seed)
        turned, spin = random.standard_normal(4), 3 * random.standard_normal(3)
        body = fr.RigidBody(
            shape, density=500, position=(0, 0, 0.6), rotation=turned / np.linalg.norm(turned), angular_velocity=spin
        )
        world = fr.World({"ground": GROUND, "body": body}, dt, gravity=(0, 0, -G), friction=0.5)
        start = mechanical_energy(world)
        for _ in range(round(3.0 / dt)):
            world.step()
            assert mechanical_energy(world) <= start * (1 + 1e-13)
            assert world.ledger.contact + world.ledger.friction >= 0
            deepest = min(deepest, lowest(world, "body"))
        assert lowest(world, "body") == pytest.approx(0.0, abs=EXACT)
        assert mechanical_energy(world) + world.ledger.dissipated == pytest.approx(start, rel=1e-12)
    assert deepest < -1e-6  # some were inside


@pytest.mark.parametrize("dt", [2.5e-3, 1e-2])
def test_what_slides_on_a_plane_that_turns_towards_it_is_let_out(dt):
    """It is never deeper than a hundredth of what the plane turns in a step times the way, and outside at the end."""
    radius, rate, begins = 0.02, 1.0, 0.6
    plane = fr.RigidBody(HalfSpace(), motion=spin(NOTHING, [0, -1, 0], rate, 0.1))
    ball, deepest = fr.RigidBody(Sphere(radius), mass=1.0, position=(begins, 0, radius)), 0.0
    world = fr.World({"plane": plane, "ball": ball}, dt, gravity=(0, 0, -G))
    for _ in range(round(0.8 / dt)):
        world.step()
        x, _, z = rotation_matrix(world.pose("plane").rotation).T.dot(world.pose("ball").position)
        deepest = max(deepest, radius - z)
    assert begins - x > 0.5
    assert deepest < 1e-2 * rate * dt * (begins - x)
    assert radius - z < EXACT


@pytest.mark.parametrize("dt", [1e-2, 5e-2])
def test_boxes_that_fall_one_by_one_lie_on_one_another(dt):
    """The lowest is stopped within a step, so that the next one, which fell as fast, hits it in the same step."""
    boxes = {f"box{k}": fr.RigidBody(Box((0.1,) * 3), density=500, position=(0, 0, 0.1 + 0.15 * k)) for k in range(5)}
    world = fr.World({"ground": GROUND, **boxes}, dt, gravity=(0, 0, -G), friction=0.5)
    for _ in range(round(4.0 / dt)):
        world.step()
    for k, name in enumerate(boxes):
        assert world.pose(name).position[2] == pytest.approx(0.05 + 0.1 * k, abs=(k + 1) * EXACT)


def test_a_step_that_is_refused_names_one_that_would_do(monkeypatch):
    world = fr.World({"ground": GROUND, "ball": fr.RigidBody(Sphere(0.1), mass=1.0, position=(0, 0, 0.2))}, 5e-2)
    find = world_module.find_forces

    def find_in_short_steps(pairs, h, start, guide):
        if h > 0.01:
            raise fr.StepError("no forces were found")
        return find(pairs, h, start, guide)

    monkeypatch.setattr(world_module, "find_forces", find_in_short_steps)
    if world._loops is not None:
        monkeypatch.setattr(type(world._loops), "take", lambda *_: None)
    with pytest.raises(fr.StepError, match=r"no forces were found; steps of 0.00625 s would do"):
        world.step()
    assert (world.steps, world.dt) == (0, 5e-2)
    world.dt = 0.00625
    world.step()


def test_forces_stay_those_of_the_last_step_where_one_is_refused(monkeypatch):
    """One box lies, another one falls on it: pairs come and go, also in the steps that are refused."""
    box, falling = fr.RigidBody(Box((0.1,) * 3), density=500, position=(0, 0, 0.05)), (0, 0, -8.0)
    other = replace(box, position=(0, 0, 0.17), velocity=falling)
    world = fr.World({"ground": GROUND, "box": box, "other": other}, 1e-3, gravity=(0, 0, -9.81))

    def refuse(*_):
        raise fr.StepError("no forces were found")

    for _ in range(10):
        world.step()
        before = world.force_between("box", "ground"), world.force_between("other", "box"), world.touching
        with monkeypatch.context() as patch:
            patch.setattr(fr.World, "_find", refuse)
            if world._loops is not None:
                patch.setattr(type(world._loops), "take", lambda *_: None)
            with pytest.raises(fr.StepError):
                world.step()
        np.testing.assert_array_equal(world.force_between("box", "ground"), before[0])
        np.testing.assert_array_equal(world.force_between("other", "box"), before[1])
        assert world.touching == before[2]
