"""Symmetric matrices that are positive definite, or are made to be."""

import math

import numpy as np
from numpy import ndarray as Array


def is_definite(matrix: Array) -> bool:
    """Whether a symmetric matrix (m, m) is positive definite."""
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return True


def definite_inverse(*matrices: Array) -> Array:
    """Of the first of some symmetric matrices (m, m) that is definite; not numbers where none is."""
    for matrix in filter(is_definite, matrices):
        inverse = np.linalg.inv(matrix)
        return (inverse + inverse.T) / 2
    return np.full_like(matrices[0], math.nan)
