"""Obstacles that are smaller than the triangles of a mesh: told, and touched between the nodes."""

import numpy as np
import pytest
from bodies import box_arrays, scene_text, write_arrays

import fenics_rom as fr
from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem.contact_points import points_between
from fenics_rom.fem.mesh import read_mesh
from fenics_rom.fem.nodes import canonical_nodes
from fenics_rom.fem.supports import unknowns_of
from fenics_rom.mechanics.triangles import covering_radius
from fenics_rom.scene.file import parse_scene

LENGTHS, BRICKS, DEPTH = (0.06, 0.03, 0.02), (6, 3, 2), 1e-3  # nodes 10 mm apart
CENTER = (0.0333, 0.0167)  # above no node and no edge


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    folder = tmp_path_factory.mktemp("beam")
    (folder / "down.csv").write_text(f"time (s), x (m), y (m), z (m)\n0, 0, 0, 0\n0.1, 0, 0, -{DEPTH}\n")
    return write_arrays(folder / "box.msh", *box_arrays(LENGTHS, BRICKS))


def scene(mesh, radius, degree=1, points="surface", shape=None):
    ball = shape or f'shape = "sphere"\ncenter = [{CENTER[0]}, {CENTER[1]}, {LENGTHS[2] + radius}]\nradius = {radius}'
    text = scene_text(
        mesh,
        degree=degree,
        supports='clamped = ["bottom"]',
        contacts='[contacts.top]\nsurface = "top"',
        effects="",
        run="dt = 0.01\nduration = 0.1\nsnapshots = 10",
        **{"effects.contact": f'points = "{points}"', "effects.contact.obstacles.ball": f'{ball}\ntable = "down.csv"'},
    )
    return parse_scene(text, folder=mesh.parent)


def surface_points(run):
    """Many points of the top at the end of a run, m; of degree 2 on the flat triangles between nodes."""
    top = np.isclose(run.nodes[run.triangles, 2], LENGTHS[2]).all(axis=1)
    corners = (run.nodes + run.snapshots[-1])[run.triangles[top]]
    i, j = np.meshgrid(np.arange(21), np.arange(21))
    λ = np.stack([i, j, 20 - i - j], axis=-1)[i + j <= 20] / 20
    return np.einsum("pc,fcx->fpx", λ, corners).reshape(-1, 3)


@pytest.mark.parametrize(("radius", "degree"), [(2e-3, 1), (3e-3, 2)])
def test_small_ball_does_not_pass_between_the_nodes(mesh, radius, degree):
    asked = scene(mesh, radius, degree)
    system = fr.assemble(asked)
    with pytest.warns(FenicsRomWarning, match="points between nodes can be touched"):
        rom = fr.reduce(system, tolerance=1e-12, method="static")
    file = mesh.with_name("small.h5")
    fr.write_rom(file, rom)
    centre = np.array([*CENTER, LENGTHS[2] + radius - DEPTH])
    forces = []
    for run in (fr.simulate(asked), fr.simulate(fr.read_rom(file))):
        depth = radius - np.linalg.norm(surface_points(run) - centre, axis=1).min()
        assert depth <= 0.8 * DEPTH  # and without points between, all of it
        assert run.balance_error <= 1e-11
        forces.append(run.forces["ball"][-1])
    assert forces[0][2] < -0.05
    np.testing.assert_allclose(forces[1], forces[0], atol=0.02 * np.linalg.norm(forces[0]))


def test_forces_between_nodes_do_the_work_of_forces_on_them(mesh):
    """What interpolates displacements spreads forces: a linear field is met to round-off."""
    system = fr.assemble(scene(mesh, 2e-3, degree=2))
    points = system.points_of_contact()
    S = points.columns(system.at_nodes)
    assert len(points.coordinates) > len(points.nodes)
    field = system.body.nodes * [0.3, -0.2, 0.1] + [1.0, 2.0, -1.0]
    free = system.body.free
    field.ravel()[np.setdiff1d(np.arange(field.size), free)] = 0.0
    at_points = (S.T @ field.ravel()[free]).reshape(-1, 3)
    np.testing.assert_allclose(at_points, points.coordinates * [0.3, -0.2, 0.1] + [1.0, 2.0, -1.0], rtol=1e-13)


def test_large_obstacles_have_no_points_between(mesh):
    for shape in (
        None,
        'shape = "half-space"\npoint = [0, 0, 0.021]\nnormal = [0, 0, -1]',
        'shape = "box"\ncenter = [0.05, 0.02, 0.0215]\nsize = [0.1, 0.1, 1e-3]',
    ):
        system = fr.assemble(scene(mesh, 0.02, shape=shape))
        assert system.body.points_between is None
        assert system.warnings == ()


def test_rom_that_meets_a_smaller_obstacle_than_it_was_made_for_says_so(mesh):
    rom = fr.reduce(fr.assemble(scene(mesh, 0.02, points="nodes")), order=30, method="static")
    run = fr.simulate(rom, scene=scene(mesh, 2e-3, points="nodes"))
    (message,) = (text for text in run.warnings if "obstacle" in text)
    assert "'ball' is 0.004 m across" in message
    assert "gaps of 0.0141 m that it passes through" in message


def test_ball_that_is_let_through_is_told(mesh):
    """As nodes alone can be touched: with its size, the gap, and the cures; whole faces are one."""
    system = fr.assemble(scene(mesh, 2e-3, points="nodes"))
    assert system.body.points_between is None
    (message,) = system.warnings
    assert "effects.contact.points = 'faces' is the cure, or a mesh of 0.002 m at the contact surface" in message
    assert not fr.assemble(scene(mesh, 2e-3, points="faces")).warnings
    run = fr.simulate(system)
    assert not run.forces["ball"].any()
    assert message in run.warnings


def test_needle_that_wants_too_many_points_is_told(mesh):
    system = fr.assemble(scene(mesh, 1e-5))
    assert system.body.points_between is None
    assert any("or a mesh of 1e-05 m at the contact surface" in message for message in system.warnings)


def test_points_are_as_close_as_they_say(mesh):
    asked = scene(mesh, 2e-3)
    nodes = canonical_nodes(read_mesh(asked.mesh_file, {}), 1)
    between = points_between(asked, nodes, unknowns_of(asked, nodes))
    points = fr.assemble(asked).points_of_contact().coordinates
    random = np.random.default_rng(0).uniform(size=(4000, 2)) * LENGTHS[:2]
    nearest = np.linalg.norm(random[:, None] - points[None, :, :2], axis=2).min(axis=1)
    assert 0.8 * between.gap < nearest.max() <= between.gap <= 1.8e-3


@pytest.mark.parametrize(
    ("corners", "radius"),
    [
        ([(0, 0), (1, 0), (0.5, np.sqrt(0.75))], 1 / np.sqrt(3)),
        ([(0, 0), (1, 0), (0, 1)], np.sqrt(0.5)),
        ([(0, 0), (2, 0), (1, 0.1)], 0.505),  # flat: a point of the longest side, as far from its end as from the third
    ],
)
def test_covering_radius(corners, radius):
    corners = np.column_stack([np.array(corners, dtype=float), np.zeros(3)])
    assert covering_radius(corners[None])[0] == pytest.approx(radius, rel=1e-12)
    λ = np.random.default_rng(0).dirichlet([1, 1, 1], size=20000)
    farthest = np.linalg.norm((λ @ corners)[:, None] - corners, axis=2).min(axis=1).max()
    assert 0.97 * radius <= farthest <= radius
