"""Surfaces of triangles with rounded edges: shares of a disc, heights at an edge, rates of gaps, and no jumps."""

import numpy as np
import pytest

from fenics_rom.mechanics.placed_surface import PlacedSurface, points_near
from fenics_rom.mechanics.rounded_surface import in_disc, rounding_of
from fenics_rom.world.shapes import Box

SIDE = 0.025  # of a cell, m


def wavy(height, cells=8):
    """A patch z = f(x, y), f of second order, and its triangles."""
    axis = SIDE * (np.arange(cells + 1) - cells / 2)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    rows = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = rows[:-1, :-1].ravel(), rows[1:, :-1].ravel(), rows[1:, 1:].ravel(), rows[:-1, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x, y, paraboloid(x, y, height)], axis=1), triangles


def paraboloid(x, y, height):
    return height * ((x / 0.1) ** 2 - 0.4 * (y / 0.1) ** 2 + 0.5 * x * y / 0.01)


def met(points, vertices, triangles, rounding, margin=1e-3):
    """What points meet of a surface with edges that are rounded, or not (None)."""
    first = PlacedSurface(points, np.empty((0, 3), dtype=int), np.arange(len(points)))
    second = PlacedSurface(vertices, triangles, np.empty(0, dtype=int), rounding=rounding)
    return points_near(first, second, margin)


def test_triangles_around_the_centre_share_the_disc():
    """A quarter has 1/4 and (1, 1)/3π; those that cover it all have 1, and their moments cancel."""
    share, moment = in_disc(np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]))
    assert share == pytest.approx(1 / 4, abs=1e-15)
    np.testing.assert_allclose(moment, 1 / (3 * np.pi), rtol=1e-14)
    angles = np.sort(np.random.default_rng(0).uniform(0, 2 * np.pi, 9))
    radii = np.random.default_rng(1).uniform(0.3, 2.0, 9)  # corners within the disc and out of it
    rim = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    out = 9.0 * rim / radii[:, None]  # and from there beyond it
    after, beyond = np.roll(rim, -1, axis=0), np.roll(out, -1, axis=0)
    centre = np.full_like(rim, 0.05)
    parts = [[centre, rim, after], [rim, out, beyond], [rim, beyond, after]]
    shares, moments = in_disc(np.concatenate([np.stack(part, axis=1) for part in parts]))
    assert shares.sum() == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(moments.sum(axis=0), 0, atol=1e-14)


@pytest.mark.parametrize("degrees", [-30, 3, 30])
def test_an_edge_is_rounded_by_the_mean_of_the_disc(degrees):
    """Over a half of the disc the other triangle is off the plane by d tan α, d = 2 r / 3 π in the mean of the disc."""
    bend = np.tan(np.radians(degrees))
    vertices = np.array([[0.0, -1, 0], [0, 1, 0], [-1, 0, 0], [1.0, 0, -bend]])
    triangles = np.array([[0, 1, 2], [1, 0, 3]])
    rounding = rounding_of(vertices, triangles)
    r = rounding.radii[:2].mean()
    height = np.copysign(1e-7, degrees)  # so that it is nearest to the flat one
    found = met(np.array([[-1e-9, 0.1, height]]), vertices, triangles, rounding)
    slope = bend / 2
    np.testing.assert_allclose(found.normals, [np.array([slope, 0, 1]) / np.hypot(slope, 1)], atol=1e-6)
    assert found.gaps[0] == pytest.approx((2 * r / (3 * np.pi) * bend + height) / np.hypot(slope, 1), abs=1e-6 * r)
    assert found.weights.sum() == pytest.approx(1, abs=1e-14)


def test_the_rate_of_a_gap_is_that_of_its_row():
    """All nodes that a gap depends on are in its row: what is left as the surface bends is of third order in angles."""
    random, errors = np.random.default_rng(2), []
    places = random.uniform(-0.06, 0.06, (300, 2))
    v, sway = random.uniform(-1, 1, (300, 3)), random.uniform(-1, 1, 81)
    for height in (8e-3, 4e-3):
        vertices, triangles = wavy(height)
        rounding, slope = rounding_of(vertices, triangles), height / 0.1
        points = np.column_stack([places, paraboloid(*places.T, height)])
        points = met(points, vertices, triangles, rounding).places
        speeds = np.column_stack([v[:, :2], slope * v[:, 2]])
        moves = np.column_stack([0 * sway, 0 * sway, slope * sway])
        first, last = (
            met(points + sign * 1e-7 * speeds, vertices + sign * 1e-7 * moves, triangles, rounding) for sign in (-1, 1)
        )
        here = met(points, vertices, triangles, rounding)
        assert len(first.row) == len(last.row) == len(here.row) == 300
        row = speeds - (here.weights[:, :, None] * moves[here.nodes]).sum(axis=1)
        rates = (last.gaps - first.gaps) / 2e-7
        errors.append(np.abs(rates - (row * here.normals).sum(axis=1)).max())
        flat = met(points, vertices, triangles, None)
        beside = speeds - (flat.weights[:, :, None] * moves[flat.nodes]).sum(axis=1)
        assert errors[-1] < 0.1 * np.abs(rates - (beside * flat.normals).sum(axis=1)).max()
    assert errors[1] < errors[0] / 5


def test_nothing_jumps_where_a_point_passes_from_one_triangle_to_another():
    vertices, triangles = wavy(0.02)
    way = np.linspace(-0.07, 0.07, 4001)
    path = np.column_stack([way, 0.015 + 0.4 * way, np.zeros_like(way)])
    path[:, 2] = paraboloid(*path[:, :2].T, 0.02)
    turns, gaps = [], []
    rounding = rounding_of(vertices, triangles)
    for each in (rounding, None):
        found = met(path, vertices, triangles, each)
        assert len(found.row) == len(path)
        turns.append(np.abs(np.diff(found.normals, axis=0)).max())
        gaps.append(np.abs(np.diff(found.gaps)).max())
    step = np.linalg.norm(path[1] - path[0])
    assert turns[1] > 0.05
    assert turns[0] < 3 * turns[1] * step / rounding.radii.min()  # 2/π of the whole turn by r at the middle of an edge
    assert gaps[0] < 2 * gaps[1]


def test_creases_stay_sharp():
    """A box is met as it is: its faces are flat, and its edges are none that are rounded."""
    vertices, triangles = Box((0.2, 0.3, 0.4)).surface()
    vertices, first = np.unique(np.round(vertices, 12), axis=0, return_inverse=True)
    triangles = first.reshape(-1)[triangles]
    points = np.random.default_rng(3).uniform(-0.25, 0.25, (400, 3))
    round_, flat = (met(points, vertices, triangles, each, 0.05) for each in (rounding_of(vertices, triangles), None))
    assert len(flat.row) > 50
    np.testing.assert_array_equal(round_.row, flat.row)
    clear = np.abs(np.abs(flat.normals).max(axis=1) - 1) < 1e-9  # over a face
    assert clear.sum() > 20
    for one, other in ((round_.gaps, flat.gaps), (round_.normals, flat.normals), (round_.places, flat.places)):
        np.testing.assert_allclose(one[clear], other[clear], atol=1e-12)
