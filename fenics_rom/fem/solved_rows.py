"""The Delassus operator of many contact points at full order: solved for those that forces act on."""

from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.kept_rows import AT_ONCE, KeptRows


class SolvedRows(KeptRows):
    """W, of which all rows that were asked for are kept, as a solve is dear.

    Args:
        P: how many points there are.
        solved: columns (3P, 3 s) of W of some points (s,); every rank calls it.
    """

    def __init__(self, P: int, solved: Callable[[Array], Array]):
        super().__init__(P, P)
        self._solved, self.rows = solved, self.rows[:0].copy()

    def whole(self) -> Array:
        """As in KeptRows."""
        every = np.arange(len(self.slots))
        self.keep(every)
        return self.rows[self.slots].reshape(3 * len(every), -1)

    def _make(self, new: Array, rows: Array) -> None:
        for first in range(0, len(new), AT_ONCE):
            some = new[first : first + AT_ONCE]
            rows[first : first + AT_ONCE] = self._solved(some).T.reshape(len(some), 3, -1)

    def _room(self, count: int) -> Array:
        if count > len(self.rows):
            rows = np.empty((min(len(self.slots), max(count, 2 * len(self.rows))), *self.rows.shape[1:]))
            rows[: len(self.rows)] = self.rows
            self.rows = rows
        return self.rows
