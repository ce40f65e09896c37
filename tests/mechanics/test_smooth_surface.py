"""Flat triangles that stand for a smooth surface: normals and gaps against the surface, and from place to place."""

import numpy as np
import pytest

from fenics_rom.mechanics.placed_surface import PlacedSurface, points_near
from fenics_rom.mechanics.smooth_surface import BORDER, CREASE, SMOOTH, bends_of, corner_normals
from fenics_rom.world.shapes import Box, Sphere


def surface_of(shape):
    """Vertices, each once, and triangles."""
    vertices, triangles = shape.surface()
    vertices, first = np.unique(np.round(vertices, 12), axis=0, return_inverse=True)
    return vertices, first.reshape(-1)[triangles]


def wavy(cells=8, height=0.01):
    """A patch z = f(x, y), and its triangles; f is of second order."""
    axis = np.linspace(-0.1, 0.1, cells + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    rows = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = rows[:-1, :-1].ravel(), rows[1:, :-1].ravel(), rows[1:, 1:].ravel(), rows[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x, y, paraboloid(x, y, height)], axis=1), triangles


def paraboloid(x, y, height):
    return height * ((x / 0.1) ** 2 - 0.4 * (y / 0.1) ** 2 + 0.5 * x * y / 0.01)


def met(points, vertices, triangles, margin=0.02, rest=None):
    """What points meet; `rest`: where vertices are at rest, None: the surface is as flat as its triangles."""
    bends = None if rest is None else bends_of(rest, triangles)
    first = PlacedSurface(points, np.empty((0, 3), dtype=int), np.arange(len(points)))
    return points_near(first, PlacedSurface(vertices, triangles, np.empty(0, dtype=int), bends), margin)


def test_normals_at_the_corners_of_a_ball_are_the_balls_own():
    """Max's weights are exact where vertices are on a sphere."""
    vertices, triangles = surface_of(Sphere(0.3))
    bends = bends_of(vertices, triangles)
    assert (bends[:, 3:] == SMOOTH).all()
    normals = corner_normals(vertices[triangles], bends[:, :3])
    at = np.empty((len(normals), 3))
    at[bends[:, :3]] = vertices[triangles]
    assert len(normals) == len(vertices)
    np.testing.assert_allclose(normals, at / 0.3, atol=1e-9)  # vertices were rounded to 1e-12 of some 0.01


def test_points_above_a_ball_have_the_balls_distance():
    """Flat triangles of 7.5° are inside of it by up to 0.4 % of the radius, and turned by up to 5°; 1/200 is left."""
    vertices, triangles = surface_of(Sphere(0.3))
    directions = np.random.default_rng(0).standard_normal((400, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    errors = []
    for rest in (None, vertices):
        found = met(0.301 * directions, vertices, triangles, rest=rest)
        assert len(found.row) == 400
        off, turned = np.abs(found.gaps - 1e-3), np.linalg.norm(found.normals - directions[found.row], axis=1)
        errors.append((off.max(), turned.max()))
    (off, turned), (smooth_off, smooth_turned) = errors
    assert off > 1e-3
    assert smooth_off < off / 200
    assert turned > 0.08
    assert smooth_turned < turned / 100


def test_a_surface_of_second_order_is_met_where_it_is():
    """To the third order in its steepness: η is measured along normals, and heights are along z."""
    places = np.random.default_rng(1).uniform(-0.06, 0.06, (300, 2))
    errors = []
    for height in (2e-3, 1e-3):
        vertices, triangles = wavy(height=height)
        points = np.column_stack([places, paraboloid(*places.T, height)])
        found = met(points, vertices, triangles, rest=vertices)
        flat = met(points, vertices, triangles)
        errors.append(np.abs(found.gaps).max())
        assert len(found.row) == 300
        assert errors[-1] < 0.02 * np.abs(flat.gaps).max()
    assert errors[1] < errors[0] / 4


def test_nothing_jumps_where_a_point_passes_from_one_triangle_to_another():
    vertices, triangles = wavy(height=0.02)
    way = np.linspace(-0.07, 0.07, 4001)
    path = np.column_stack([way, 0.015 + 0.4 * way, np.zeros_like(way)])
    path[:, 2] = paraboloid(*path[:, :2].T, 0.02) + 1e-4
    jumps = []
    for rest in (None, vertices):
        found = met(path, vertices, triangles, rest=rest)
        assert len(found.row) == len(path)
        jumps.append([np.abs(np.diff(part, axis=0)).max() for part in (found.normals, found.gaps)])
    (turn, _), (smooth_turn, smooth_gap) = jumps
    assert turn > 0.05
    assert smooth_turn < 1e-3  # on 38 µm, and 34 µm that feet jump at edges that go in; normals turn by 5 per m
    assert smooth_gap < 1e-6


def test_creases_stay_sharp_and_flat_faces_keep_their_bits():
    """A box has a normal for each face at its corners, and is met as without any."""
    vertices, triangles = surface_of(Box((0.2, 0.3, 0.4)))
    bends = bends_of(vertices, triangles)
    assert sorted(np.unique(bends[:, 3:6])) == [SMOOTH, CREASE]
    assert bends[:, 6:].all()
    assert bends[:, :3].max() + 1 == 24
    points = np.random.default_rng(2).uniform(-0.25, 0.25, (400, 3))
    smooth, flat = (met(points, vertices, triangles, 0.05, rest) for rest in (vertices, None))
    assert len(flat.row) > 50
    for one, other in zip(smooth, flat, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(("degrees", "kind"), [(39.9, SMOOTH), (40.1, CREASE)])
def test_what_is_a_crease_is_told_at_rest(degrees, kind):
    """By the angle between two triangles, however they lie later."""
    turn = np.radians(degrees)
    vertices = np.array([[0.0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [np.cos(turn), 0.5, np.sin(turn)]])
    bends = bends_of(vertices, np.array([[0, 1, 2], [1, 0, 3]]))
    assert bends[:, 3:6].tolist() == [[BORDER, BORDER, kind], [BORDER, BORDER, kind]]
    together = bends[0, 0] == bends[1, 1] and bends[0, 1] == bends[1, 0]
    assert together == (kind == SMOOTH)
    assert bends[:, :3].max() + 1 == (4 if kind == SMOOTH else 6)
