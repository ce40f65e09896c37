"""Points nearest on triangles, and triangles among points."""

import numpy as np
from numpy import ndarray as Array

_NEXT = [1, 2, 0]  # the corner after each of a triangle


def nearest_on_triangles(points: Array, corners: Array) -> tuple[Array, Array]:
    """Where triangles (P, 3 corners, 3) are nearest to points (P, 3), m: weights (P, 3) of corners, places (P, 3)."""
    a = corners[:, 0]
    u, v, w = corners[:, 1] - a, corners[:, 2] - a, points - a
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    twice_area = np.maximum(uu * vv - uv * uv, np.finfo(float).tiny)
    of_b, of_c = (vv * uw - uv * vw) / twice_area, (uu * vw - uv * uw) / twice_area
    weights = np.stack([1 - of_b - of_c, of_b, of_c], axis=1)
    beyond = (weights.min(axis=1) < 0).nonzero()[0]  # of those, the nearest point is on an edge
    if len(beyond):
        weights[beyond] = _nearest_on_edges(points[beyond], corners[beyond])
    return weights, (weights[:, :, None] * corners).sum(axis=1)


def triangles_among(nodes: Array, triangles: Array) -> Array:
    """Those of triangles (t, 3) that lie among some nodes, as rows of these."""
    row = np.full(max(nodes.max(initial=-1), triangles.max(initial=-1)) + 1, -1)
    row[nodes] = np.arange(len(nodes))
    among = row[triangles]
    return among[(among >= 0).all(axis=1)]


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
