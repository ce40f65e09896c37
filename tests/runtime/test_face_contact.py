"""Obstacles smaller than the mesh are kept out between its nodes: no depth at rest, accounts to round-off."""

import copy
import warnings
from dataclasses import replace

import numpy as np
import pytest
from pads import RUBS, UP, L, R, depth_of, pad, pad_scene, shape

import fenics_rom as fr
from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.body_faces import BodyFaces
from fenics_rom.mechanics.environment import STANDS_STILL, MovingObstacle
from fenics_rom.mechanics.obstacles import Box, Capsule, Mesh, Sphere

pytestmark = pytest.mark.filterwarnings("ignore::fenics_rom.errors.FenicsRomWarning")
X, Y = 1.3 * L, 1.55 * L  # between nodes
OUT = 1e-9 * R
LARGE = {"effects.large_deformation": 'material = "st_venant_kirchhoff"', "run": "dt = 1e-3\nduration = 0.01"}
READ = {"outputs.top": 'surface = "top"'}


def rom_of(folder, obstacle, *given, order=10, **parts):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fr.reduce(fr.assemble(pad_scene(folder, obstacle, *given, **parts)), order=order)


def left_of(body, start=0.0):
    """What of a body's energy its account does not tell, J."""
    gone = body.ledger
    lost = gone.dissipated + gone.lost_in_switching + gone.numerical
    return abs(body.energy - start - gone.supplied + lost)


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """On a ball."""
    return rom_of(tmp_path_factory.mktemp("pad"), shape("ball", X, Y, 1e-4 * L), **UP, **RUBS, **READ)


@pytest.mark.parametrize("friction", [{}, RUBS], ids=["smooth", "rubs"])
@pytest.mark.parametrize("kind", ["ball", "rod", "peg", "edge"])
def test_what_is_between_nodes_stays_outside(tmp_path, kind, friction):
    """A pad is pressed on it, and comes to rest."""
    rom = rom_of(tmp_path, shape(kind, X, Y, 1e-4 * L), **UP, **friction)
    body, scale, left = fr.Simulator(rom, 1e-3), 0.0, 0.0
    for _ in range(60):
        body.step()
        scale, left = max(scale, body.energy), max(left, left_of(body))
    assert body.contact_forces("pin")[2] < -0.1
    assert body.integrator.contact.carriers.weights.max(axis=1).min() < 0.99  # it is not nodes alone that carry it
    assert depth_of(body.integrator, np.zeros(3)) <= OUT
    assert left <= 1e-13 * scale
    assert body.ledger.contact >= 0
    assert body.ledger.friction >= -1e-12 * scale


def test_a_mesh_that_is_not_convex_stays_outside(pressed):
    """An L that lies between nodes."""
    outline = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)])
    ends = [np.column_stack([outline, np.full(6, height)]) for height in (0, 1)]
    lid = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    sides = [face for i in range(6) for face in ((i, (i + 1) % 6, (i + 1) % 6 + 6), (i, (i + 1) % 6 + 6, i + 6))]
    triangles = np.concatenate([lid[:, ::-1], lid + 6, sides])
    angle = Mesh(R * np.concatenate(ends), triangles, position=(X, Y, 1.0001 * L))
    assert not angle.is_convex
    scene = replace(pressed.environment, obstacles={"pin": MovingObstacle(angle, STANDS_STILL)})
    body, scale, left = fr.Simulator(pressed, 1e-3, scene=scene), 0.0, 0.0
    for _ in range(60):
        body.step()
        scale, left = max(scale, body.energy), max(left, left_of(body))
    assert body.contact_forces("pin")[2] < -0.1
    assert depth_of(body.integrator, np.zeros(3)) <= OUT
    assert left <= 1e-13 * scale


def test_a_place_between_nodes_carries_what_a_node_there_does(tmp_path):
    """A plate that is held at one end: to 2 % of the force, as both bend in all modes of nearly the same mesh."""
    forces = []
    place = np.array([3.35 * L, 0.8 * L])
    for mesh in (pad((4, 2, 1)), pad((4, 2, 1), place)):
        parts = {"supports": 'clamped = ["left"]', "effects.gravity": "acceleration = [0.0, 0.0, 10.0]"}
        rom = rom_of(tmp_path, shape("ball", *place, 1e-4 * L), mesh, order=20, **parts)
        body = fr.Simulator(rom, 2e-3)
        for _ in range(200):
            body.step()
        forces.append(body.contact_forces("pin")[2])
        assert body.integrator.contact.touching == 1
    assert forces[0] == pytest.approx(forces[1], rel=0.02)


