"""A shape on a half-space: its corners, or the points of its round sides that are deepest."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.world.collision.contacts import Contacts, PlacedShape, no_contacts, rigid_contacts
from fenics_rom.world.collision.manifold import thinned
from fenics_rom.world.shapes import Capsule, Cylinder, HalfSpace, Polytope, Shape, Sphere

_UPRIGHT = 1e-9  # sine of the tilt of a cylinder below which no point of its rim is the deepest
_QUARTERS = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])


def contacts_on_ground(first: PlacedShape, ground: PlacedShape, margin: float) -> Contacts:
    """Pairs of a shape and a half-space that are nearer than a margin, m."""
    normal = ground.rotation[:, 2]
    if float((first.position - ground.position).dot(normal)) > first.shape.radius_around + margin:
        return no_contacts()
    local, radius, feature = _lowest(first.shape, first.rotation.T.dot(normal))
    places = local.dot(first.rotation.T) + first.position - radius * normal
    gaps = (places - ground.position).dot(normal)
    near = np.flatnonzero(gaps <= margin)
    near = near[thinned(places[near], gaps[near], normal)] if len(near) else near
    places = places[near] - gaps[near, None] / 2 * normal
    return rigid_contacts(places, np.tile(normal, (len(near), 1)), gaps[near], feature[near])


def _lowest(shape: Shape, up: Array) -> tuple[Array, float, Array]:
    """Points (k, 3) of a shape, in its axes, that may touch, the radius around them, their numbers; up: the normal."""
    if isinstance(shape, Polytope):
        return shape.vertices, 0.0, np.arange(len(shape.vertices))
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), shape.radius, np.zeros(1, dtype=int)
    if isinstance(shape, Capsule):
        return np.array([[0, 0, -shape.length / 2], [0, 0, shape.length / 2]]), shape.radius, np.arange(2)
    if isinstance(shape, Cylinder):
        half = np.array([0, 0, shape.length / 2])
        rims = np.concatenate([shape.radius * _QUARTERS - half, shape.radius * _QUARTERS + half])
        tilt = np.hypot(up[0], up[1])
        if tilt < _UPRIGHT:
            return rims, 0.0, np.arange(8)
        deepest = -shape.radius / tilt * np.array([up[0], up[1], 0.0])
        return np.concatenate([[deepest - half, deepest + half], rims]), 0.0, np.append([8, 9], np.arange(8))
    assert isinstance(shape, HalfSpace)
    raise SceneError("half-space: use one beside anything but another (got two)")
