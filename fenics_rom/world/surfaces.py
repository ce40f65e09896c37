"""A surface of a soft body as joints hold it: at each of its nodes, at points that these carry, or as a whole.

How a whole surface moves and turns is in mechanics/surface_points.py.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import crossed
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.world.bodies import Points

FLAT = 1e-6  # of its size: a surface that reaches no farther along an axis does not reach along it
CORNERS = np.array([[-1.0, -0.5], [1.0, -0.5], [0.0, 1.0]])  # of a triangle about a surface's middle
RIGID = 1e-9  # of what a surface does: as much may be no rigid motion of one that is called rigid


class HeldSurface(NamedTuple):
    """What joints hold of a surface of n nodes, at j points."""

    places: Array  # (j, 3), m
    nodes: Array  # (j, c) of the surface
    weights: Array  # (j, c) of these
    couples: Array  # (any,) which of the points stand for how the surface turns
    gap: float  # how far a point is off its place at most, m


def hold_surface(
    kind: str, axis: Array | None, places: Array, triangles: Array, whole: bool, yields: bool
) -> HeldSurface:
    """What a joint holds of a surface.

    A weld holds each node where each yields by itself, else how the surface moves, turns and stretches in the mean, as
    the few shapes of a basis cannot leave every node where it is. A rigid surface it holds as a whole. A ball joint
    holds its mean place, a hinge two points of an axis there, as far apart as the surface reaches.

    Args:
        kind, axis: as of a SurfaceJoint.
        places, triangles: of the nodes (n, 3), m, and between these (t, 3).
        whole: whether a weld holds it as a whole.
        yields: whether each node yields by itself.
    """
    everyone, none = np.arange(len(places)), np.empty(0, dtype=int)
    shares = area_shares(places, triangles)
    middle = shares @ places
    if kind == "weld" and not whole:
        _, reach, axes = np.linalg.svd(places - middle, full_matrices=False)
        if yields or reach[1] <= FLAT * reach[0]:
            return HeldSurface(places, everyone[:, None], np.ones((len(places), 1)), none, 0.0)
        return _carried_points(places, shares, middle + reach[:2] / np.sqrt(len(places)) * CORNERS @ axes[:2])
    if kind == "weld":
        return HeldSurface(np.array([middle] * 2), np.array([everyone] * 2), np.array([shares] * 2), np.array([1]), 0.0)
    if kind == "ball":
        return HeldSurface(middle[None], everyone[None], shares[None], none, 0.0)
    assert axis is not None
    along = axis / np.linalg.norm(axis)
    size = np.abs(places - middle).max()
    reach = np.abs((places - middle) @ along).max()
    reach = reach if reach > FLAT * size else size  # of an axis across it, to which it does not reach
    return _carried_points(places, shares, middle + reach * np.array([[-1.0], [1.0]]) * along)


def _carried_points(places: Array, shares: Array, points: Array) -> HeldSurface:
    """Points (j, 3) that all nodes carry."""
    weights, gaps = zip(*(carried(places, shares, point) for point in points), strict=True)
    nodes = np.tile(np.arange(len(places)), (len(points), 1))
    return HeldSurface(points, nodes, np.array(weights), np.empty(0, dtype=int), max(gaps))


def area_shares(places: Array, triangles: Array) -> Array:
    """Of a surface's area at each of its points (n, 3), (n,); of points that no triangle (t, 3) has alike."""
    a, b, c = np.moveaxis(places[triangles], 1, 0)
    areas = np.zeros(len(places))
    np.add.at(areas, triangles, np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None])
    areas = areas if areas.all() else np.ones(len(places))
    return areas / areas.sum()


def carried(places: Array, shares: Array, point: Array) -> tuple[Array, float]:
    """Weights (n,) with which nodes (n, 3) carry a point as they are displaced alike, and how far it is off, m.

    Of all with Σ w = 1 and Σ w x = point those that spread a force most evenly over the surface.
    """
    arms = places - shares @ places
    moments = np.concatenate([np.ones((len(arms), 1)), arms / np.abs(arms).max()], axis=1)
    wanted = np.concatenate([[1.0], (point - shares @ places) / np.abs(arms).max()])
    weights = shares * (moments @ np.linalg.lstsq(moments.T @ (shares[:, None] * moments), wanted, rcond=1e-12)[0])
    return weights, float(np.linalg.norm(weights @ places - point))


def is_rigid(places: Array, rows: Array) -> bool:
    """Whether nodes at rest (n, 3) that move by rows (n, 3, k) of coordinates move as a rigid body does."""
    arms = places - places.mean(axis=0)
    motions = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), crossed(arms)], axis=2).reshape(-1, 6)
    moved = rows.reshape(len(motions), -1)
    left = moved - motions @ np.linalg.lstsq(motions, moved, rcond=None)[0]
    return len(arms) > 2 and bool(np.abs(left).max() <= RIGID * np.abs(moved).max())


def nearest_carriers(places: Array, own: Array, triangles: Array, near: float) -> tuple[Array, Array, Array]:
    """Which of a surface's points (P, 3) carry places (j, 3): one that is so near, or else the nearest triangle's.

    Returns:
        Three points (j, 3) each with their weights (j, 3), and how far away the places are, (j,), m.
    """
    apart = np.linalg.norm(places[:, None] - own, axis=2)
    nearest, gaps = apart.argmin(axis=1), apart.min(axis=1)
    nodes, weights = np.repeat(nearest[:, None], 3, axis=1), np.tile((1.0, 0.0, 0.0), (len(places), 1))
    for row in (gaps > near).nonzero()[0] if len(triangles) else ():
        shares, there = nearest_on_triangles(np.broadcast_to(places[row], (len(triangles), 3)), own[triangles])
        off = np.linalg.norm(there - places[row], axis=1)
        triangle = off.argmin()
        nodes[row], weights[row], gaps[row] = triangles[triangle], shares[triangle], off[triangle]
    return nodes, weights, gaps


def soft_points(nodes: Array, weights: Array) -> Points:
    """Of joints at points (j, 3) of a soft body that contact points (j, c) carry."""
    return Points(nodes, weights, np.zeros((len(nodes), 3)), np.zeros(len(nodes), bool))