def test_a_ball_irons_over_triangles(tmp_path):
    """It goes over borders at 5 mm/s at most; the force's size changes by less than 1 % in each step of 1 ms."""

    def goes(time):
        along = 0.6 * L * (1 - np.cos(np.pi * np.clip((time - 0.06) / 0.19, 0.0, 1.0))) / 2
        down = 0.1 * L * (1 - np.cos(np.pi * min(time / 0.05, 1.0))) / 2
        return np.array([0.9 * along, 0.4 * along, -down])

    rom = rom_of(tmp_path, shape("ball", X, Y, 1e-4 * L), **RUBS)
    body = fr.Simulator(rom, 1e-3, signals={"pin": goes})
    sizes, faces, deepest, scale, left = [], set(), 0.0, 0.0, 0.0
    for step in range(280):
        body.step()
        scale, left = max(scale, body.energy), max(left, left_of(body))
        if step >= 60:
            sizes.append(np.linalg.norm(body.contact_forces("pin")))
            faces.add(tuple(sorted(body.integrator.contact.carriers.nodes[0])))
            deepest = max(deepest, depth_of(body.integrator, body.environment.state.offsets))
    assert len(faces) >= 2
    assert np.abs(np.diff(sizes)).max() <= 0.01 * np.mean(sizes)
    assert deepest <= OUT
    assert left <= 1e-13 * max(scale, body.ledger.supplied)
    assert body.ledger.contact >= 0
    assert body.ledger.friction > 0


@pytest.mark.parametrize(
    ("frame", "parts"),
    [
        ("fixed", UP | {"effects": "", "effects.damping": None}),
        ("fixed", UP | {"effects.viscoelasticity": "ratios = [0.5]\ntimes = [0.05]"}),
        ("fixed", UP | LARGE),
        ("moving", UP | {"effects.base_path": "origin = [0.0, 0.0, 0.0]"}),
    ],
    ids=["at rest", "relaxing", "large", "carried"],
)
@pytest.mark.parametrize("springs", ["", '\nmethod = "penalty"\nstiffness = 1e3'], ids=["rigid", "springs"])
def test_bodies_of_all_kinds_close_their_accounts(tmp_path, frame, parts, springs):
    """Rigid ones stay outside."""
    rom = rom_of(tmp_path, shape("ball", X, Y, 1e-4 * L) + springs, None, frame, **RUBS, **parts)
    body, scale, left = fr.Simulator(rom, 1e-3), 0.0, 0.0
    for _ in range(40):
        body.step()
        scale, left = max(scale, body.energy), max(left, left_of(body))
    assert body.integrator.contact.touching >= 1
    assert (depth_of(body.integrator, np.zeros(3)) <= OUT) is not bool(springs)
    assert left <= 1e-12 * scale


@pytest.mark.parametrize("kind", ["ball", "peg", "edge"])
def test_springs_push_by_their_depth_and_give_back_what_they_took(tmp_path, kind):
    """A pin goes in by a fifth of the mesh size and out again, without friction; 1e3 times as soft as the pad."""

    def goes(time):
        return np.array([0.0, 0.0, -0.1 * L * (1 - np.cos(2 * np.pi * min(time / 0.1, 1.0)))])

    springs = 'method = "penalty"\nstiffness = 10.0'
    body = fr.Simulator(rom_of(tmp_path, f"{shape(kind, X, Y, 1e-4 * L)}\n{springs}"), 1e-3, signals={"pin": goes})
    taken, scale, left = 0.0, 0.0, 0.0
    for step in range(110):
        body.step()
        scale, left = max(scale, body.ledger.supplied), max(left, left_of(body))
        taken = max(taken, body.ledger.contact)
        if step == 49:
            contact = body.integrator.contact
            pressure = (contact.pair_forces * contact.normals).sum()
            places = body.integrator.interface.solver.near(body.integrator.point_displacement(), [goes(0.05)])[0]
            assert len(places.gaps) == len(contact.pairs)
            assert pressure == pytest.approx(-10.0 * places.gaps.sum(), rel=2e-3)
            assert places.gaps.min() < -0.19 * L
    assert taken > 1e-5
    assert abs(body.ledger.contact) <= 2e-4 * taken  # springs begin and end to push within a step
    assert left <= 1e-13 * scale


