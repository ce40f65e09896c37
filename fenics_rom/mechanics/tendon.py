"""A cable through points, without friction: its tension pulls at each end, and at each guide both ways."""

import numpy as np

Array = np.ndarray


def pieces_of(points: Array) -> tuple[Array, Array]:
    """Pieces (K - 1, 3) between points (K, 3) that follow one another, and their lengths (K - 1, 1), m."""
    pieces = np.diff(points, axis=0)
    return pieces, np.sqrt(np.einsum("ki,ki->k", pieces, pieces))[:, None]


def ends_of(pulls: Array) -> Array:
    """Forces (K, 3) on the points, of which each piece pulls its two ends towards one another by `pulls` (K - 1, 3)."""
    forces = np.zeros((len(pulls) + 1, 3))
    forces[:-1] += pulls
    forces[1:] -= pulls
    return forces


def pulls_of(points: Array) -> Array:
    """Forces (K, 3) of a tension of 1 N on the points (K, 3): -∂ℓ/∂points of the length ℓ."""
    pieces, lengths = pieces_of(points)
    return ends_of(pieces / lengths)
