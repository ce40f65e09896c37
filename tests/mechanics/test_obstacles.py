"""Obstacles: closed forms, unit normals everywhere, and the convexity that contact relies on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.obstacles import Box, Capsule, HalfSpace, Sphere

SHAPES = {
    "half-space": HalfSpace((0.3, -0.2, 0.1), (1.0, 2.0, -2.0)),
    "sphere": Sphere((0.1, 0.2, -0.3), 0.7),
    "capsule": Capsule((-0.4, 0.0, 0.1), (0.5, 0.3, -0.2), 0.25),
    "box": Box((0.1, -0.1, 0.2), (1.0, 0.6, 0.4)),
    "turned box": Box((0.1, -0.1, 0.2), (1.0, 0.6, 0.4), (0.3, -0.9, 0.5)),
}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
seeds = st.integers(0, 2**32 - 1)


@every_shape
@given(seed=seeds)
@settings(max_examples=40, deadline=None)
def test_distance_is_convex_with_unit_normals_as_gradient(shape, seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.5, 1.5, (30, 3))
    d = rng.standard_normal((30, 3)) * 10.0 ** rng.uniform(-6, 1, (30, 1))
    gap, normal = shape.distance(x)
    assert gap.shape == (30,)
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-14
    assert np.all(shape.distance(x + d)[0] >= gap + (normal * d).sum(axis=1) - 1e-14)


@every_shape
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_the_surface_is_where_the_normal_leads(shape, seed):
    """Outside, x - gap n is on the surface and nothing of the obstacle is nearer."""
    x = np.random.default_rng(seed).uniform(-2, 2, (30, 3))
    gap, normal = shape.distance(x)
    outside = gap > 1e-3
    foot = x[outside] - gap[outside, None] * normal[outside]
    assert np.abs(shape.distance(foot)[0]).max(initial=0.0) < 1e-14


@every_shape
def test_normals_are_units_where_there_is_no_gradient(shape):
    """At centers, on axes, edges, corners and faces, and as near to them as numbers go."""
    c = np.array([[0.1, 0.2, -0.3], [0.1, -0.1, 0.2], [-0.4, 0.0, 0.1], [0.05, 0.15, -0.05], [0.6, 0.2, 0.4]])
    points = np.concatenate([c + np.sign(offset) * 10.0**power for offset in (0, 1, -1) for power in (-320, -160, -17)])
    gap, normal = shape.distance(points)
    assert np.isfinite(gap).all()
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-14


def test_half_space_and_sphere_in_closed_form():
    x = np.array([[1.0, 2.0, 5.0], [0.0, 0.0, 1.0], [3.0, 4.0, 0.0]])
    gap, normal = HalfSpace((7.0, -3.0, 2.0), (0.0, 0.0, 4.0)).distance(x)
    np.testing.assert_allclose(gap, [3.0, -1.0, -2.0], rtol=1e-15)
    np.testing.assert_array_equal(normal, [[0.0, 0.0, 1.0]] * 3)
    gap, normal = Sphere((0.0, 0.0, 0.0), 2.0).distance(x)
    np.testing.assert_allclose(gap, [np.sqrt(30) - 2, -1.0, 3.0], rtol=1e-15)
    np.testing.assert_allclose(normal[2], [0.6, 0.8, 0.0], rtol=1e-15)


def test_capsule_beside_and_beyond_its_axis():
    capsule = Capsule((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), 0.5)
    gap, normal = capsule.distance(np.array([[1.0, 0.0, 2.0], [-3.0, 0.0, 4.0], [5.0, 4.0, 0.0], [1.0, 0.1, 0.0]]))
    np.testing.assert_allclose(gap, [1.5, 4.5, 4.5, -0.4], rtol=1e-15)
    np.testing.assert_allclose(normal, [[0, 0, 1], [-0.6, 0, 0.8], [0.6, 0.8, 0], [0, 1, 0]], atol=1e-15)


def test_box_at_faces_edges_corners_and_inside():
    box = Box((0.0, 0.0, 0.0), (2.0, 4.0, 6.0))
    x = np.array([[3.0, 1.0, 2.0], [4.0, 6.0, 0.0], [3.0, -4.0, 4.0], [0.9, 0.0, 0.0], [0.0, -1.95, 0.0]])
    gap, normal = box.distance(x)
    np.testing.assert_allclose(gap, [2.0, 5.0, 3.0, -0.1, -0.05], rtol=1e-14)
    expected = [[1, 0, 0], [0.6, 0.8, 0], [2 / 3, -2 / 3, 1 / 3], [1, 0, 0], [0, -1, 0]]
    np.testing.assert_allclose(normal, expected, atol=1e-15)


def test_box_is_turned_by_its_rotation_vector():
    """A quarter turn about z exchanges the edges along x and y; and back turns what forth turned."""
    x = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    turned = Box((0.0, 0.0, 0.0), (2.0, 4.0, 6.0), (0.0, 0.0, np.pi / 2))
    gap, normal = turned.distance(x)
    same_gap, same_normal = Box((0.0, 0.0, 0.0), (4.0, 2.0, 6.0)).distance(x)
    np.testing.assert_allclose(gap, same_gap, atol=1e-14)
    np.testing.assert_allclose(normal, same_normal, atol=1e-14)
    corner = Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), np.array([1.0, 1.0, 1.0]) / np.sqrt(3) * 2 * np.pi / 3)
    np.testing.assert_allclose(corner.distance(x)[0], Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0)).distance(x)[0], atol=1e-14)
    quarter = Box((0.0, 0.0, 0.0), (2.0, 0.2, 0.2), (0.0, 0.0, np.pi / 4))
    along = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]) / np.sqrt(2) * 2
    np.testing.assert_allclose(quarter.distance(along)[0], [1.0, 1.9], rtol=1e-14)


def test_obstacles_compare_by_value():
    assert Sphere(np.zeros(3), 1) == Sphere([0, 0, 0], 1.0)
    assert hash(HalfSpace((0, 0, 0), (0, 0, 1))) == hash(HalfSpace(np.zeros(3), [0.0, 0.0, 1.0]))
    assert Box((0, 0, 0), (1, 1, 1)) != Box((0, 0, 0), (1, 1, 1), (0, 0, 1))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: HalfSpace((0, 0, 0), (0, 0, 0)), "halfspace: normal"),
        (lambda: HalfSpace((0, 0), (0, 0, 1)), "halfspace: point: use three finite numbers"),
        (lambda: Sphere((0, 0, np.nan), 1), "sphere: center"),
        (lambda: Sphere((0, 0, 0), 0), "sphere: radius: use a finite number > 0"),
        (lambda: Sphere((0, 0, 0), "1"), "sphere: radius"),
        (lambda: Capsule((0, 0, 0), (0, 0, 0), 1), "or a sphere"),
        (lambda: Capsule("abc", (0, 0, 0), 1), "capsule: start"),
        (lambda: Box((0, 0, 0), (1, 1, -1)), "box: size"),
        (lambda: Box((0, 0, 0), (1, 1, 1), (0, np.inf, 0)), "box: rotation"),
    ],
)
def test_what_is_no_obstacle_is_refused(make, says):
    with pytest.raises(SceneError, match=says):
        make()
