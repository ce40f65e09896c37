"""Bodies of a world that are driven and turn feed rigid and soft ones; what drives them supplies the work."""

import numpy as np
import pytest
from test_soft_motion import TOUCHED, reduced
from turning import spin

import fenics_rom as fr
from fenics_rom.mechanics.base_path import quaternion_product
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.world.shapes import Box, Capsule, Cylinder

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
R, RATE = 0.02, 5.0  # m, rad/s
WEIGHT = {"effects.gravity": "acceleration = [0.0, 0.0, -9.81]"}


def roller(x, shape):
    """Along y, with its top at z = 0; it turns from rest."""
    lies, turns = quaternion_of_vector([np.pi / 2, 0.0, 0.0]), spin([x, 0.0, -R], [0, 1, 0], RATE, 0.1)

    def motion(time):
        state = turns(time)
        return state._replace(rotation=quaternion_product(state.rotation[None], lies[None])[0])

    return fr.RigidBody(shape, motion=motion)


def left_of(world, begun):
    gone = world.ledger
    return abs(world.energy - begun - gone.supplied + gone.dissipated + gone.lost_in_switching + gone.numerical)


@pytest.mark.parametrize("dt", [2e-3, 5e-3])
@pytest.mark.parametrize("length", [0.06, 0.2], ids=["within", "beyond"])
def test_two_rollers_feed_a_sheet(dt, length):
    """By friction, to their speed; it lies still on them, also where they go on beyond its sides."""
    sheet, size = Capsule(R, length), (0.3, 0.1, 0.01)
    bodies = {"a": roller(-0.05, sheet), "b": roller(0.05, sheet)}
    mass = 1000 * np.prod(size)
    bodies["sheet"] = fr.RigidBody(Box(size), density=1000, position=(0.0, 0.0, 0.005))
    world = fr.World(bodies, dt, friction=0.5, gravity=(0.0, 0.0, -9.81))
    begun, left = world.energy, 0.0
    while world.time < 0.3:
        world.step()
        left = max(left, left_of(world, begun))
    pose = world.pose("sheet")
    np.testing.assert_allclose(pose.velocity, [RATE * R, 0.0, 0.0], atol=1e-3 * RATE * R)
    np.testing.assert_allclose(pose.position[1:], [0.0, 0.005], atol=2e-8)  # 1e-8 is (1e-3)² R/2, of a slope
    work = -world.account("a").obstacles - world.account("b").obstacles
    assert work == pytest.approx(mass * (RATE * R) ** 2 / 2, rel=1e-3)
    assert left <= 1e-13 * work
    assert world.ledger.friction >= -1e-12 * work


@pytest.mark.parametrize("shape", [Capsule(R, 0.06), Cylinder(R, 0.06)], ids=["capsule", "cylinder"])
def test_rollers_feed_a_soft_beam(tmp_path, shape):
    """Whose whole faces they touch, as its nodes are 50 mm apart."""
    touched = {
        **TOUCHED,
        **WEIGHT,
        "effects.contact": 'points = "faces"',
        "contacts": '[contacts.low]\nsurface = "bottom"',
    }
    rom = reduced(tmp_path, frame="moving", **touched)
    bodies = {name: roller(x, shape) for name, x in (("a", 0.1), ("b", 0.2))}
    bodies["beam"] = fr.SoftBody(rom, position=(0.15, 0.0, 0.0101))
    world = fr.World(bodies, 1e-3, friction=0.5)
    begun, left, scale = world.energy, 0.0, 0.0
    for _ in range(250):
        world.step()
        left, scale = max(left, left_of(world, begun)), max(scale, abs(world.ledger.supplied), world.energy)
    P, _ = world.simulator("beam").momentum
    speed = P / rom.moving_frame.mass
    assert speed[0] == pytest.approx(RATE * R, rel=0.05)
    assert left <= 1e-12 * scale
    assert world.account("a").obstacles + world.account("b").obstacles < 0
