"""A cable through points: its tension pulls at each end, and at each guide both ways.

Of a cable of length ℓ(x) under the tension T the force on the points is -T ∂ℓ/∂x, and what it supplies -T dℓ/dt.
"""

import numpy as np
from numpy import ndarray as Array


def measure_segments(points: Array) -> tuple[Array, Array]:
    """Segments (K - 1, 3) between points (K, 3) that follow one another, and their lengths (K - 1, 1), m."""
    segments = points[1:] - points[:-1]
    return segments, np.sqrt(np.einsum("ki,ki->k", segments, segments))[:, None]


def cable_length(points: Array) -> float:
    """Length of a cable through points (K, 3), m."""
    return float(measure_segments(points)[1].sum())


def turning_angles(points: Array) -> Array:
    """Angles (K - 2,), rad, by which a cable through points (K, 3) turns at each guide between its ends."""
    segments, lengths = measure_segments(points)
    one, other = (segments / lengths)[:-1], (segments / lengths)[1:]
    return np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.einsum("ki,ki->k", one, other))


def turning_slopes(points: Array) -> Array:
    """What these angles change by with points, (K - 2, K, 3), rad/m; 0 where the cable goes straight on."""
    segments, lengths = measure_segments(points)
    directions = segments / lengths
    one, other, slopes = directions[:-1], directions[1:], np.zeros((len(points) - 2, *points.shape))
    along = np.einsum("ki,ki->k", one, other)[:, None]
    sine = np.linalg.norm(np.cross(one, other), axis=1)[:, None]
    inverse = np.divide(1.0, sine, out=np.zeros_like(sine), where=sine > 0)
    by_first, by_second = inverse * (along * one - other) / lengths[:-1], inverse * (along * other - one) / lengths[1:]
    guides = np.arange(len(slopes))
    slopes[guides, guides] = -by_first
    slopes[guides, guides + 1] = by_first - by_second
    slopes[guides, guides + 2] = by_second
    return slopes


def sum_end_forces(tensions: Array) -> Array:
    """Forces (K, 3) on the points, of which each segment pulls its ends together by the vectors (K - 1, 3)."""
    forces = np.zeros((len(tensions) + 1, 3))
    forces[:-1] += tensions
    forces[1:] -= tensions
    return forces


def unit_tension_forces(points: Array) -> Array:
    """Forces (K, 3) of a tension of 1 N on the points (K, 3): -∂ℓ/∂points of the length ℓ."""
    segments, lengths = measure_segments(points)
    return sum_end_forces(segments / lengths)
