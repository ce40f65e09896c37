"""A body that deforms largely and that a base carries, at full order: exact laws, limits, and the reduced body."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from all_points import all_points
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.scene.file import parse_scene

FORCES = """inertia = {}
[effects.large_deformation]
[effects.gravity]
acceleration = [0.0, 0.0, -9.81]
[effects.prescribed.push]
point = [0.3, 0.03, 0.02]
force = [1e-3, 2e-3, 0.0]
[effects.prescribed.beside]
point = [0.02, 0.01, 0.01]  # where the base bears most of it
force = [3e-3, 1e-3, 2e-3]
[effects.tendon.rope]
points = [[0.01, 0.015, 0.015], [0.15, 0.015, 0.015], [0.29, 0.015, 0.015]]
[effects.pressure.air]
surface = "top"
[effects.base_motion.shake]
direction = [1, 2, 0]
acceleration = 3.0
[effects.damping]
alpha = 1.0
beta = 1e-3
"""
BARE = "inertia = {}\n[effects.large_deformation]\n[effects.gravity]\nacceleration = [0.0, 0.0, -9.81]\n"


ROPE = "[effects.tendon.rope]\npoints = [[0.0, 0.015, 0.0], [0.15, 0.015, 0.002], [0.3, 0.015, 0.0]]\n"
TOUCHING = """[effects.friction]
coefficient = 0.4
[effects.contact.obstacles.floor]
shape = "half-space"
point = [0, 0, -0.002]
normal = [0, 0, 1]
"""
OIL = '[effects.damping.dashpots.oil]\nsurface = "right"\ncoefficient = 0.05\n'
TIED = '[effects.springs.bed]\nsurface = "top"\nstiffness = 8.0\n' + OIL


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("carried") / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))


def assembled(mesh, effects, head='frame = "moving"\n', **parts):
    contacts = '[contacts.tip]\nsurface = "right"\nforce = "resultant"'
    if "floor" in effects:
        contacts = '[contacts.sole]\nsurface = "bottom"'
    run = "dt = 2e-3\nduration = 0.04\n" + (
        '[[run.load]]\nactuator = "rope"\nforce = [0.1]' if "rope" in effects else ""
    )
    parts = {"material": "young = 5e5\npoisson = 0.4\ndensity = 1100.0", "run": run, "contacts": contacts} | parts
    return fr.assemble(parse_scene(head + scene_text(mesh, effects=effects, **parts)))


def shaken(time):
    """A base on some path; its twists are not quite those of its poses, which no law minds."""
    angle, rate = 0.5 * np.sin(3 * time), 1.5 * np.cos(3 * time)
    rotation = np.array([np.cos(angle), 0.6 * np.sin(angle), 0.0, 0.8 * np.sin(angle)])
    position, velocity = [0.1 * np.sin(4 * time), 0.05 * time**2, 0.0], [0.4 * np.cos(4 * time), 0.1 * time, 0.0]
    return fr.BaseState(np.array(position), rotation, np.array(velocity), 2 * rate * np.array([0.6, 0.0, 0.8]))


def pushed(step):
    """Inputs that bend it by a fiftieth of its length, in turns."""
    return np.array([0.01, 0.02, 0.05 * np.sin(0.3 * step), 20 * np.cos(step), 0.5])


def test_account_closes_at_any_step_and_a_step_is_taken_back(mesh):
    system = assembled(mesh, FORCES)
    body = FullOrderSimulator(system, 2e-3, system.scene.environment, {"base_path": shaken})
    start, turnover = body.energy, 0.0
    for step in range(16):
        body.stepper.set_time_step((1e-3, 5e-3)[step // 8])
        body.step(pushed(step))
        turnover = max(turnover, abs(body.energy), abs(body.ledger.supplied))
    assert body.ledger.dissipated > 1e-4
    assert abs(body.energy - start - body.ledger.supplied + body.ledger.dissipated) <= 1e-11 * turnover
    kept = body.displacement(), body.energy, body.base_wrench, body.pose.position
    body.step(pushed(0))
    body.stepper.rollback()
    now = body.displacement(), body.energy, body.base_wrench, body.pose.position
    for ours, others in zip(now, kept, strict=True):
        np.testing.assert_array_equal(ours, others)


def every_point(system):
    """A ROM of all modes, and of all points."""
    with warnings.catch_warnings(action="ignore", category=FenicsRomWarning), all_points():
        rom = fr.reduce(system, order=system.size, method="modal+derivatives")
    assert len(rom.stiffness) == system.size
    assert len(rom.deformation.weights) == rom.deformation.points_of
    return replace(rom, deformation=replace(rom.deformation, trained=None))


def test_reduced_in_all_modes_and_points_is_full_order(mesh):
    """Two programs of the same equations: shapes, momenta, account and the wrench of the base, under all loads."""
    system = assembled(mesh, FORCES)
    signals = {"base_path": shaken}
    full = FullOrderSimulator(system, 2e-3, system.scene.environment, signals)
    reduced = fr.Simulator(every_point(system), 2e-3, signals=signals, stepper="newton")
    for step in range(12):
        for body in (full, reduced):
            body.step(pushed(step))
    assert np.abs(full.stepper.shape).max() > 2e-3
    np.testing.assert_allclose(reduced.displacement(), full.displacement(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(reduced.velocity(), full.velocity(), rtol=0, atol=1e-10)
    for ours, others in zip(reduced.momentum, full.momentum, strict=True):
        np.testing.assert_allclose(ours, others, rtol=0, atol=1e-12)
    assert reduced.energy == pytest.approx(full.energy, rel=1e-11)
    assert reduced.ledger.supplied == pytest.approx(full.ledger.supplied, rel=1e-10)
    # the reduced body takes the pressure's resultant where it expects the shape to be
    np.testing.assert_allclose(reduced.base_wrench, full.base_wrench, rtol=0, atol=1e-4)


def test_base_that_speeds_up_is_one_that_stands_in_another_gravity(mesh):
    """And one that stands still holds the body: in the frame all three take the same steps, to Newton's tolerance."""
    a, still = np.array([2.0, 0.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0])
    carried, held = assembled(mesh, BARE), assembled(mesh, BARE, head="")
    speeds = carried.scene.environment
    there = FullOrderSimulator(
        carried, 5e-3, speeds, {"base_path": lambda t: fr.BaseState(a * t**2 / 2, still, a * t, np.zeros(3))}
    )
    stands = FullOrderSimulator(carried, 5e-3, speeds)
    lies = FullOrderSimulator(held, 5e-3, held.scene.environment)
    heavy = BARE.replace("[0.0, 0.0, -9.81]", "[-2.0, 0.0, -12.81]")
    other = assembled(mesh, heavy, head="")
    heavier = FullOrderSimulator(other, 5e-3, other.scene.environment)
    for _ in range(10):
        for body in (there, stands, lies, heavier):
            body.step(np.zeros(3))
    for ours, others in ((stands, lies), (there, heavier)):
        scale = np.abs(others.stepper.shape).max()
        np.testing.assert_allclose(ours.stepper.shape, others.stepper.shape, rtol=0, atol=1e-9 * scale)
    assert np.abs(there.stepper.shape - stands.stepper.shape).max() > 1e-6


