"""Spheres and capsules against any shape, by its distance."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.world.collision.contacts import Contacts, PlacedShape, no_contacts, rigid_contacts
from fenics_rom.world.shapes import Capsule, Sphere

_LEVELS = np.array([-0.05, 0.0, 0.05])  # slopes of the distance along a capsule: between the outer two it lies on
_ENDS = np.array([-1e-3, 0.0, 1e-3])  # beside the slope of the middle
_PARTS = np.linspace(0.0, 1.0, 9)
_STAGES = 9  # each finds where among eight parts a slope is passed: to 1e-8 of the length
_ONE_PLACE = 0.25  # of the radius of a capsule: nearer to one another pairs are one


def round_contacts(first: PlacedShape, second: PlacedShape, margin: float) -> Contacts:
    """Pairs of a sphere or a capsule, and any shape, that are nearer than a margin, m."""
    shape = first.shape
    assert isinstance(shape, Sphere | Capsule)
    if isinstance(shape, Sphere):
        shares, line = np.zeros(1), np.zeros(3)
        start, feature = first.position, np.zeros(1, dtype=int)
    else:
        line = shape.length * first.rotation[:, 2]
        start = first.position - line / 2
        shares, feature = _touching_shares(second, start, line, shape.radius)
    centres = start + shares[:, None] * line
    gaps, normals = second.distance(centres)
    gaps = gaps - shape.radius
    near = gaps <= margin
    if not near.any():
        return no_contacts()
    places = centres - (shape.radius + gaps / 2)[:, None] * normals
    return rigid_contacts(places[near], normals[near], gaps[near], feature[near])


def _touching_shares(other: PlacedShape, start: Array, line: Array, radius: float) -> tuple[Array, Array]:
    """Where along a line another shape is nearest, and where it begins and ends to lie on it: shares, their numbers."""
    length = float(np.linalg.norm(line))
    shares = _passed(other, start, line, _LEVELS, np.zeros(3), np.ones(3))
    middle = (shares[0] + shares[2]) / 2
    _, normal = other.distance((start + middle * line)[None])
    slope = float(normal[0].dot(line)) / length
    if abs(slope) < _LEVELS[2]:  # it lies there, and ends to do so where the slope is another one, as beyond an edge
        ends = _passed(other, start, line, slope + _ENDS, np.full(3, shares[0]), np.full(3, shares[2]))
        shares = np.array([ends[0], shares[1], ends[2]])
    gaps, _ = other.distance(start + shares[:, None] * line)
    begin, nearest, end = shares
    if gaps[1] < min(gaps[0], gaps[2]) - 1e-6 * radius or (end - begin) * length < _ONE_PLACE * radius:
        apart = np.abs(shares - nearest) * length > _ONE_PLACE * radius
        kept = np.array([apart[0], True, apart[2]])
    else:
        kept = np.array([True, False, True])
    return shares[kept], np.flatnonzero(kept)


def _passed(other: PlacedShape, start: Array, line: Array, levels: Array, low: Array, high: Array) -> Array:
    """Shares (3,) of a line, between low and high ones, where the slope of the distance passes levels (3,).

    Distance to a convex shape is convex along the line, so that its slope grows: it is found by dividing.
    """
    length = float(np.linalg.norm(line))
    for _ in range(_STAGES):
        shares = low[:, None] + (high - low)[:, None] * _PARTS
        _, normals = other.distance(start + shares.reshape(-1, 1) * line)
        below = (normals.dot(line) / length).reshape(3, -1) < levels[:, None]
        passed = below.argmin(axis=1)  # the first that is not below
        passed[below.all(axis=1)] = len(_PARTS)
        rows = np.arange(3)
        low, high = (shares[rows, np.clip(k, 0, len(_PARTS) - 1)] for k in (passed - 1, passed))
    return (low + high) / 2
