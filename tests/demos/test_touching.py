"""Other meshes of a body, by which the demos of contact tell what full order makes of its own."""

import importlib
import sys
from functools import partial
from pathlib import Path

import gmsh
import numpy as np
import pytest
from bodies import scene_text, write_box

import fenics_rom as fr
from fenics_rom.scene.file import parse_scene

POKE = Path(__file__).parents[2] / "demos" / "poke"
LENGTHS, STEPS = (0.2, 0.15, 0.1), 60
ROUNDING = 2.0**-52


@pytest.fixture(scope="module")
def touching():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(POKE)
        yield importlib.import_module("touching")
        sys.modules.pop("touching")


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return write_box(tmp_path_factory.mktemp("box") / "box.msh", LENGTHS, (4, 3, 2))


@pytest.fixture(scope="module")
def scene(box):
    """A box that falls on level ground, touches it with friction, and stays."""
    effects = """inertia = {}
damping = { beta = 1e-3 }
gravity = { acceleration = [0, 0, -9.81] }
contact = { obstacles = { ground = { shape = "half-space", point = [0, 0, -0.002], normal = [0, 0, 1] } } }
friction = { coefficient = 0.5 }"""
    run = f"dt = 1e-3\nduration = {STEPS * 1e-3}"
    contacts = '[contacts.bottom]\nsurface = "bottom"'
    return parse_scene(scene_text(box, effects=effects, contacts=contacts, supports=None, run=run))


@pytest.fixture(scope="module")
def full(scene):
    return fr.simulate(scene)


def volume_and_box(mesh):
    """Of a mesh: the volumes of its cells, how far it reaches."""
    gmsh.initialize([], readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(mesh))
        tags, points, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
    points = points.reshape(-1, 3)
    cells = points[np.argsort(tags)][corners.reshape(-1, 4).astype(int) - 1]
    return np.linalg.det(cells[:, 1:] - cells[:, :1]) / 6, np.ptp(points, axis=0)


def test_nodes_that_stay_give_the_same_run_to_the_bit(touching, scene, full):
    again = touching.run_moved(scene, full, np.copy)
    assert np.array_equal(again.snapshots, full.snapshots)
    assert np.array_equal(again.forces["ground"], full.forces["ground"])
    assert full.forces["ground"].any()


def test_a_body_turned_about_what_scene_and_ground_are_symmetric_about_moves_as_it_did_turned(touching, scene, full):
    centre = (0.1, 0.05, 0.0)
    turn = partial(touching.turned, axis=2, centre=centre)
    run = touching.run_moved(scene, full, turn)
    moved = turn(full.snapshots.reshape(-1, 3) + centre) - centre
    size = np.abs(full.snapshots).max()
    off = np.abs(run.snapshots - moved.reshape(full.snapshots.shape)).max()
    assert off < 10 * STEPS * ROUNDING * size  # damped: what a step rounds is handed on, and does not grow
    assert np.abs(run.snapshots - full.snapshots).max() > 1e-4 * size  # it also moves aside


def test_nodes_that_slide_make_another_mesh_of_the_same_box(touching, scene, tmp_path):
    ends, way = (0.0, LENGTHS[0]), 2e-3
    move = partial(touching.slid, axis=0, ends=ends, way=way)
    touching.write_moved(scene.mesh_file, move, tmp_path / "slid.msh")
    (before, reach), (after, reach_after) = volume_and_box(scene.mesh_file), volume_and_box(tmp_path / "slid.msh")
    assert np.abs(reach_after - reach).max() < 4 * ROUNDING * reach.max()
    assert after.min() > 0.0
    assert after.sum() == pytest.approx(before.sum(), rel=10 * len(before) * ROUNDING)
    assert np.abs(after / before - 1).max() > way / LENGTHS[0]  # and its cells have other volumes


def test_beyond_the_planes_nodes_stay(touching):
    nodes = np.random.default_rng(0).uniform(-1, 2, (100, 3))
    moved = touching.slid(nodes, axis=1, ends=(0.0, 1.0), way=0.01)
    inside = (nodes[:, 1] > 0) & (nodes[:, 1] < 1)
    assert np.array_equal(moved[~inside], nodes[~inside])
    assert (moved[inside, 1] > nodes[inside, 1]).all()
    assert np.array_equal(moved[:, [0, 2]], nodes[:, [0, 2]])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_nodes_turn_by_a_degree_about_an_axis_through_the_centre(touching, axis):
    frame = along, second, third = np.roll(np.eye(3), -axis, axis=0)  # right-handed
    centre, degree = np.array([0.3, -0.2, 0.5]), np.pi / 180
    turned = touching.turned(centre + frame, axis=axis, centre=centre) - centre
    towards = np.cos(degree) * second + np.sin(degree) * third
    assert np.abs(turned - [along, towards, np.cross(along, towards)]).max() < 10 * ROUNDING


def test_errors_of_many_runs_are_told_by_medians_and_by_ratios_in_the_same_runs(touching, capsys):
    """Ratios of 1/4, 1 and 1 are 0.63 in the geometric mean, known to a factor of 4^(1/3)."""
    cases = importlib.import_module("cases")
    errors = np.array([[1e-3, 1.0], [2e-3, 3.0], [4e-3, 8.0]])
    others = errors * [[4.0, 2.0], [1.0, 2.0], [1.0, 2.0]]
    some, more = (cases.Cases({("a", 20): errors[of], ("b", 40): others[of]}) for of in (slice(2), slice(2, 3)))
    assert (some + more).medians == [("a", 20, "2.0e-03", "3.0e+00"), ("b", 40, "4.0e-03", "6.0e+00")]
    ratios = (some + more).ratios(("a", 20), ("b", 40), ("shape", "force"))
    assert ratios == pytest.approx({"shape": 4 ** (-1 / 3), "force": 0.5}, rel=1e-14)
    assert "shape 0.63, known to a factor of 1.59" in capsys.readouterr().out
