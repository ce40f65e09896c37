"""What obstacles are made of: their parameters, checked, and directions with their derivatives."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import GREATEST, SMALLEST, is_number
from fenics_rom.errors import SceneError, shown
from fenics_rom.mechanics.signals import real_numbers_or_nan

_ONES = np.ones(3)
SHORTEST_DIRECTION = 1e-150  # m; shorter vectors have squares that underflow and no direction


def normalised(vectors: Array, fallback: Array) -> tuple[Array, Array]:
    """Lengths (P,) and directions (P, 3); where there is no direction, `fallback`."""
    length = np.sqrt((vectors * vectors).dot(_ONES))
    if len(length) and not length.item(length.argmin()) > SHORTEST_DIRECTION:
        short = ~(length > SHORTEST_DIRECTION)
        directions = vectors / np.where(short, 1.0, length)[:, None]
        directions[short] = fallback
        return length, directions
    return length, vectors / length[:, None]


def turning_of(vectors: Array, across: Array) -> Array:
    """What directions of vectors (P, 3) change by, (P, 3, 3), where `across` (P, 3, 3) is what the vectors do.

    Nothing where there is no direction.
    """
    length, n = normalised(vectors, np.zeros(3))
    turning: Array = (across - n[:, :, None] * n[:, None, :]) / np.where(length > 0, length, np.inf)[:, None, None]
    return turning


def rotation_matrix_of(vector: Array) -> Array:
    """The matrix (3, 3) that turns by |vector| about it: I + sin θ X + (1 - cos θ) X²."""
    angle = math.hypot(*vector)
    if not angle > 0:
        return np.eye(3)
    x, y, z = vector / angle
    X = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * X + 2 * math.sin(angle / 2) ** 2 * X @ X


def check_vector(obstacle: object, name: str) -> Array:
    """An attribute as an array (3,); the attribute itself becomes a tuple, so that obstacles compare by value."""
    value = getattr(obstacle, name)
    vector = real_numbers_or_nan(value)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        kind = type(obstacle).__name__.lower()
        raise SceneError(f"{kind}: {name}: use three finite numbers (got {shown(value)})")
    keep(obstacle, **{name: tuple(vector.tolist())})
    return vector


def check_positive(obstacle: object, name: str) -> None:
    """Has an attribute be a float > 0, in m; SceneError of any other."""
    value = getattr(obstacle, name)
    if not (is_number(value) and SMALLEST <= value <= GREATEST):
        kind = type(obstacle).__name__.lower()
        raise SceneError(f"{kind}: {name}: use a finite number > 0, in m (got {shown(value)})")
    keep(obstacle, **{name: float(value)})


def keep(obstacle: object, **values: object) -> None:
    """Sets attributes of an obstacle, which is frozen."""
    for name, value in values.items():
        object.__setattr__(obstacle, name, value)
