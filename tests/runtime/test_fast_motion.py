"""Bodies that go by more than what they hit is thick in a step do not pass it, and their accounts close; it is told."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box_arrays, write_arrays
from forks import CLAMPED, LONG, cleft, fork_scene
from triangle_meshes import prism, write_stl

import fenics_rom as fr
from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.mechanics.contact import ContactLaw
from fenics_rom.mechanics.contact_pairs import NormalRule, target_slopes
from fenics_rom.mechanics.frame_motion import quaternion_of_vector
from fenics_rom.mechanics.obstacles import Mesh
from fenics_rom.scene.file import parse_scene

SIDE, THICK, SPEED, DT = 0.01, 1e-4, 50.0, 1e-2  # m, m, m/s, s: a step of 0.5 m, 5,000 thicknesses
GAP = 0.002  # m, below the cube and above it
CLOSES_TO = 1e-12  # of the largest energy seen
BODY = """
FRAME
[mesh]
file = "cube.msh"
[material]
young = 1e6
poisson = 0.3
density = 1000.0
[contacts.skin]
near = { point = [0, 0, 0], radius = 1.0 }
[effects]
inertia = {}
damping = { alpha = 0.0, beta = 1e-4 }
friction = { coefficient = 0.3 }
[run]
dt = 1e-2
duration = 5e-2
snapshots = 1
initial = { velocity = [0, 0, SPEED] }
[effects.contact.obstacles.plate]
"""
PLATES = {
    "box": f'shape = "box"\ncenter = [0.005, 0.005, MIDDLE]\nsize = [0.2, 0.2, {THICK}]\n',
    "mesh": 'shape = "mesh"\nfile = "plate.stl"\nposition = [0.005, 0.005, MIDDLE]\n',
    "rod": f'shape = "capsule"\nstart = [-0.1, 0, MIDDLE]\nend = [0.1, 0, MIDDLE]\nradius = {THICK / 2}\n',
}
SIDES = {"below": -GAP - THICK / 2, "above": SIDE + GAP + THICK / 2}  # m, middles of plates
WAYS = ["NumPy", pytest.param("compiled", marks=pytest.mark.skipif(not compiled(), reason="numba is not there"))]
TOLD = "points would have gone through an obstacle"
SPRINGS_TOLD = "springs of contact would have let points through"
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fast")
    write_arrays(folder / "cube.msh", *box_arrays((SIDE, SIDE, SIDE), (2, 2, 2)))
    profile = np.array([[-0.1, -THICK / 2], [0.1, -THICK / 2], [0.1, THICK / 2], [-0.1, THICK / 2]])
    write_stl(folder / "plate.stl", Mesh(*prism(profile, 0.2)))
    return folder


def scene_of(folder, plate, side, frame="", more=""):
    """A cube that is thrown at a plate."""
    text = BODY.replace("FRAME", frame).replace("SPEED", str(SPEED if side == "above" else -SPEED))
    return parse_scene(text + PLATES[plate].replace("MIDDLE", repr(SIDES[side])) + more, folder=folder)


@pytest.fixture(scope="module")
def roms(folder):
    """By plate and side."""
    return {
        (plate, side): fr.reduce(fr.assemble(scene_of(folder, plate, side)), order=8)
        for plate in PLATES
        for side in SIDES
    }


def before_plate(nodes, moved, side, plate):
    """How far nodes (N, 3) that moved by (N, 3), those that fly at the plate, are before it, m; negative behind it."""
    near = nodes[:, 1] == 0 if plate == "rod" else slice(None)
    return ((nodes + moved)[near, 2] - SIDES[side]) * (1 if side == "below" else -1) - THICK / 2


def thrown(rom, way, side):
    """A simulator of a cube on its way to the plate."""
    if way == "compiled":
        body = fr.Simulator(rom, DT)
    else:
        with numpy_alone():
            body = fr.Simulator(rom, DT)
    velocity = [0, 0, SPEED if side == "above" else -SPEED]
    body.set_shape(np.zeros(rom.nodes.shape), np.tile(velocity, (len(rom.nodes), 1)))
    return body


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("plate", PLATES)
@pytest.mark.parametrize("way", WAYS)
def test_a_cube_that_is_thrown_within_a_step_does_not_pass_what_is_thin(roms, way, plate, side):
    rom = roms[plate, side]
    body = thrown(rom, way, side)
    begun, gone = body.energy, body.ledger.dissipated
    for _ in range(5):
        body.step()
        assert before_plate(rom.nodes, body.displacement(), side, plate).min() > -1e-9 * SIDE
        lost = body.ledger.dissipated - gone
        assert abs(body.energy - begun + lost) < CLOSES_TO * begun
        assert lost > -CLOSES_TO * begun
    (told,) = (text for text in body.warnings if TOLD in text)
    assert told.startswith("in 1 steps")
    body.restore(body.save())
    assert told in body.warnings


@pytest.mark.parametrize("plate", PLATES)
@pytest.mark.parametrize("way", WAYS)
def test_springs_hold_a_cube_before_what_is_thin(roms, way, plate):
    """It had gone through by 26 mm; the rigid law takes a step where springs let it through, or stiff ones hold it."""
    for stiffness in (1e2, 1e6):
        acting = roms[plate, "below"].environment
        law = replace(acting.contact_law, stiffness=stiffness)
        rom = replace(roms[plate, "below"], environment=replace(acting, contact_law=law))
        body = thrown(rom, way, "below")
        begun = body.energy
        for _ in range(5):
            body.step()
            assert before_plate(rom.nodes, body.displacement(), "below", plate).min() > -THICK / 2
            assert abs(body.energy - begun + body.ledger.dissipated) < CLOSES_TO * begun
            assert body.energy < (1 + CLOSES_TO) * begun
        told = [text for text in body.warnings if SPRINGS_TOLD in text]
        assert len(told) == (stiffness < 1e6)


@pytest.fixture(scope="module")
def fork(tmp_path_factory):
    """Its cells and two prongs."""
    mesh = cleft((6, 1, 3), 1)
    return mesh[1], fr.reduce(fr.assemble(fork_scene(tmp_path_factory.mktemp("fork"), mesh, **CLAMPED)), order=12)


@pytest.mark.parametrize(("speed", "law"), [(5.0, "rigid"), (20.0, "rigid"), (20.0, "springs")])
@pytest.mark.parametrize("way", WAYS)
def test_prongs_of_a_body_that_are_flung_at_one_another_do_not_pass(fork, way, speed, law):
    """By up to 400 mm in a step, where they are 2 mm apart and 10 mm thick; also when they swing back, and turn far."""
    cells, rom = fork
    if law == "springs":
        acting = rom.environment
        rom = replace(rom, environment=replace(acting, contact_law=replace(acting.contact_law, stiffness=1e3)))
    if way == "compiled":
        body = fr.Simulator(rom, DT)
    else:
        with numpy_alone():
            body = fr.Simulator(rom, DT)
    x = rom.nodes
    body.set_shape(np.zeros_like(x), -speed * x[:, :1] / LONG * np.sign(x) * [0.0, 0.0, 1.0])
    begun, prong = body.energy, np.sign(x[:, 2]) * (x[:, 0] > LONG / 6 + 1e-9)
    for _ in range(12):
        body.step()
        assert deepest_inside(x + body.displacement(), cells, prong) < (1e-3 if law == "rigid" else 2.5e-3)
        assert abs(body.energy - begun + body.ledger.dissipated) < CLOSES_TO * begun
        assert body.energy < (1 + CLOSES_TO) * begun
    assert sum((TOLD if law == "rigid" else SPRINGS_TOLD) in text for text in body.warnings) == 1


def deepest_inside(places, cells, part):
    """How deep nodes at places (N, 3), m, of one of two parts, 1 and -1 of (N,), are in the cells of the other one."""
    deepest = 0.0
    for own in (-1, 1):
        others = places[cells[(part[cells] == -own).any(axis=1) & (part[cells] != own).all(axis=1)]]
        edges = np.swapaxes(others[:, 1:] - others[:, :1], 1, 2)
        weights = np.linalg.solve(edges[None], (places[part == own][:, None] - others[:, 0])[..., None])[..., 0]
        least = np.minimum(weights.min(axis=2), 1 - weights.sum(axis=2))
        heights = np.abs(np.linalg.det(edges)) / np.linalg.norm(edges, axis=1).max(axis=1) ** 2
        deepest = max(deepest, float((least * heights).max()))
    return deepest


def test_full_order_does_as_the_body_reduced_in_all_modes(folder):
    scene = scene_of(folder, "box", "below")
    system = fr.assemble(scene)
    runs = [fr.simulate(of) for of in (system, fr.reduce(system, order=system.elastic_size, method="modal"))]
    for run in runs:
        assert sum(TOLD in text for text in run.warnings) == 1
        assert min(before_plate(run.nodes, moved, "below", "box").min() for moved in run.snapshots) > -1e-9 * SIDE
    full, reduced = (run.snapshots for run in runs)
    np.testing.assert_allclose(reduced, full, atol=1e-7 * np.abs(full).max())


def test_rollouts_and_batches_take_the_steps_of_a_simulator(roms):
    rom, steps = roms["box", "below"], 5
    for way in ("NumPy", "compiled") if compiled() else ("NumPy",):
        one = thrown(rom, way, "below")
        u = np.zeros((steps, one.inputs))
        many = thrown(rom, way, "below")
        many.rollout(u)
        batch = fr.Batch(rom, 3, DT) if way == "compiled" else None
        if batch is None:
            with numpy_alone():
                batch = fr.Batch(rom, 3, DT)
        batch.set_state(*one.state)
        batch.reset([2])
        for row in u:
            one.step(row)
            batch.step(np.tile(row, (3, 1)))
        np.testing.assert_array_equal(many.displacement(), one.displacement())
        q, _ = one.state
        np.testing.assert_allclose(batch.state()[0][:2], [q, q], atol=1e-7 * np.abs(q).max())
        assert batch.held_back.tolist() == [1, 1, 0]
        assert any(TOLD in text for text in many.warnings)


def swung(time):
    """A blade turns by 2 rad about its middle in 0.1 s, from rest."""
    angle, rate = 1 - np.cos(np.pi * time / 0.1), np.pi / 0.1 * np.sin(np.pi * time / 0.1)
    turned = quaternion_of_vector(np.array([0.0, angle, 0.0]))
    return fr.BaseState(np.zeros(3), turned, np.zeros(3), np.array([0.0, rate, 0.0]))


@pytest.mark.parametrize("plate", ["box", "mesh"])
def test_a_thin_blade_that_turns_takes_along_what_it_hits(folder, plate):
    """At 0.1 m from its axis it goes by up to 31 mm in a step, 310 thicknesses."""
    blade = BODY.replace("FRAME", 'frame = "moving"').replace("SPEED", "0")
    where = f"[0.0, 0.005, {-GAP - THICK / 2}]"
    shape = PLATES[plate].replace("[0.005, 0.005, MIDDLE]", where) + "motion = {}\n"
    rom = fr.reduce(fr.assemble(parse_scene(blade + shape, folder=folder)), order=6)
    for x in (-0.06, 0.05):
        body = fr.Simulator(rom, DT, signals={"plate": swung})
        body.place(fr.BaseState(np.array([x, 0.0, SIDE / 2]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)))
        touched = 0
        for step in range(1, 11):
            body.step()
            touched += body.integrator.contact is not None
            angle = 1 - np.cos(np.pi * step * DT / 0.1)
            R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
            local = (rom.nodes + body.displacement()) @ R
            on_it = np.abs(local[:, 0]) < 0.1
            assert (local[on_it, 2] + GAP > -1e-9 * SIDE).all()
        assert touched or x > 0  # on this side it goes away


def test_only_what_would_go_through_is_held():
    """Of random pairs at two obstacles, a thin one and a thick one."""
    rng = np.random.default_rng(0)
    for restitution in (0.0, 0.4):  # with 1 nothing goes in
        law, thin, dt, each = ContactLaw(restitution), THICK / 2, DT, 500
        gaps = rng.exponential(THICK, 2 * each) * rng.choice([1, 1, 1, -0.1], 2 * each)
        approach, outwards = rng.normal(size=(2, 2 * each)) * 3 * THICK / dt
        plain = NormalRule(law, 2 * each, dt, False, [np.inf, np.inf])
        rule = NormalRule(law, 2 * each, dt, False, [thin, np.inf])
        level, free, _ = plain.asks(gaps, gaps.min(), None, approach, outwards)
        held_level, target, _ = rule.asks(gaps, gaps.min(), None, approach, outwards)
        goes = (np.arange(2 * each) < each) & (-(gaps + dt * free) > thin)
        assert 20 < goes.sum() < 400
        np.testing.assert_array_equal(held_level, level)
        np.testing.assert_array_equal(target[~goes], free[~goes])
        np.testing.assert_array_equal(target[goes], np.minimum(gaps[goes] * (-1 / dt), 0.0))
        np.testing.assert_array_equal(rule.too_far > 1, goes)
        by_gap, by_approach = target_slopes(law, gaps[goes], target[goes], approach[goes], dt)
        np.testing.assert_array_equal(by_gap, np.where(target[goes] < 0, -1 / dt, 0.0))
        np.testing.assert_array_equal(by_approach, 0.0)
        rule.asks(np.abs(gaps), 0.0, None, 1e-2 * approach, outwards)
        assert rule.too_far is None