def test_a_free_body_takes_the_impulses_of_a_pin(tmp_path):
    """Its momentum is what forces gave it; it spins, and bounces off by its elasticity."""
    rom = rom_of(tmp_path, shape("ball", X, Y, 0.02 * L), None, "moving", supports=None)
    body, given, touched = fr.Simulator(rom, 1e-3), np.zeros(3), 0
    body.place(body.pose._replace(velocity=np.array([0.02, 0.0, 0.1]), angular_velocity=np.array([0.5, -1.0, 2.0])))
    start, (P_begun, _), scale = body.energy, body.momentum, 0.0
    for _ in range(40):
        body.step()
        given += 1e-3 * body.contact_forces("pin")
        contact, scale = body.integrator.contact, max(scale, body.energy)
        touched += contact is not None and contact.touching
        assert left_of(body, start) <= 1e-12 * scale
        assert body.energy <= start + 1e-12 * scale
    assert touched >= 1
    np.testing.assert_allclose(body.momentum[0] - P_begun, given, rtol=0, atol=1e-12 * np.abs(P_begun).max())


def test_batches_rollouts_copies_and_files_go_as_steps_do(tmp_path, pressed):
    fr.write_rom(tmp_path / "pad.h5", pressed)
    body, other = fr.Simulator(pressed, 1e-3), fr.Simulator(fr.read_rom(tmp_path / "pad.h5"), 1e-3)
    batch = fr.Batch(pressed, 2, 1e-3)
    assert "the faces of a body" in batch.stepping
    for _ in range(20):
        body.step()
        batch.step(np.zeros((2, 3)))
    other.rollout(np.zeros((20, 3)))
    np.testing.assert_array_equal(other.displacement(), body.displacement())
    np.testing.assert_array_equal(batch.displacement("top")[0], body.displacement("top"))
    twin, there = copy.copy(body), body.save()
    for _ in range(10):
        body.step()
        twin.step()
    assert twin.energy == body.energy
    body.restore(there)
    for _ in range(10):
        body.step()
    assert twin.energy == body.energy


def test_steps_that_touch_have_no_derivative(pressed):
    body = fr.Simulator(pressed, 1e-3)

    def lies(outputs, energies):
        return energies[-1], {}, np.eye(len(energies))[-1]

    with pytest.raises(StepError, match="points = 'faces': steps that touch have no derivative"):
        fr.differentiate(body, np.zeros((30, 3)), lies, outputs=[])


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(SceneError, match="'faces': there is no obstacle to meet them"):
        pad_scene(tmp_path, 'self_contact = ["top"]')
    with pytest.raises(SceneError, match=r"is 0.0001 m inside a face of the body at"):
        rom_of(tmp_path, shape("ball", X, Y, -1e-4))
    with pytest.raises(SceneError, match="no triangle between contact points"):
        BodyFaces(np.zeros((3, 3)), np.empty((0, 3), dtype=int))


def test_places_are_those_of_closed_forms():
    """Of two triangles that meet in a ridge of 90 degrees, of which x = 0 is the edge."""
    points = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, -1.0], [-1.0, 0.0, -1.0]])
    faces = BodyFaces(points, np.array([[0, 2, 1], [0, 1, 3]]))
    assert faces.size == 2

    def near(obstacle):
        return faces.near(points, obstacle.distance(points)[0], obstacle.outline, 0.5, 0.1)

    found = near(Sphere((0.6, 0.0, 0.0), 0.1))  # over one of them
    np.testing.assert_allclose(found.gaps, [0.6 / np.sqrt(2) - 0.1], atol=1e-15)
    np.testing.assert_allclose(found.normals, [[-(0.5**0.5), 0.0, -(0.5**0.5)]], atol=1e-15)
    np.testing.assert_allclose(found.at, [[0.3, 0.0, -0.3]], atol=1e-15)
    found = near(Sphere((0.1, 0.2, 0.3), 0.1))  # over the edge
    np.testing.assert_allclose(found.gaps, [np.hypot(0.1, 0.3) - 0.1], atol=1e-15)
    np.testing.assert_allclose(found.weights @ [1, 1, 0], [1.0])
    np.testing.assert_allclose(found.at, [[0.0, 0.2, 0.0]], atol=1e-15)
    found = near(Capsule((-2.0, -0.1, 0.2), (2.0, 0.3, 0.2), 0.05))  # across it
    np.testing.assert_allclose(found.gaps, [0.15], atol=1e-15)
    np.testing.assert_allclose(found.at, [[0.0, 0.1, 0.0]], atol=1e-15)
    box = Box((0.0, 0.0, 1.1), (2.0, 0.4, 2.0))  # whose face is across: both of its edges are
    found = near(box)
    np.testing.assert_allclose(found.gaps, [0.1, 0.1], atol=1e-15)
    np.testing.assert_allclose(np.sort(found.at[:, 1]), [-0.2, 0.2], atol=1e-15)
