"""What comes through the skins of soft bodies in a world is told, and what touches them or carries them is not."""

import numpy as np
import pytest
from test_soft_motion import CLAMPED, LIES, TOUCHED, reduced

import fenics_rom as fr
from fenics_rom.compilation import compiled
from fenics_rom.errors import FenicsRomWarning, StepError
from fenics_rom.world.shapes import Box, Sphere

DT, RADIUS = 1e-3, 0.015
ACROSS = (np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5))  # along -y
BELOW = {**CLAMPED, **TOUCHED, "contacts": '[contacts.bottom]\nsurface = "bottom"'}  # of what is 0.02 m high


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A beam along x that is touched from below alone."""
    return reduced(tmp_path_factory.mktemp("held"), frame="fixed", **BELOW)


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """One that is touched at its end alone, and a free one."""
    kinds = {"fixed": CLAMPED, "moving": {}}
    touched = {**TOUCHED, "contacts": '[contacts.right]\nsurface = "right"'}
    return [reduced(tmp_path_factory.mktemp(kind), frame=kind, **more, **touched) for kind, more in kinds.items()]


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    return reduced(tmp_path_factory.mktemp("carried"), frame="moving", **BELOW)


def ball(height, speed=0.0, radius=RADIUS):
    return fr.RigidBody(Sphere(radius), mass=1e-3, position=(0.23, 0.013, height), velocity=(0, 0, speed))


def steps(world, count):
    for _ in range(count):
        world.step()
    return [message for message in world.warnings if "inside body" in message]


def test_a_ball_that_falls_through_the_top_is_told_once_with_its_depth(held):
    world = fr.World({"beam": fr.SoftBody(held), "ball": ball(0.0205 + RADIUS, -0.4)}, DT)
    with pytest.warns(FenicsRomWarning, match="body 'ball' is .* inside body 'beam' at .* no contact points") as told:
        (message,) = steps(world, 60)
    assert len(told) == 1
    deep, pose = float(message.partition("up to ")[2].split()[0]), world.pose("ball")
    since = 15 * DT * abs(pose.velocity[2]) if compiled() else 0.0  # it is looked at every 16 compiled steps
    ahead = 1e3 * (0.02 + RADIUS - pose.position[2]) - deep
    assert -1.0 <= ahead <= 1e3 * since + 1.0


@pytest.mark.parametrize(("dt", "speed"), [(1e-3, 20.0), (1e-4, 20.0), (1e-3, 200.0)])
def test_a_ball_that_flies_through_is_told(ended, dt, speed):
    """Between two looks at what rests, and between two steps."""
    world = fr.World({"beam": fr.SoftBody(ended[0]), "ball": ball(0.01 + 0.0101 * speed, -speed)}, dt)
    with pytest.warns(FenicsRomWarning, match="body 'ball' is .* inside body 'beam' at .* no contact points"):
        (message,) = steps(world, round(0.016 / dt))
    assert 0.5 * RADIUS <= 1e-3 * float(message.partition("up to ")[2].split()[0]) <= RADIUS + 0.02
    assert world.pose("ball").position[2] < -0.02


def test_a_ball_that_is_kept_out_is_not_told(held):
    world = fr.World({"beam": fr.SoftBody(held), "ball": ball(-0.051, 0.4, 0.05)}, DT)
    assert not steps(world, 60)
    assert world.pose("ball").position[2] < -0.04


def test_the_look_moves_no_bit(held, monkeypatch):
    def run():
        world = fr.World({"beam": fr.SoftBody(held), "ball": ball(-0.051, 0.4, 0.05)}, DT)
        steps(world, 40)
        return world.pose("ball").position, world.energy

    looked = run()
    monkeypatch.setattr("fenics_rom.world.skins.WorldSkins.look", lambda self, steps, time: None)
    np.testing.assert_array_equal(looked[0], run()[0])
    assert looked[1] == run()[1]


def test_bodies_that_begin_in_one_another_are_refused(held):
    with pytest.raises(StepError, match=r"body 'ball' is 0\.005 m inside body 'beam' at .* \(there is bottom\)"):
        fr.World({"beam": fr.SoftBody(held), "ball": ball(0.015 + RADIUS)}, DT)


def test_soft_bodies_that_begin_in_one_another_are_refused(ended):
    crossing = fr.SoftBody(ended[0], position=(0.15, 0.15, 0.01), rotation=ACROSS)
    with pytest.raises(StepError, match=r"body '(beam|other)' is .* m inside body '(beam|other)'"):
        fr.World({"beam": fr.SoftBody(ended[0]), "other": crossing}, DT)
    above = fr.SoftBody(ended[0], position=(0.15, 0.15, 0.0201), rotation=ACROSS)
    fr.World({"beam": fr.SoftBody(ended[0]), "other": above}, DT)


def test_what_carries_a_body_may_hold_it_in_a_socket(carried):
    """The root is 20 mm deep in its palm, where it is left out; a wall that comes down beyond it is told."""
    palm = fr.RigidBody(Box((0.1, 0.1, 0.1)), motion=LIES)
    wall = fr.RigidBody(
        Box((0.02, 0.2, 0.02)), motion=lambda t: LIES._replace(position=np.array([0.25, 0, 0.1 - 4 * t]))
    )
    beam = fr.SoftBody(carried, position=(0.03, -0.015, -0.01), on="palm")
    world = fr.World({"palm": palm, "beam": beam, "wall": wall}, DT)
    assert not steps(world, 10)
    with pytest.warns(FenicsRomWarning, match="body 'wall' is .* inside body 'beam'"):
        (message,) = steps(world, 15)
    assert "palm" not in message


def test_a_soft_body_that_comes_through_another_is_told(ended):
    """A free beam falls across a held one: contact points are at neither's middle."""
    held, free = ended
    falls = fr.SoftBody(free, position=(0.2, 0.015, 0.0305), rotation=ACROSS, velocity=(0.0, 0.0, -0.5))
    world = fr.World({"held": fr.SoftBody(held), "falls": falls}, DT)
    with pytest.warns(FenicsRomWarning, match=r"body '(falls|held)' is .* inside body '(falls|held)'"):
        messages = steps(world, 30)
    assert len(messages) == 1


def test_a_soft_body_that_flies_through_another_is_told(ended):
    """In two steps, beside where either can be touched; compiled steps are looked at sixteen at once."""
    held, free = ended
    flies = fr.SoftBody(free, position=(0.2, 0.015, 0.31), rotation=ACROSS, velocity=(0.0, 0.0, -100.0))
    world = fr.World({"held": fr.SoftBody(held), "flies": flies}, DT)
    with pytest.warns(FenicsRomWarning):  # of strains, too
        (message,) = steps(world, 16)
    assert "body 'flies'" in message
    assert "body 'held'" in message
    assert world.pose("flies").position[2] < -0.1
