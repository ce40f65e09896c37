"""Surfaces of soft bodies against rigid shapes, against one another, and against themselves."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, in_plain
from fenics_rom.mechanics.own_surface import OwnSurface
from fenics_rom.mechanics.placed_surface import PlacedSurface, points_near
from fenics_rom.mechanics.rounded_surface import NOT_ROUNDED
from fenics_rom.mechanics.surface_pairs import OnSurface
from fenics_rom.world.collision.contacts import Contacts, PlacedShape, Spots, joined
from fenics_rom.world.collision.soft_faces import edges_on_edges, faces_on_rigid

_ONES = np.ones(3)


def soft_on_rigid(first: PlacedSurface, second: PlacedShape, margin: float) -> Contacts:
    """The points of a surface that are nearer to a shape than a margin, m; and faces, where it has some."""
    points = first.points[first.touching]
    beside = points - second.position
    reach = second.shape.radius_around + margin
    beside *= beside
    row = (beside.dot(_ONES) <= reach * reach).nonzero()[0]
    near, gaps, normals, feature = second.planes_near(points[row], margin)
    kept = first.touching[row[near]]
    soft, none = _vertices(first, kept, len(first.points) * feature), np.zeros((len(kept), 0), dtype=int)
    contacts = Contacts(soft, Spots(soft.arms, none, none, soft.feature), normals, gaps)
    if first.faces is None:
        return contacts
    return joined([contacts, faces_on_rigid(first, first.faces, second, margin)])


def soft_on_soft(first: PlacedSurface, second: PlacedSurface, margin: float) -> Contacts:
    """The points of each of two surfaces that are nearer to the other than a margin, m; and sharp edges of both."""
    there, back = _points_on(first, second, margin, 0), _points_on(second, first, margin, len(first.points))
    edges = edges_on_edges(first, second, margin)
    return joined([there, back.mirrored, *([] if edges is None else [edges])])


def soft_on_itself(surface: PlacedSurface, own: OwnSurface, margin: float) -> Contacts:
    """The points of a surface that are nearer than a margin, m, to what they can touch of it."""
    return _contacts(surface, own.near(surface.points, margin), 0)


def _points_on(first: PlacedSurface, second: PlacedSurface, margin: float, numbers: int) -> Contacts:
    """Points of the first, each with what is nearest of the second.

    Args:
        first, second: two surfaces.
        margin: m, at most between them.
        numbers: what is added to the features of points.
    """
    find = _found_on if compiled() else points_near
    return _contacts(first, find(first, second, margin), numbers)


def _contacts(first: PlacedSurface, found: OnSurface, numbers: int) -> Contacts:
    foot = Spots(found.places, found.nodes, found.weights, found.row + numbers)
    return Contacts(_vertices(first, found.row, numbers), foot, found.normals, found.gaps)


def _found_on(first: PlacedSurface, second: PlacedSurface, margin: float) -> OnSurface:
    """As `points_near`, by compiled loops."""
    from fenics_rom.world.compiled.soft_collision import NONE, find_nearest  # here, as numba takes time to import

    points, P = first.points[first.touching], len(first.touching)
    rounding = second.rounding or NOT_ROUNDED
    c, triangles = rounding.nodes.shape[1], np.ascontiguousarray(second.triangles, dtype=np.int64)
    on, nodes, weights = np.empty(P, dtype=np.int64), np.empty((P, c), dtype=np.int64), np.empty((P, c))
    normals, gaps = np.empty((P, 3)), np.empty(P)
    radii, around_nodes, around = map(in_plain, rounding)
    surface = in_plain(second.points), in_plain(triangles), radii, around_nodes, around
    find_nearest(points, *surface, margin, on, nodes, weights, normals, gaps)
    found = (on != NONE).nonzero()[0]
    nodes, weights = nodes[found], weights[found]
    feet = (weights[:, :, None] * second.points[nodes]).sum(axis=1)
    return OnSurface(first.touching[found], nodes, weights, feet, normals[found], gaps[found])


def _vertices(surface: PlacedSurface, row: Array, numbers: int | Array) -> Spots:
    """Spots at points of a surface; numbers: what is added to their features."""
    weights = np.zeros((len(row), 3))
    weights[:, 0] = 1.0
    return Spots(surface.points[row], np.repeat(row[:, None], 3, axis=1), weights, row + numbers)
