"""Errors among obstacles: no bound, and an estimate under the contact forces that the reduced body found."""

import copy

import numpy as np
import pytest
from bodies import acted_on

import fenics_rom as fr
from fenics_rom.errors import StepError
from fenics_rom.fem.simulator import FullOrderSimulator
from fenics_rom.world.shapes import Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
H, STEPS = 1e-3, 150
EFFECTS = """
inertia = {{}}
damping = {{ alpha = 2.0, beta = 1e-3 }}
{others}
[effects.contact]
switching = "scene"
{law}
[effects.contact.obstacles.{obstacle}
"""
FLOOR = 'floor]\nshape = "half-space"\npoint = [0, 0, -1e-3]\nnormal = [0, 0, 1]'
BALL = 'ball]\nshape = "sphere"\ncenter = [1.2, 0.2, 0.15]\nradius = 0.1997'
SCENES = {
    "no friction": (FLOOR, "", ""),
    "friction": (FLOOR, "friction = { coefficient = 0.4 }", ""),
    "a ball that bounces": (BALL, "friction = { coefficient = 0.2 }", "restitution = 0.5"),
    "springs": (FLOOR, "", 'method = "penalty"\nstiffness = 1e4'),
}


def scene_of(kind, box_file):
    """A box beside one obstacle."""
    obstacle, others, law = SCENES[kind]
    text = EFFECTS.format(obstacle=obstacle, others=others, law=law)
    return acted_on(box_file, text, **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})


def pushes(seed=0):
    """Of each step, N: against the floor and the ball, and noise."""
    random, t = np.random.default_rng(seed), H * np.arange(STEPS)[:, None]
    return np.sin(40 * t) * np.array([100.0, 20.0, -200.0]) + 5.0 * random.standard_normal((STEPS, 3))


@pytest.fixture(scope="module", params=SCENES)
def case(request, box_file):
    system = fr.assemble(scene_of(request.param, box_file))
    return system, {order: fr.reduce(system, order=order, method="modal+static", errors=True) for order in (6, 12, 25)}


def norm(system, x, v):
    return float(np.sqrt(np.vdot(x, system.stiffness @ x) + np.vdot(v, system.mass @ v)))


def largest_errors(system, rom):
    """True, and as it is told, in a run in which obstacles touch the body; J^1/2."""
    body = fr.Simulator(rom, H)
    full = FullOrderSimulator(system, H, system.scene.environment)
    true, told, touched = [], [], 0
    for u in pushes():
        body.step(u)
        full.step(u)
        touched += body.contact_forces().any()
        C, (_, r) = body.model.coordinates, body.state
        x, v = rom.basis @ body.shape_coordinates, rom.basis @ (C @ r)
        true.append(norm(system, full.stepper.x - x[:, None], full.stepper.v - v[:, None]))
        told.append(body.error_estimate.norm)
    assert touched > 10
    return max(true), max(told)


def test_estimates_are_near_and_rank_orders(case):
    system, roms = case
    found = {order: largest_errors(system, rom) for order, rom in roms.items()}
    for true, told in found.values():
        assert 1 / 1.5 < told / true < 1.5, found  # as of bodies that nothing touches
    true, told = np.array(list(found.values())).T
    assert (np.argsort(true) == np.argsort(told)).all()


def test_ways_to_step_agree(case):
    rom, u = case[1][6], pushes()
    one, rolled, bodies = fr.Simulator(rom, H), fr.Simulator(rom, H), fr.Batch(rom, 2, H)
    for row in u[:60]:
        one.step(row)
        bodies.step(row)
    rolled.rollout(u[:60])
    told = one.error_estimate
    assert told.norm == rolled.error_estimate.norm > 0
    assert bodies.error_estimate.norm.tolist() == [told.norm] * 2
    twin, saved = copy.copy(one), one.save()
    for body in (one, twin):
        body.rollout(u[60:90])
    one.restore(saved)
    one.rollout(u[60:90])
    assert one.error_estimate.output("tip").tolist() == twin.error_estimate.output("tip").tolist()


def test_a_step_that_a_batch_takes_back_is_not_counted(case):
    rom, u = case[1][6], pushes()
    bodies, alone = fr.Batch(rom, 2, H), fr.Simulator(rom, H)
    for row in u[:5]:
        bodies.step(row)
        alone.step(row)
    bad = np.stack([u[5], np.full(3, 1e70)])
    with pytest.raises(StepError):
        bodies.step(1e10 * bad)
    assert bodies.error_estimate.norm.tolist() == [alone.error_estimate.norm] * 2


def test_there_is_no_bound_and_it_is_said_why(case):
    rom = case[1][6]
    body = fr.Simulator(rom, H)
    with pytest.raises(StepError, match="contact forces of the full order are others"):
        body.error_bound  # noqa: B018
    assert list(body.stated_errors) == ["estimate"]
    assert "under the same contact forces" in body.error_estimate.why


def test_an_estimate_needs_no_damping(box_file, tmp_path):
    text = EFFECTS.format(obstacle=FLOOR, others="", law="").replace("damping", "# damping")
    system = fr.assemble(acted_on(box_file, text, **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"}))
    rom = fr.reduce(system, order=25, method="modal+static", errors=True)
    true, told = largest_errors(system, rom)
    assert 1 / 1.5 < told / true < 1.5, (true, told)
    fr.write_rom(tmp_path / "rom.h5", rom)
    again = fr.read_rom(tmp_path / "rom.h5")
    assert not again.error_model.has_bound
    assert list(fr.Simulator(again, H).stated_errors) == ["estimate"]
    alone = acted_on(box_file, "inertia = {}", **{"outputs.tip": "points = [[1.0, 0.4, 0.3]]"})
    with pytest.raises(StepError, match="a run with no damping does not know its error"):
        fr.Simulator(rom, H, scene=alone).error_bound  # noqa: B018


def test_a_body_among_others_of_a_world_has_none(box_file):
    """A world hands it forces that it does not note; alone it steps as a simulator does."""
    rom, u = fr.reduce(fr.assemble(scene_of("no friction", box_file)), order=6, errors=True), np.array([0, 0, -50.0])
    ball = fr.RigidBody(Sphere(0.1), density=500.0, position=(0.5, 0.2, 0.5), velocity=(0.0, 0.0, -1.0))
    among, alone = fr.World({"box": fr.SoftBody(rom), "ball": ball}, H), fr.World({"box": fr.SoftBody(rom)}, H)
    body, own = fr.Simulator(rom, H), alone.simulator("box")
    for _ in range(20):
        alone.step({"box": u})
        body.step(u)
    assert own.error_estimate.norm == body.error_estimate.norm > 0
    other = among.simulator("box")
    assert not other.stated_errors
    for kind in ("error_bound", "error_estimate"):
        with pytest.raises(StepError, match="a body of a world with others does not know its error"):
            getattr(other, kind)


def test_files_keep_forces_on_points(case, tmp_path):
    rom = case[1][6]
    fr.write_rom(tmp_path / "rom.h5", rom)
    again = fr.read_rom(tmp_path / "rom.h5")
    assert (again.error_model.point_inputs == rom.error_model.point_inputs).all()
    assert again == rom