def test_without_inertia_weight_turns_in_the_base(mesh):
    """A base that turns by a quarter: the body hangs as one that is held in a gravity that is turned back."""
    still = BARE.replace("inertia = {}\n", "")
    half = np.sqrt(0.5)
    pose = fr.BaseState(np.ones(3), np.array([half, half, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    system = assembled(mesh, still, damping=None)
    body = FullOrderSimulator(system, 0.1, system.scene.environment, {"base_path": lambda t: pose})
    held = assembled(mesh, still.replace("[0.0, 0.0, -9.81]", "[0.0, -9.81, 0.0]"), head="", damping=None)
    other = FullOrderSimulator(held, 0.1, held.scene.environment)
    body.step(np.zeros(3))
    other.step(np.zeros(3))
    scale = np.abs(other.stepper.shape).max()
    np.testing.assert_allclose(body.stepper.shape, other.stepper.shape, rtol=0, atol=1e-9 * scale)
    weight = 9.81 * system.moving_frame.moments[0, 0]
    np.testing.assert_allclose(body.base_wrench[0], [0.0, 0.0, weight], atol=1e-9 * weight)


def swung(time):
    """A base that swings about an oblique axis, and moves sideways."""
    angle, rate, axis = 0.12 * np.sin(12 * time), 1.44 * np.cos(12 * time), np.array([0.0, 0.8, 0.6])
    rotation = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])
    return fr.BaseState(np.array([0.0, 0.02 * time, 0.0]), rotation, np.array([0.0, 0.02, 0.0]), rate * axis)


def stepped(bodies, steps, amplitude):
    """How far apart displacements are at most, how often the first one touches, and what its account misses."""
    first, apart, touched = bodies[0], 0.0, 0
    start, turnover = first.energy, 0.0
    for step in range(steps):
        u = amplitude * np.sin(0.4 * step) ** 2 * np.ones(len(first.system.actuators))
        u = np.concatenate([np.zeros(3 * ("floor" not in first.environment.obstacles)), u])
        for body in bodies:
            body.step(u)
        touched += bool(first.obstacle_forces().any())
        turnover = max(turnover, abs(first.energy), abs(first.ledger.supplied))
        apart = max(np.abs(body.displacement() - first.displacement()).max() for body in bodies)
    account = first.ledger
    gone = account.dissipated + account.numerical
    return apart, touched, abs(first.energy - start - account.supplied + gone) / turnover


@pytest.mark.parametrize("inertia", [True, False])
@pytest.mark.parametrize("effects", [TOUCHING, TIED, TOUCHING + TIED])
def test_what_touches_and_ties_a_body_closes_its_account(mesh, effects, inertia):
    """On a base that moves; and on one that stands shapes are those of a body that is held."""
    effects = BARE + ROPE + effects
    if not inertia:
        effects = effects.replace("inertia = {}\n", "").replace(OIL, "")
    carried = assembled(mesh, effects, damping=None)
    acting = carried.scene.environment
    body = FullOrderSimulator(carried, 2e-3, acting, {"base_path": swung})
    _, touched, missed = stepped([body], 25, 0.5)
    assert (touched > 5) == ("floor" in effects)
    assert missed <= 1e-11
    held = assembled(mesh, effects, head="", damping=None)
    bodies = FullOrderSimulator(carried, 2e-3, acting), FullOrderSimulator(held, 2e-3, held.scene.environment)
    apart, touched, missed = stepped(bodies, 25, 0.5)
    assert (touched > 5) == ("floor" in effects)
    assert missed <= 1e-11
    assert apart <= 1e-8 * np.abs(bodies[0].stepper.shape).max()


@pytest.mark.parametrize("inertia", [True, False])
@pytest.mark.parametrize("effects", [TOUCHING, TIED, TOUCHING + TIED])
def test_reduced_in_all_modes_touches_and_is_tied_as_full_order(mesh, effects, inertia):
    """Two programs of the same laws, on a base that moves: shapes, and what bears the body."""
    effects = BARE + ROPE + (effects if inertia else effects.replace(OIL, ""))
    rom = every_point(assembled(mesh, effects, damping=None))
    system = assembled(mesh, effects if inertia else effects.replace("inertia = {}\n", ""), damping=None)
    full = FullOrderSimulator(system, 2e-3, system.scene.environment, {"base_path": swung})
    stepper = "newton" if inertia else None
    reduced = fr.Simulator(rom, 2e-3, scene=system.scene, signals={"base_path": swung}, stepper=stepper)
    apart, touched, _ = stepped([full, reduced], 25, 0.5)
    assert (touched > 5) == ("floor" in effects)
    assert apart <= 1e-8 * np.abs(full.stepper.shape).max()
    assert reduced.energy == pytest.approx(full.energy, rel=1e-9)
    size = np.abs(full.base_wrench).max()
    np.testing.assert_allclose(reduced.base_wrench, full.base_wrench, rtol=0, atol=1e-5 * size)
