"""The Delassus operator of some pairs, and what of it is kept for later steps.

All that is kept follows from the operator alone, so that no result depends on what was solved before.
"""

from functools import cached_property

import numpy as np
from numpy import ndarray as Array

_ONES, _XYZ = np.ones(3), np.arange(3)
_LARGEST_CONDITION = 1e8  # of what is inverted; Newton's steps with the inverse correct what it lacks
_MOST_KEPT = 4  # inverses


class Delassus:
    """Velocities per force of C pairs, m/s/N.

    Args:
        matrix: W (3C, 3C), symmetric positive semidefinite; not to be changed.

    Attributes:
        compliance: (C,) of each pair by itself, m/s/N, > 0.
        stiffness: (C, 1) one by it, N s/m.
    """

    def __init__(self, matrix: Array):
        self.matrix = matrix
        self.compliance = matrix.diagonal().reshape(-1, 3).dot(_ONES) / 3
        if not self.compliance.min() > 0:
            self.compliance = np.maximum(self.compliance, 1e-12 * self.compliance.max() or 1.0)
        self.stiffness = 1 / self.compliance[:, None]
        self._inverses: dict[bytes, Array] = {}

    @cached_property
    def is_regular(self) -> bool:
        """Whether W tells all forces apart; judged by its Cholesky factor, which takes a fifth of an inverse's time."""
        try:
            pivots = np.linalg.cholesky(self.matrix).diagonal()
        except np.linalg.LinAlgError:
            return False
        return bool(pivots.min() ** 2 * _LARGEST_CONDITION > pivots.max() ** 2)

    def inverse(self, closed: Array) -> Array:
        """The inverse (3A, 3A) of a regular W of the A closed pairs, where `closed` (C,) is True, N s/m."""
        key = closed.tobytes()
        if key not in self._inverses:
            if len(self._inverses) == _MOST_KEPT:
                del self._inverses[next(iter(self._inverses))]
            rows = (3 * np.flatnonzero(closed)[:, None] + _XYZ).ravel()
            self._inverses[key] = np.linalg.inv(self.matrix[rows[:, None], rows])
        return self._inverses[key]
