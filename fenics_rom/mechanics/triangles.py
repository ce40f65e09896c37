"""Points nearest on triangles, and triangles among points."""

import numpy as np
from numpy import ndarray as Array

_NEXT = [1, 2, 0]  # the corner after each of a triangle


def nearest_on_triangles(points: Array, corners: Array) -> tuple[Array, Array]:
    """Where triangles (P, 3 corners, 3) are nearest to points (P, 3), m: weights (P, 3) of corners, places (P, 3)."""
    weights = weights_in_planes(points, corners)
    beyond = (weights.min(axis=1) < 0).nonzero()[0]  # of those, the nearest point is on an edge
    if len(beyond):
        weights[beyond] = _nearest_on_edges(points[beyond], corners[beyond])
    return weights, (weights[:, :, None] * corners).sum(axis=1)


def weights_in_planes(points: Array, corners: Array) -> Array:
    """Weights (P, 3) of corners in the feet of points (P, 3) on the planes of triangles (P, 3 corners, 3), m."""
    a = corners[:, 0]
    u, v, w = corners[:, 1] - a, corners[:, 2] - a, points - a
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    twice_area = np.maximum(uu * vv - uv * uv, np.finfo(float).tiny)
    of_b, of_c = (vv * uw - uv * vw) / twice_area, (uu * vw - uv * uw) / twice_area
    weights: Array = np.stack([1 - of_b - of_c, of_b, of_c], axis=1)
    return weights


def triangles_among(nodes: Array, triangles: Array) -> Array:
    """Those of triangles (t, 3) that lie among some nodes, as rows of these."""
    row = np.full(max(nodes.max(initial=-1), triangles.max(initial=-1)) + 1, -1)
    row[nodes] = np.arange(len(nodes))
    among = row[triangles]
    return among[(among >= 0).all(axis=1)]


def covering_radius(corners: Array) -> Array:
    """Largest distance from a point of triangles (F, 3, 3) to the nearest of their corners, (F,), m.

    Of one without an obtuse angle the radius of the circle through its corners; of the others the farthest point is on
    the longest side.
    """
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    a, b, c = np.sort(sides, axis=1).T
    cosines = [(b**2 + c**2 - a**2) / (2 * b * c), (a**2 + c**2 - b**2) / (2 * a * c)]  # of the angles at the ends of c
    on_longest = np.maximum(b / (2 * cosines[0]), a / (2 * cosines[1]))
    sine = np.sqrt(np.maximum(1 - cosines[0] ** 2, 0.0))
    with np.errstate(divide="ignore"):
        circle = a / (2 * sine)
    return np.where(a**2 + b**2 < c**2, on_longest, circle)


def _nearest_on_edges(points: Array, corners: Array) -> Array:
    """Weights (P, 3) of the nearest points on the edges of triangles."""
    along = corners[:, _NEXT] - corners  # from each corner to the next
    squares = np.maximum(_dot(along, along), np.finfo(float).tiny)
    share = np.minimum(np.maximum(_dot(points[:, None] - corners, along) / squares, 0.0), 1.0)
    offsets = corners + share[:, :, None] * along - points[:, None]
    rows, edge = np.arange(len(points)), _dot(offsets, offsets).argmin(axis=1)
    weights = np.zeros((len(points), 3))
    weights[rows, edge] = 1 - share[rows, edge]
    weights[rows, (edge + 1) % 3] = share[rows, edge]
    return weights


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...k,...k->...", a, b)
