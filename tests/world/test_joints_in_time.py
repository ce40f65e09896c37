"""Joints that are made and let go while a world runs: momenta, and where energy goes."""

import numpy as np
import pytest
from test_rigid_motion import LIES, G
from test_soft_motion import BOX, CLAMPED, TOUCHED, momenta, reduced

import fenics_rom as fr
from fenics_rom.world.joints import SurfaceJoint, ball, hinge, weld
from fenics_rom.world.shapes import Box

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")


def box(position, **given):
    return fr.RigidBody(Box((0.1, 0.1, 0.2)), density=500, position=position, **given)


def closes(world, start):
    account = world.ledger
    return abs(world.energy - start - account.supplied + account.dissipated + account.numerical)


def test_what_is_welded_in_flight_goes_on_as_one_body():
    """Momenta stay, to the last bits; what kinetic energy two that move alike have less is booked as dissipated."""
    boxes = {
        "left": box((0, 0, 0), velocity=(0.5, 0.2, 0)),
        "right": box((0.2, 0, 0), velocity=(-0.3, 0, 0.1), angular_velocity=(0, 0, 1.0)),
    }
    world = fr.World(boxes, 5e-3)
    for _ in range(3):
        world.step()
    (P, L), energy = momenta(world), world.energy
    name = world.join(weld("left", "right", (0.1, 0, 0), name="grip"))
    assert name == "grip"
    assert world.joints == ("grip",)
    for now, then in zip(momenta(world), (P, L), strict=True):
        np.testing.assert_allclose(now, then, rtol=0, atol=1e-14)
    lost = energy - world.energy
    assert lost > 0.1
    assert world.ledger.dissipated == pytest.approx(lost, rel=1e-12)
    (left, of_left), (right, of_right) = (world.velocity(each) for each in boxes)
    np.testing.assert_allclose(of_left, of_right, atol=1e-12)
    arm = world.pose("right").position - world.pose("left").position
    np.testing.assert_allclose(right, left + np.cross(of_left, arm), atol=1e-12)
    for _ in range(20):
        world.step()
    apart = world.pose("right").position - world.pose("left").position
    assert np.linalg.norm(apart) == pytest.approx(np.linalg.norm(arm), rel=1e-12)
    assert closes(world, energy) < 1e-13
    np.testing.assert_allclose(momenta(world)[1], L, atol=1e-13)


def test_a_box_that_is_let_go_falls_and_nothing_is_lost():
    world = fr.World({"box": box((0, 0, 1))}, 1e-2, gravity=(0, 0, -G), joints=[weld("box", "world", (0, 0, 1))])
    for _ in range(5):
        world.step()
    assert world.energy < 1e-25
    assert world.joint_forces("joint0").sum(axis=0)[2] == pytest.approx(G, rel=1e-9)
    before = world.ledger.dissipated
    world.release("joint0")
    assert world.ledger.dissipated == before
    for _ in range(10):
        world.step()
    assert world.pose("box").velocity[2] == pytest.approx(-G * 0.1, rel=1e-12)
    assert world.pose("box").position[2] == pytest.approx(1 - G * 0.1**2 / 2, rel=1e-12)
    assert world.joint_forces(0).shape == (0, 3)
    assert world.anew().joints == ("joint0",)


def test_joints_hold_between_their_times_alone():
    """Held at first, let go at 50 ms, caught again at 0.1 s by a hinge through where the box is then."""
    plan = [
        weld("box", "world", (0, 0, 1), name="hold", stop=0.05),
        hinge("box", "world", (0, 0, 0.9), (0, 0.1, 0), name="catch", start=0.1),
    ]
    world, held = fr.World({"box": box((0, 0, 1))}, 1e-2, gravity=(0, 0, -G), joints=plan), []
    for _ in range(15):
        world.step()
        held.append(world.joints)
    assert held == [("hold",)] * 5 + [()] * 5 + [("catch",)] * 5
    fell = G * 0.05**2 / 2
    assert world.pose("box").position[2] == pytest.approx(1 - fell, rel=1e-12)  # the hinge stopped it there
    mass = world.bodies["box"].mass_and_inertia()[0]
    assert world.ledger.dissipated == pytest.approx(mass * (G * 0.05) ** 2 / 2, rel=1e-9)
    assert closes(world, 0.0) < 1e-14
    assert world.anew().joints == ("hold",)


def test_what_was_joined_touches_again_when_it_is_apart():
    """Welded 1 mm inside a shelf: let go it has no contact until it has been lifted out, and then lies on it."""
    shelf = fr.RigidBody(Box((1, 1, 0.1)), position=(0, 0, -0.05))
    world = fr.World(
        {"shelf": shelf, "box": box((0, 0, 0.099))},
        2e-3,
        gravity=(0, 0, -G),
        joints=[weld("box", "shelf", (0, 0, 0), name="hold")],
    )
    world.step()
    world.release("hold")
    assert "were 0.001 m inside one another" in world.warnings[0]
    world.step({"box": {"force": (0, 0, 60.0)}})
    assert not world.touching
    for _ in range(20):
        world.step({"box": {"force": (0, 0, 20.0)}})
    assert world.pose("box").position[2] > 0.1
    for _ in range(400):
        world.step()
    assert world.pose("box").position[2] == pytest.approx(0.1, abs=1e-9)
    assert world.touching == 4


