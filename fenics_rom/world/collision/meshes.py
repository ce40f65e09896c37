"""Meshes that stand still or are driven, and rigid bodies: by the points of these, and the mesh's own corners."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.world.collision.contacts import Contacts, PlacedShape, joined, rigid_contacts
from fenics_rom.world.shapes import Capsule, Cylinder, Mesh, Polytope, Shape, Sphere

PARTS = 4  # of a capsule's axis, between the balls that stand for it


def mesh_contacts(first: PlacedShape, second: PlacedShape, margin: float) -> Contacts:
    """Points of a shape that are nearer to a mesh, the second, than a margin, m, and its corners near flat shapes.

    Edges of both that cross are not looked for.
    """
    points, radius = _points_of(first.shape)
    placed = first.position + points.dot(first.rotation.T)
    row, gaps, normals, feature = second.planes_near(placed, margin + radius)
    gaps = gaps - radius
    places = placed[row] - (radius + gaps / 2)[:, None] * normals
    contacts = rigid_contacts(places, normals, gaps, row + len(points) * feature)
    shape = second.shape
    assert isinstance(shape, Mesh)
    corners = second.position + shape.sharp_corners.dot(second.rotation.T)
    if isinstance(first.shape, Sphere | Capsule) or not len(corners):
        return contacts
    number, gaps, normals, _ = first.planes_near(corners, margin)
    places = corners[number] - gaps[:, None] / 2 * normals
    return joined([contacts, rigid_contacts(places, -normals, gaps, -1 - number)])


def _points_of(shape: Shape) -> tuple[Array, float]:
    """Points (k, 3), m, in a shape's axes, and the radius of the balls around them that stand for it, m."""
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), shape.radius
    if isinstance(shape, Capsule):
        along = np.linspace(-shape.length / 2, shape.length / 2, PARTS + 1)
        return np.stack([0 * along, 0 * along, along], axis=1), shape.radius
    flat = shape.prism if isinstance(shape, Cylinder) else shape
    assert isinstance(flat, Polytope)
    return flat.vertices, 0.0
