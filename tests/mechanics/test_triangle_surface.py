"""Distances from surfaces of triangles: every triangle asked, closed forms, normals at edges, and what is refused."""

import numpy as np
import pytest
from triangle_meshes import ball, blob, groove, plate, prism, room

from fenics_rom.compilation import compiled, numpy_alone
from fenics_rom.errors import SceneError
from fenics_rom.mechanics.obstacles import Box, HalfSpace, Mesh, Sphere
from fenics_rom.mechanics.triangles import nearest_on_triangles

BLOCK = np.array([[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]])


def asked_of_all(mesh, points):
    """Distances without a sign, and which points are inside, by every triangle."""
    corners = mesh.surface.vertices[mesh.triangles]
    squares, angles = np.full(len(points), np.inf), np.zeros(len(points))
    for triangle in corners:
        _, places = nearest_on_triangles(points, np.broadcast_to(triangle, (len(points), 3, 3)))
        squares = np.minimum(squares, np.square(points - places).sum(axis=1))
        a, b, c = (triangle[k] - points for k in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        above = (a * np.cross(b, c)).sum(axis=1)
        beside = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        angles += 2 * np.arctan2(above, beside)
    return np.sqrt(squares), angles > 2 * np.pi


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_the_nearest_of_all_triangles(seed):
    mesh, rng = blob(seed, halvings=2), np.random.default_rng(seed)
    points = rng.uniform(-0.2, 0.2, (200, 3))
    vertices, corners = mesh.surface.vertices, mesh.surface.vertices[mesh.triangles]
    near = np.concatenate([vertices[:40], corners[:40].mean(axis=1), corners[:40, :2].mean(axis=1)])
    near = near + 10.0 ** rng.uniform(-12, -2, (len(near), 1)) * rng.standard_normal(near.shape)
    points = np.concatenate([points, near])
    gaps, normals = mesh.distance(points)
    distances, inside = asked_of_all(mesh, points)
    at_corners = distances < 1e-9 * mesh.surface.size  # there distances are those from one plane
    assert np.abs(np.abs(gaps) - distances)[~at_corners].max() < 1e-15
    assert (np.abs(gaps) <= distances + 1e-15)[at_corners].all()
    np.testing.assert_array_equal((gaps < 0)[~at_corners], inside[~at_corners])
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-14
    out = distances > 1e-4
    feet = (points - gaps[:, None] * normals)[out]
    assert np.abs(mesh.distance(feet)[0]).max() < 1e-14, "the surface is where the normal leads"


def test_loops_and_arrays_find_triangles_as_near():
    """Which of those that are as near is a choice; without numba the loops are Python's."""
    tree, points = blob(3, halvings=3).surface._tree, np.random.default_rng(0).uniform(-0.2, 0.2, (60, 3))
    squares = [
        np.square(points - nearest_on_triangles(points, tree._corners[find(points)])[1]).sum(axis=1)
        for find in (tree._nearest_by_loops, tree._nearest_by_arrays)
    ]
    np.testing.assert_allclose(*squares, rtol=1e-12, atol=0)


def test_derivatives_of_the_distance_are_normals_and_curvatures():
    mesh, step = blob(5, halvings=1), 1e-6
    points = np.random.default_rng(1).uniform(-0.2, 0.2, (60, 3))
    ahead, back = (zip(*(mesh.distance(points + side * step * e) for e in np.eye(3)), strict=True) for side in (1, -1))
    (gaps, normals), (gaps_back, normals_back) = (list(map(np.array, each)) for each in (ahead, back))
    np.testing.assert_allclose((gaps - gaps_back).T / (2 * step), mesh.distance(points)[1], atol=1e-8)
    curvature = (normals - normals_back).transpose(1, 2, 0) / (2 * step)
    np.testing.assert_allclose(curvature, mesh.curvature(points), atol=1e-7)


def test_a_block_of_triangles_is_the_box():
    """At faces, edges and corners alike; convex, as the box is."""
    mesh, box = Mesh(*prism(BLOCK, 0.8)), Box((0.0, 0.0, 0.0), (1.0, 0.8, 0.6))
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    for ours, theirs in zip(mesh.distance(points), box.distance(points), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-14)
    np.testing.assert_allclose(mesh.curvature(points), box.curvature(points), atol=1e-9)
    assert mesh.is_convex
    assert mesh.core[0] == pytest.approx(0.3, rel=1e-14)


def test_a_ball_of_triangles_is_the_sphere_but_for_its_faces():
    """The middle of a face is as far inside as its chord is: by a quarter of that when all sides are halved."""
    points = np.random.default_rng(0).uniform(-2, 2, (300, 3))
    errors = []
    for halvings in (2, 3, 4):
        mesh = Mesh(*ball(1.0, halvings))
        assert mesh.is_convex
        middles = mesh.surface.vertices[mesh.triangles].mean(axis=1)
        faceting = 1 - np.linalg.norm(middles, axis=1).min()
        off = mesh.distance(points)[0] - Sphere((0, 0, 0), 1.0).distance(points)[0]
        assert off.min() > -1e-14
        assert off.max() <= 1.01 * faceting
        errors.append(faceting)
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_normals_do_not_turn_at_edges_in_a_plane():
    """On the surface, above and below it: those of the plane, however near to edges and corners."""
    turn, place = (0.3, -0.2, 0.7), (0.02, 0.01, -0.03)
    mesh = Mesh(*plate(12), place, turn, open=1)
    normal = mesh.surface.normals[0]
    plane, rng = HalfSpace(place, normal), np.random.default_rng(0)
    corners = mesh.surface.vertices[mesh.triangles]
    on = np.concatenate([mesh.surface.vertices, corners[:, :2].mean(axis=1), corners.mean(axis=1)])
    inside = np.abs(on - place).max(axis=1) < 0.12
    for height in (0.0, 1e-17, -1e-17, 1e-12, -1e-12, 1e-6, -1e-9, 1e-3):
        points = on[inside] + height * normal + 1e-16 * rng.standard_normal(on[inside].shape)
        gaps, normals = mesh.distance(points)
        np.testing.assert_allclose(gaps, plane.distance(points)[0], atol=1e-16)
        np.testing.assert_allclose(normals, np.broadcast_to(normal, normals.shape), atol=1e-9)


def test_beside_the_border_of_an_open_surface_is_outside():
    mesh = Mesh(*plate(3, size=2.0), open=1)
    gaps, normals = mesh.distance(np.array([[2.0, 0, 0], [1.3, 0, -0.4], [1.4, 1.3, 0], [0, 0, 0.3], [0.1, 0, -0.2]]))
    np.testing.assert_allclose(gaps, [1, 0.5, 0.5, 0.3, -0.2], atol=1e-15)
    expected = [[1, 0, 0], [0.6, 0, -0.8], [0.8, 0.6, 0], [0, 0, 1], [0, 0, 1]]
    np.testing.assert_allclose(normals, expected, atol=1e-15)
    assert mesh.core[0] == np.inf


def test_ways_go_through_the_first_triangle_that_they_meet():
    corner = room()
    starts = np.array([[0.1, 0.1, 0.1], [0.1, 0.2, 0.1], [0.1, 0.1, 0.1], [0.0, 0.1, 0.1], [-0.1, 0.1, 0.1]])
    ends = np.array([[-0.1, 0.0, 0.05], [0.1, 0.2, -0.05], [0.2, 0.2, 0.2], [-1e-6, 0.1, 0.1], [-0.2, 0.1, 0.1]])
    crossed = corner.surface.first_crossed(starts, ends)
    np.testing.assert_array_equal(corner.surface.normals[crossed[[0, 1, 3]]], [[1, 0, 0], [0, 0, 1], [1, 0, 0]])
    np.testing.assert_array_equal(crossed[[2, 4]], -1)  # away from it, and from within


@pytest.mark.skipif(not compiled(), reason="numba is not installed")
@pytest.mark.parametrize("length", [0.03, 0.3])
def test_compiled_ways_go_through_the_same_triangles(length):
    surface, random = Mesh(*ball()).surface, np.random.default_rng(0)
    starts = random.normal(size=(400, 3))
    far = random.uniform(0.95, 1.05, (400, 1)) * np.abs(surface.vertices).max()
    starts *= far / np.linalg.norm(starts, axis=1)[:, None]
    ends = starts + length * random.normal(size=(400, 3))
    found = surface.first_crossed(starts, ends)
    with numpy_alone():
        np.testing.assert_array_equal(found, surface.first_crossed(starts, ends))
    assert np.count_nonzero(found >= 0) > 10


def test_points_in_a_corner_meet_all_its_planes():
    found = room().surface.planes_near(np.array([[0.01, 0.02, 0.03]]), 0.05)
    order = np.argsort(found.gaps)
    np.testing.assert_allclose(found.gaps[order], [0.01, 0.02, 0.03], atol=1e-15)
    np.testing.assert_allclose(found.normals[order], np.eye(3), atol=1e-15)
    assert not room().is_convex
    assert len(room().surface.planes_near(np.array([[0.01, 0.02, 0.03]]), 0.015).gaps) == 1


def test_meshes_compare_by_value():
    assert Mesh(*ball()) == Mesh(*ball())
    assert hash(Mesh(*ball())) == hash(Mesh(*ball()))
    assert Mesh(*ball()) != Mesh(*ball(), (0.0, 0.0, 1.0))


VERTICES, TRIANGLES = prism(BLOCK, 0.8)
MOVED = VERTICES + np.array([0.8, 0.05, 0.1])
THROUGH = np.concatenate([VERTICES, MOVED]), np.concatenate([TRIANGLES, TRIANGLES + 8])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Mesh(VERTICES, TRIANGLES[:0]), r"mesh: triangles: use 1 to 2,000,000 \(got 0\)"),
        (lambda: Mesh(VERTICES[:, :2], TRIANGLES), r"vertices \(V, 3\) and triangles \(T, 3\)"),
        (lambda: Mesh(VERTICES, TRIANGLES.astype(float)), "triangles: use whole numbers"),
        (lambda: Mesh(VERTICES, TRIANGLES + 1), "triangles: use rows 0 to 7"),
        (lambda: Mesh(np.where(VERTICES > 0.45, np.nan, VERTICES), TRIANGLES), r"finite numbers \(got vertex \d at"),
        (lambda: Mesh(VERTICES, np.concatenate([TRIANGLES, [[0, 1, 1]]])), "1 of 13 triangles have no area, e.g. "),
        (lambda: Mesh(VERTICES, TRIANGLES[1:]), r"not closed: 3 of 18 edges .* one at \[.*\]; .* open = true"),
        (lambda: Mesh(VERTICES, TRIANGLES[:, ::-1]), r"inside out, as it encloses -0.48 m3"),
        (lambda: Mesh(VERTICES, np.concatenate([TRIANGLES[:1, ::-1], TRIANGLES[1:]])), "turned opposite ways, e.g. "),
        (lambda: Mesh(VERTICES, np.concatenate([TRIANGLES, TRIANGLES[:1]])), "edges have more than two triangles"),
        (lambda: Mesh(*THROUGH), r"goes through itself at \d+ places, by 0.\d+ m at \["),
        (lambda: Mesh(VERTICES, TRIANGLES, (0.0, np.inf, 0.0)), "mesh: position: use three finite numbers"),
    ],
)
def test_what_is_no_solid_is_refused(make, says):
    with pytest.raises(SceneError, match=says):
        make()


def test_a_groove_is_as_deep_as_its_slopes():
    gaps, normals = groove(0.5).distance(np.array([[0.02, 0.1, 0.03], [-0.02, 0.0, 0.03], [0.0, 0.0, 0.01]]))
    np.testing.assert_allclose(gaps, np.array([0.02, 0.02, 0.01]) * 2 / np.sqrt(5), atol=1e-16)
    np.testing.assert_allclose(np.abs(normals[:, 0] / normals[:, 2]), 0.5, atol=1e-14)
