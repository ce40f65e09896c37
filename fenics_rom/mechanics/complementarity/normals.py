"""Unit normals of many contact pairs: of each its own, or one axis for all, as on flat ground in axes of its own.

Arrays hold axes, points and bodies last, (..., 3, P, B); normals that are None are the last of the axes.
"""

import numpy as np
from numpy import ndarray as Array

NORMAL = 2  # which of the axes is the normal of all pairs, where normals are None


def along(vectors: Array, normals: Array | None) -> Array:
    """Scalar products (..., P, B) of vectors (..., 3, P, B) and normals; a view of the vectors where these are None."""
    if normals is None:
        return vectors[..., NORMAL, :, :]
    product = vectors * normals
    parts: Array = product[..., 0, :, :] + product[..., 1, :, :]
    parts += product[..., 2, :, :]
    return parts


def subtract_along(vectors: Array, lengths: Array, normals: Array | None) -> None:
    """Takes lengths (..., P, B) along the normals out of vectors (..., 3, P, B)."""
    if normals is None:
        vectors[..., NORMAL, :, :] -= lengths
    else:
        vectors -= lengths[..., None, :, :] * normals


def written_out(normals: Array | None, shape: tuple[int, ...]) -> Array:
    """Normals of a shape (3, P, B)."""
    if normals is not None:
        return normals
    axis = np.zeros((3, 1, 1))
    axis[NORMAL] = 1.0
    return np.broadcast_to(axis, shape)
