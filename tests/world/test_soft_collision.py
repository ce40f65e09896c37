"""Surfaces of soft bodies against shapes, and against one another: gaps against all pairs of points and triangles."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.world.collision.contacts import PlacedShape
from fenics_rom.world.collision.find import find_contacts
from fenics_rom.world.guide import Guide
from fenics_rom.world.shapes import Box, Capsule, Sphere

TURN = Rotation.from_rotvec((0.4, -0.2, 0.7)).as_matrix()


def ball(radius, centre):
    vertices, triangles = Sphere(radius).surface()
    vertices, first = np.unique(np.round(vertices, 12), axis=0, return_inverse=True)  # poles and seams once
    triangles = first.reshape(-1)[triangles]
    return PlacedSurface(vertices @ TURN.T + centre, triangles, np.arange(len(vertices)))


def plate(height, up, cells=6):
    """A square, an open surface that looks up or down."""
    axis = np.linspace(-0.5, 0.5, cells + 1)
    points = np.stack([*map(np.ravel, np.meshgrid(axis, axis)), np.full((cells + 1) ** 2, height)], axis=1)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    halves = [[corner, corner + 1, corner + cells + 2], [corner, corner + cells + 2, corner + cells + 1]]
    triangles = np.concatenate([np.stack(half, axis=1) for half in halves])
    return PlacedSurface(points, triangles if up else triangles[:, ::-1], np.arange(len(points)))


def test_the_nearest_point_of_a_triangle_is_what_a_search_finds():
    rng = np.random.default_rng(0)
    points, corners = rng.standard_normal((40, 3)), rng.standard_normal((40, 3, 3))
    weights, places = nearest_on_triangles(points, corners)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-13)
    np.testing.assert_allclose(places, (weights[:, :, None] * corners).sum(axis=1), atol=1e-13)
    for point, place, triangle in zip(points, places, corners, strict=True):
        sum_to_one = {"type": "eq", "fun": lambda w: w.sum() - 1}
        found = minimize(
            lambda w, p=point, t=triangle: ((w @ t - p) ** 2).sum(),
            [1 / 3] * 3,
            bounds=[(0, 1)] * 3,
            constraints=sum_to_one,
            tol=1e-12,
        )
        assert np.linalg.norm(place - point) == pytest.approx(np.sqrt(found.fun), abs=1e-5)


def test_points_against_a_shape_have_its_distance():
    soft = ball(0.3, (0.5, 0.1, 0.0))
    soft = soft._replace(touching=soft.touching[::2])
    box = PlacedShape(Box((0.6, 0.6, 0.6)), np.array([0.0, 0.1, 0.05]), TURN.T)
    found = find_contacts(soft, box, 0.02)
    gaps = box.shape.distance((soft.points - box.position) @ box.rotation)[0]
    expected = soft.touching[gaps[soft.touching] <= 0.02]
    np.testing.assert_array_equal(found.first.nodes[:, 0], expected)
    np.testing.assert_array_equal(found.first.feature, expected)
    np.testing.assert_allclose(found.gaps, gaps[expected], atol=1e-14)
    np.testing.assert_array_equal(found.first.arms, found.second.arms)
    assert found.gaps.min() < -0.05
    assert found.second.nodes.shape == (len(expected), 0)
    back = find_contacts(box, soft, 0.02)
    np.testing.assert_array_equal(back.normals, -found.normals)
    far = PlacedShape(Capsule(0.1, 0.1), np.array([3.0, 0, 0]), TURN)
    assert len(find_contacts(soft, far, 0.02).gaps) == 0


@pytest.mark.parametrize("distance", [0.51, 0.49])
def test_two_balls_touch_as_spheres_do(distance):
    """Triangles of 7.5 degrees lie inside of the ball by at most r (1 - cos 5.3°) = 0.4 % of it, at their middles."""
    first, second = ball(0.3, (0, 0, 0)), ball(0.2, (0, 0.6 * distance, 0.8 * distance))
    found = find_contacts(first, second, 0.02)
    assert found.gaps.min() == pytest.approx(distance - 0.5, abs=0.003)
    assert len(np.unique(found.first.feature)) == len(found.gaps)
    nearest = found.gaps.argmin()
    np.testing.assert_allclose(found.normals[nearest], [0, -0.6, -0.8], atol=0.1)
    for spots, body in ((found.first, first), (found.second, second)):
        np.testing.assert_allclose(
            (spots.weights[:, :, None] * body.points[spots.nodes]).sum(axis=1), spots.arms, atol=1e-14
        )
    np.testing.assert_allclose(found.first.arms - found.second.arms, found.gaps[:, None] * found.normals, atol=1e-14)


def test_each_point_meets_what_is_nearest_of_all_triangles():
    first, second = ball(0.3, (0, 0, 0)), ball(0.2, (0.1, 0.3, 0.38))
    found = find_contacts(first, second, 0.05)
    corners = second.points[second.triangles]
    for point in first.points[::7]:
        _, places = nearest_on_triangles(np.tile(point, (len(corners), 1)), corners)
        nearest = np.linalg.norm(places - point, axis=1).min()
        outside = np.linalg.norm(point - [0.1, 0.3, 0.38]) > 0.2
        rows = np.flatnonzero((found.first.arms == point).all(axis=1) & (found.first.weights[:, 0] == 1))
        rows = rows[found.first.feature[rows] < len(first.points)]
        assert len(rows) == (nearest <= 0.05 if outside else nearest < 0.01 or len(rows))
        if len(rows):
            assert abs(found.gaps[rows[0]]) == pytest.approx(nearest, abs=1e-13)


@pytest.mark.parametrize("gap", [1e-3, 0.0, -1e-3])
def test_two_plates_lie_on_one_another(gap):
    """Every point of both, shifted or not, with the normal up; none of those beside an open plate."""
    below, above = plate(0.0, True), plate(gap, False, cells=5)
    found = find_contacts(above, below, 2e-3)
    assert len(found.gaps) == 36 + 49
    np.testing.assert_allclose(found.gaps, gap, atol=1e-14)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]] * 85, atol=1e-9)
    moved = above._replace(points=above.points + np.array([0.7, 0, 0]))
    found = find_contacts(moved, below, 2e-3)
    assert (np.abs(found.first.arms[:, 0]) <= 0.5 + 2e-3).all()
    assert (found.first.arms[:, 0] >= 0.2 - 2e-3).all()


def test_features_stay_when_surfaces_move_a_little():
    first, second = ball(0.3, (0, 0, 0)), ball(0.2, (0.1, 0.3, 0.38))
    before = find_contacts(first, second, 0.02)
    after = find_contacts(first._replace(points=first.points + 1e-9), second, 0.02)
    np.testing.assert_array_equal(before.first.feature, after.first.feature)
    np.testing.assert_allclose(before.gaps, after.gaps, atol=1e-8)


def test_how_forces_of_pairs_with_different_friction_change_is_what_differences_say():
    rng, C = np.random.default_rng(0), 5
    B, n, μ = rng.standard_normal((3 * C, 3 * C)), rng.standard_normal((C, 3)), np.array([0.5, 0.2, 0.9, 0.5, 0.0])
    n /= np.linalg.norm(n, axis=1)[:, None]
    guide, pairs, q = Guide(B @ B.T / 15, np.ones(C, bool)), np.arange(C), 0.3 * rng.standard_normal((C, 3)) - n
    forces, u = guide.solve(pairs, q, n, μ, np.zeros((C, 3)), 0)
    targets, ε = rng.standard_normal((C, 3)), 1e-6
    targets -= (targets * n).sum(axis=1)[:, None] * n
    ends = [guide.solve(pairs, q - step * targets, n, μ, forces, 0) for step in (-ε, ε)]
    for found, before, after in zip(guide.response(pairs, n, μ, forces, u, targets.T), *ends, strict=True):
        change = (after - before) / (2 * ε)
        across = (change - (change * n).sum(axis=1)[:, None] * n).T
        np.testing.assert_allclose(found, across, atol=1e-6 * np.abs(across).max())
