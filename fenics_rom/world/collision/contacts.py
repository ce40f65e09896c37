"""What is known of two bodies that may touch, and what is found."""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import rotation_vectors
from fenics_rom.mechanics.frame_motion import quaternion_of, quaternion_of_vector, rotation_matrix
from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.mechanics.triangle_surface import NearPlanes
from fenics_rom.world.shapes import Mesh, Shape

_NO_NODES, _NO_WEIGHTS = np.zeros((1 << 16, 0), dtype=int), np.zeros((1 << 16, 0))


class PlacedShape(NamedTuple):
    """A rigid body as it lies; it may get into a soft one, as an Intruder."""

    shape: Shape
    position: Array  # of its centre of mass, (3,), m
    rotation: Array  # (3, 3): world axes of its own

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Distances (P,), m, and normals (P, 3) at points (P, 3), m, in world axes."""
        gaps, normals = self.shape.distance((points - self.position).dot(self.rotation))
        return gaps, normals.dot(self.rotation.T)

    def planes_near(self, points: Array, reach: float) -> NearPlanes:
        """Planes that ways from points (P, 3), m, in world axes may go through which are no longer than a reach, m."""
        local = (points - self.position).dot(self.rotation)
        if isinstance(self.shape, Mesh):
            found = self.shape.planes_near(local, reach)
            return found._replace(normals=found.normals.dot(self.rotation.T))
        gaps, normals = self.shape.distance(local)
        near = (gaps <= reach).nonzero()[0]
        return NearPlanes(near, gaps[near], normals[near].dot(self.rotation.T), np.zeros(len(near), dtype=int))

    @property
    def core(self) -> tuple[float, Array]:
        """As of an Intruder."""
        radius, centres = self.shape.core
        return radius, self.position + centres.dot(self.rotation.T)

    def after(self, before: "PlacedShape", share: float) -> "PlacedShape":
        """As of an Intruder."""
        turn = share * rotation_vectors(quaternion_of(self.rotation @ before.rotation.T)[None])[0]
        position = before.position + share * (self.position - before.position)
        return PlacedShape(self.shape, position, rotation_matrix(quaternion_of_vector(turn)) @ before.rotation)

    def moved(self, before: "PlacedShape") -> float:
        """As of an Intruder."""
        moved, turned = math.dist(self.position, before.position), (self.rotation - before.rotation).ravel()
        if turned.any() and math.isfinite(self.shape.radius_around):
            moved += math.sqrt(turned.dot(turned)) * self.shape.radius_around
        return moved


Placed = PlacedShape | PlacedSurface


class Spots(NamedTuple):
    """Where k contacts are on a body."""

    arms: Array  # (k, 3), places in world axes, m; of two rigid bodies both have the place half way between
    nodes: Array  # (k, 3) rows of a soft body's points; (k, 0) of a rigid one
    weights: Array  # theirs in the place, of the same shape
    feature: Array  # (k,): the same contact has the same number from step to step


class Contacts(NamedTuple):
    """Pairs of points of two bodies that touch or are near."""

    first: Spots
    second: Spots
    normals: Array  # (k, 3) units in world axes, from the second to the first
    gaps: Array  # (k,), m; < 0 where they are in one another

    @property
    def mirrored(self) -> "Contacts":
        """The same with first and second exchanged."""
        return Contacts(self.second, self.first, -self.normals, self.gaps)


def joined(parts: list[Contacts]) -> Contacts:
    """Several contacts of the same two bodies, of the same kinds, as one."""
    if len(parts) == 1:
        return parts[0]
    first, second = _spots([part.first for part in parts]), _spots([part.second for part in parts])
    return Contacts(first, second, *(np.concatenate([part[k] for part in parts]) for k in (2, 3)))


def _spots(parts: list[Spots]) -> Spots:
    wide = max(part.nodes.shape[1] for part in parts)
    carried = [widened(part.nodes, part.weights, wide) for part in parts]
    nodes, weights = map(np.concatenate, zip(*carried, strict=True))
    arms, feature = (np.concatenate([part[k] for part in parts]) for k in (0, 3))
    return Spots(arms, nodes, weights, feature)


def widened(nodes: Array, weights: Array, wide: int) -> tuple[Array, Array]:
    """Nodes and weights (k, c) with so many to a point, some of them without weight."""
    more = ((0, 0), (0, wide - nodes.shape[1]))
    if not more[1][1]:
        return nodes, weights
    return np.pad(nodes, more, mode="edge"), np.pad(weights, more)


def rigid_contacts(places: Array, normals: Array, gaps: Array, feature: Array) -> Contacts:
    """Contacts of two rigid bodies at places (k, 3) half way between their surfaces."""
    spots = Spots(places, _NO_NODES[: len(gaps)], _NO_WEIGHTS[: len(gaps)], feature)
    return Contacts(spots, spots, normals, gaps)


def no_contacts() -> Contacts:
    """Of two rigid bodies that are far from one another."""
    return rigid_contacts(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=int))
