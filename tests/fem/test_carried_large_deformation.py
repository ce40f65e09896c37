"""A body that deforms largely and that a base carries, at full order: exact laws, limits, and the reduced body."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning, StepError
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


TOUCHING = "[effects.contact.obstacles.floor]\nshape = 'half-space'\npoint = [0, 0, -0.1]\nnormal = [0, 0, 1]\n"
TIED = "[effects.springs.bed]\nsurface = 'right'\nstiffness = 1.0\n"


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    return write_arrays(tmp_path_factory.mktemp("carried") / "beam.msh", *box_arrays((0.3, 0.03, 0.02), (4, 1, 1)))


def assembled(mesh, effects, head='frame = "moving"\n', **parts):
    contacts = '[contacts.tip]\nsurface = "right"\nforce = "resultant"'
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


def test_reduced_in_all_modes_and_points_is_full_order(mesh):
    """Two programs of the same equations: shapes, momenta, account and the wrench of the base, under all loads."""
    system = assembled(mesh, FORCES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FenicsRomWarning)
        rom = fr.reduce(system, order=system.size, method="modal+derivatives")
    assert len(rom.stiffness) == system.size
    whole = system.deformation
    names = ("weights", "first_lame", "shear", "viscosity")
    points = {name: getattr(whole, name) for name in names} | {"gradients": whole.gradients(rom.basis)}
    every = replace(rom.deformation, **points, points_of=len(whole.weights), trained=None)
    signals = {"base_path": shaken}
    full = FullOrderSimulator(system, 2e-3, system.scene.environment, signals)
    reduced = fr.Simulator(replace(rom, deformation=every), 2e-3, signals=signals, stepper="newton")
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


@pytest.mark.parametrize(
    ("effects", "told"),
    [(TOUCHING, "contact of a body that a base carries and that deforms largely"), (TIED, "springs and dashpots")],
)
def test_what_is_found_reduced_alone_is_told(mesh, effects, told):
    system = assembled(mesh, BARE + effects)
    with pytest.raises(StepError, match=told):
        FullOrderSimulator(system, 1e-3, system.scene.environment)
