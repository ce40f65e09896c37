"""Gravity's direction as two angles, which a camera or a table that is not quite level leaves unknown.

Gravity is turned about the two axes of the scene that it is not nearest to, first about one and then about the other.
"""

import numpy as np
from numpy import ndarray as Array


def tilt_axes(acceleration: Array) -> list[int]:
    """The two axes of the scene that gravity is turned about."""
    return [axis for axis in range(3) if axis != np.abs(acceleration).argmax()]


def tilted(acceleration: Array, tilt: Array) -> Array:
    """Gravity (3,) turned by two angles (2,), degrees."""
    for axis, angle in zip(tilt_axes(acceleration), np.radians(tilt), strict=True):
        acceleration = _rotation(axis, angle) @ acceleration
    return acceleration


def tilted_slope(acceleration: Array, tilt: Array, change: Array) -> Array:
    """Its derivative (3,) in a direction of the angles (2,), degrees."""
    (first, second), (α, β), (dα, dβ) = tilt_axes(acceleration), np.radians(tilt), np.radians(change)
    once = _rotation(first, α) @ acceleration
    along = dα * np.cross(np.eye(3)[first], once)
    slope: Array = _rotation(second, β) @ (along + dβ * np.cross(np.eye(3)[second], once))
    return slope


def _rotation(axis: int, angle: float) -> Array:
    """About an axis of the scene, (3, 3): 1 + sin φ [e] + (1 - cos φ) [e]²."""
    cross = np.cross(np.eye(3)[axis], np.eye(3)).T
    rotation: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation
