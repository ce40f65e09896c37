"""Rigid shapes: volumes, inertia and distances against closed forms, sums over points, and one another."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from fenics_rom.errors import SceneError
from fenics_rom.world.shapes import Box, Capsule, Cylinder, HalfSpace, Hull, Sphere

POINTS = np.random.default_rng(0).standard_normal((30, 3)) + np.array([5, -3, 2])
SHAPES = {
    "sphere": Sphere(0.7),
    "capsule": Capsule(0.3, 0.8),
    "cylinder": Cylinder(0.4, 0.9),
    "box": Box((0.5, 0.8, 1.1)),
    "hull": Hull(POINTS),
}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


@every_shape
def test_mass_and_inertia_are_those_of_many_small_cubes(shape):
    """The middle rule over a grid that is turned: its errors are those of the cells at the surface, and alternate."""
    axis = (np.arange(41) + 0.5) / 41 * 2 - 1
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3) * shape.radius_around
    grid = grid @ Rotation.from_rotvec((0.3, 0.5, -0.2)).as_matrix()
    inside = grid[np.concatenate([shape.distance(part)[0] < 0 for part in np.array_split(grid, 50)])]
    cell = (2 * shape.radius_around / 41) ** 3
    mass, inertia = shape.inertia(3.0)
    assert mass == 3.0 * shape.volume == pytest.approx(3.0 * cell * len(inside), rel=0.01)
    squares = 3.0 * cell * inside.T @ inside
    assert np.abs(inertia - (np.trace(squares) * np.eye(3) - squares)).max() < 0.02 * inertia.max()
    assert np.abs(inside.mean(axis=0)).max() < 0.003 * shape.radius_around


def test_closed_forms():
    r, h, mass = 0.3, 0.8, 2.0
    for shape, across, along in (
        (Sphere(r), 2 / 5 * r**2, 2 / 5 * r**2),
        (Cylinder(r, h), r**2 / 4 + h**2 / 12, r**2 / 2),
        (Box((r, r, h)), (r**2 + h**2) / 12, r**2 / 6),
    ):
        found = shape.inertia(mass / shape.volume)
        np.testing.assert_allclose(found[1], mass * np.diag([across, across, along]), rtol=1e-13)
    # a capsule is a rod and two half balls, whose centres of mass are at 3r/8 from their faces
    rod, ball = np.pi * r**2 * h, 4 / 3 * np.pi * r**3
    across = rod * (r**2 / 4 + h**2 / 12) + ball * (2 / 5 * r**2 + h**2 / 4 + 3 / 8 * r * h)
    expected = np.diag([across, across, rod * r**2 / 2 + ball * 2 / 5 * r**2])
    np.testing.assert_allclose(Capsule(r, h).inertia(1.0)[1], expected, rtol=1e-13)


def test_a_box_given_as_a_hull_is_the_box():
    """Also with points inside, on faces and on edges, which are no corners, and far from the origin."""
    box, away = Box((0.2, 0.3, 0.5)), np.array([3.0, -2.0, 1.0])
    inner = [box.vertices * share for share in ([1, 1, 0.5], [1, 0.2, -0.3], [0.1, 0.9, 0.3])]
    hull = Hull(np.concatenate([*inner, box.vertices]) + away)
    assert len(hull.vertices) == 8
    assert sorted(map(len, hull.loops)) == [4] * 6
    np.testing.assert_allclose(hull.shift, away, atol=1e-14)
    np.testing.assert_allclose(hull.inertia(3.0)[1], box.inertia(3.0)[1], rtol=1e-12, atol=1e-16)
    x = np.random.default_rng(1).uniform(-0.6, 0.6, (400, 3))
    for mine, theirs in zip(hull.distance(x), box.distance(x), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-13)


def test_a_hull_is_qhulls():
    hull, reference = Hull(POINTS), ConvexHull(POINTS)
    assert {tuple(v) for v in np.round(hull.vertices + hull.shift, 12)} == {
        tuple(v) for v in np.round(POINTS[reference.vertices], 12)
    }
    assert hull.volume == pytest.approx(reference.volume, rel=1e-12)


@every_shape
def test_distances_are_those_to_the_surface(shape):
    """Outside, x - gap n is on it, and no point of the shape is nearer; the gap is convex along the way out."""
    x = np.random.default_rng(2).uniform(-1.5, 1.5, (300, 3)) * shape.radius_around
    gap, normal = shape.distance(x)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-13)
    outside = gap > 0
    foot = x[outside] - gap[outside, None] * normal[outside]
    assert np.abs(shape.distance(foot)[0]).max() < 1e-13 * 10
    d = np.random.default_rng(3).standard_normal(x.shape)
    assert np.all(shape.distance(x + d)[0] >= gap + (normal * d).sum(axis=1) - 1e-12)


@every_shape
def test_surfaces_are_closed_and_look_outwards(shape):
    vertices, triangles = shape.surface()
    corners = vertices[triangles]
    assert np.linalg.det(corners).sum() / 6 == pytest.approx(shape.volume, rel=0.02)
    assert np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)).max() < 1e-12
    assert np.linalg.norm(vertices, axis=1).max() == pytest.approx(shape.radius_around, rel=1e-12)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Sphere(0), "sphere: radius: use a finite number > 0"),
        (lambda: Capsule(1, -1), "capsule: length: use a finite number > 0"),
        (lambda: Cylinder("1", 1), "cylinder: radius"),
        (lambda: Box((1, 0, 1)), "box: size"),
        (lambda: Hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), "lie in one plane"),
        (lambda: Hull([[0, 0, 0]] * 5), "lie in one plane"),
        (lambda: Hull("abcd"), "at least 4 points of three finite numbers"),
        (lambda: HalfSpace().inertia(1.0), "half-space: has no mass"),
    ],
)
def test_what_is_no_shape_is_refused(make, says):
    with pytest.raises(SceneError, match=says):
        make()
