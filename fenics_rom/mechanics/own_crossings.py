"""Where points of a surface would go through its own triangles in a step, as both move on straight ways.

A point is on the plane of a triangle with corners a, b and c where (x - a)·((b - a) × (c - a)) = 0, a polynomial of
third degree in time. Of its roots those count at which the point comes from before the triangle, and is on it.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.surface_pairs import OPPOSITE, Boxes, near_boxes, unit_normals
from fenics_rom.mechanics.triangles import weights_in_planes

_TIMES = np.array([0.0, 1 / 3, 2 / 3, 1.0])  # at which the polynomial is known
_POLYNOMIAL = np.linalg.inv(np.vander(_TIMES))  # what makes its coefficients of these, highest power first
_BESIDE = 1e-9  # of a weight: what is less beside a triangle is on it
_MANY = 1 << 17  # pairs of a point and a triangle that are looked at together
_ONES = np.ones(3)


class Crossings(NamedTuple):
    """Where k points go through triangles first."""

    row: Array  # (k,) of the points
    triangle: Array  # (k,)
    weights: Array  # (k, 3) of its corners there
    normals: Array  # (k, 3) of the triangle then
    times: Array  # (k,) in [0, 1] of the step

    def of(self, some: Array) -> "Crossings":
        """Some of them."""
        return Crossings(*(part[some] for part in self))


def find_crossings(points: Array, ways: Array, touching: Array, triangles: Array, left_out: Array) -> Crossings:
    """The first crossing of each point that goes through a triangle; of two that go through one another one has it.

    Args:
        points, ways: where all points are (n, 3), and go in the step, m.
        touching: rows of those that may touch.
        triangles: (t, 3) rows of points.
        left_out: sorted keys of points and triangles that do not touch, row times t plus triangle.
    """
    ends = points + ways
    low = np.minimum(points[triangles], ends[triangles]).min(axis=1)
    high = np.maximum(points[triangles], ends[triangles]).max(axis=1)
    half = np.abs(ways[touching]).max(initial=0.0) / 2
    boxes = Boxes(low - half, high + half, float((high - low).max(initial=0.0)) + 2 * half)
    row, triangle = near_boxes((points + ends)[touching] / 2, boxes)
    row = touching[row]
    keys = row * len(triangles) + triangle
    at = np.minimum(np.searchsorted(left_out, keys), max(len(left_out) - 1, 0))
    may = left_out[at] != keys if len(left_out) else np.ones(len(keys), bool)
    row, triangle = row[may], triangle[may]
    parts = [
        _crossings(points, ways, row[some : some + _MANY], triangle[some : some + _MANY], triangles)
        for some in range(0, max(len(row), 1), _MANY)
    ]
    found = Crossings(*map(np.concatenate, zip(*parts, strict=True)))
    found = found.of(np.lexsort((found.times, found.row)))
    found = found.of(np.unique(found.row, return_index=True)[1])
    corner = np.take_along_axis(triangles[found.triangle], found.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    opposite = np.full(len(points), -1)
    is_at = found.weights.max(axis=1, initial=0.0) > OPPOSITE
    opposite[found.row[is_at]] = corner[is_at]
    has_twin = is_at & (opposite[corner] == found.row) & (corner < found.row)
    return found.of(~has_twin)


def _crossings(points: Array, ways: Array, row: Array, triangle: Array, triangles: Array) -> Crossings:
    """Of pairs of a point and a triangle (k,) those that cross, as often as they do."""
    nodes = triangles[triangle]
    above = np.stack([_above(points[row] + t * ways[row], points[nodes] + t * ways[nodes]) for t in _TIMES])
    some = ((above > 0).any(axis=0) & (above < 0).any(axis=0)).nonzero()[0]
    row, triangle, nodes, above = row[some], triangle[some], nodes[some], above[:, some]
    coefficients = _POLYNOMIAL @ above
    found = []
    for k, of_pair in enumerate(coefficients.T):
        roots = np.roots(np.where(np.abs(of_pair) < 1e-14 * np.abs(above[:, k]).max(), 0.0, of_pair))
        for t in np.sort(roots[np.abs(roots.imag) < 1e-9].real):
            if 0 <= t <= 1 and np.polyval(np.polyder(of_pair), t) < 0:
                found.append((k, t))
    at, times = (np.array(part) for part in zip(*found, strict=True)) if found else (np.empty(0, int), np.empty(0))
    there, corners = (points[of[at]] + _of(times, of[at].ndim) * ways[of[at]] for of in (row, nodes))
    weights, normals = weights_in_planes(there, corners), unit_normals(corners)
    on = (weights >= -_BESIDE).all(axis=1)
    return Crossings(row[at][on], triangle[at][on], weights[on], normals[on], times[on])


def _of(times: Array, dimensions: int) -> Array:
    return times.reshape(-1, *(1,) * dimensions)


def _above(point: Array, corners: Array) -> Array:
    """Six times the volume of what points (k, 3) span with triangles (k, 3, 3), > 0 before these."""
    a, b, c = np.moveaxis(corners, 1, 0)
    volume: Array = ((point - a) * np.cross(b - a, c - a)).dot(_ONES)
    return volume