@pytest.fixture(scope="module")
def roms(tmp_path_factory):
    kinds = {"held": {"frame": "fixed", **CLAMPED}, "free": {"frame": "moving"}}
    return {kind: reduced(tmp_path_factory.mktemp(kind), **parts, **TOUCHED) for kind, parts in kinds.items()}


def test_a_box_is_caught_by_a_beam_and_let_go(roms):
    """The end of the beam gets the box's motion by an impulse; let go, the beam springs back, and the box flies on."""
    place = (0.33, 0.015, 0.01)
    bodies = {"beam": fr.SoftBody(roms["held"]), "box": fr.RigidBody(**BOX, position=place, velocity=(0, 0, -0.3))}
    world = fr.World(bodies, 1e-3, apart=[("beam", "box")])
    start = world.energy
    world.join(SurfaceJoint("beam", "box", "right", name="grip"))
    assert 0 < world.ledger.dissipated < start
    assert closes(world, start) < 1e-15
    for _ in range(20):
        world.step()
    assert world.energy_of("beam") > 1e-5
    box_energy, energy, dissipated = world.energy_of("box"), world.energy, world.ledger.dissipated
    world.release("grip")
    assert (world.energy, world.ledger.dissipated) == (energy, dissipated)
    for _ in range(20):
        world.step()
    assert world.energy_of("box") == pytest.approx(box_energy, rel=1e-12)
    assert closes(world, start) < 1e-14
    assert not world.warnings


def momentum(world):
    """Of the beam, linear and angular about the origin."""
    P, L = world.simulator("beam").momentum
    return P, L + np.cross(world.pose("beam").position, P)


def test_a_free_beam_is_held_by_its_face_and_let_go(roms):
    """By a hand that lifts it; momenta stay when it is let go. That it moves when the world holds it is told."""
    lift = np.array([0, 0, 2.0])  # m/s²

    def lifted(t):
        return LIES._replace(position=lift * t**2 / 2, velocity=lift * t)

    bodies = {"beam": fr.SoftBody(roms["free"]), "hand": fr.RigidBody(Box((0.01,) * 3), motion=lifted)}
    world = fr.World(bodies, 1e-3, joints=[SurfaceJoint("beam", "hand", "right", name="hold")])
    for _ in range(20):
        world.step()
    assert closes(world, 0.0) < 1e-15
    (P, L), energy, dissipated = momentum(world), world.energy, world.ledger.dissipated
    assert P[2] > 1e-3
    world.release("hold")
    assert (world.energy, world.ledger.dissipated) == (energy, dissipated)
    for _ in range(20):
        world.step()
    for now, then in zip(momentum(world), (P, L), strict=True):
        np.testing.assert_allclose(now, then, rtol=0, atol=1e-14)
    assert closes(world, 0.0) < 1e-15
    assert world.energy <= energy
    assert not world.warnings
    world.join(SurfaceJoint("beam", "world", "right"))
    assert any("takes no impulse: it swings" in said for said in world.warnings)
    with pytest.raises(fr.StepError, match=r"no joint 'clamped'.*Supports of a scene are part of its model"):
        world.release("clamped")


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda world: world.release("grip"), "no joint 'grip'; there is hold, later; did you mean|no joint 'grip'"),
        (lambda world: world.release("later"), "joint 'later' does not hold now; those that do: hold"),
        (lambda world: world.release(2), "joint 2: use a number below 2, or a name: hold, later"),
        (lambda world: world.join(ball("box", "world", (0, 0, 1), name="hold")), "joint 'hold': there are two"),
        (lambda world: world.join(ball("box", "world", (0, 0, 1), start=1.0)), "start = 1 s: use a joint without"),
        (lambda world: world.join(ball("box", "bax", (0, 0, 1))), "no body 'bax'"),
        (lambda world: ball("box", "world", (0, 0, 1), start=1.0, stop=0.5), "stop = 0.5: use a time after"),
        (lambda world: ball("box", "world", (0, 0, 1), start=-1.0), "start = -1.0: use a time from 0 on"),
    ],
)
def test_what_cannot_be_joined_or_let_go_is_told(ask, said):
    plan = [weld("box", "world", (0, 0, 1), name="hold"), ball("box", "world", (0, 0, 1), name="later", start=1.0)]
    world = fr.World({"box": box((0, 0, 1))}, 1e-2, joints=plan)
    with pytest.raises((fr.StepError, fr.SceneError), match=said):
        ask(world)
    assert world.joints == ("hold",)
    assert world.anew().joints == ("hold",)


def test_a_soft_body_by_itself_has_no_joints(roms):
    world = fr.World({"beam": fr.SoftBody(roms["free"])}, 1e-3)
    with pytest.raises(fr.StepError, match="a soft body by itself has no joints"):
        world.join(SurfaceJoint("beam", "world", "right"))
