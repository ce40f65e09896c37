"""Rows of residual compliance whose larger part is kept by blocks: what steps ask of it, without the whole."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.kept_rows import KeptRows
from fenics_rom.mechanics.points_operator import components
from fenics_rom.rom.block_matrix import BlockMatrix

MOST = 256  # points whose rows are kept: of 2,000 points 37 MB
WANTED = -2  # in place of where rows are kept: loops ask for them


class BlockRows(KeptRows):
    """B + ε - X Xᵀ.

    Args:
        blocks: B.
        floor: ε.
        X: (3P, k).

    Attributes:
        blocks, floor, X: as given.
    """

    def __init__(self, blocks: BlockMatrix, floor: float, X: Array):
        super().__init__(len(blocks.order), MOST)
        self.blocks, self.floor, self.X = blocks, floor, X

    def keep_wanted(self) -> None:
        """Keeps those of points that loops ask for."""
        self.keep((self.slots == WANTED).nonzero()[0])

    def moved_by(self, forces: Array) -> Array:
        """As in KeptRows."""
        if np.count_nonzero(forces.any(axis=1)) <= len(self.rows):
            return super().moved_by(forces)
        f = forces.ravel()
        moved: Array = self.blocks.moved_by(f) + self.floor * f - self.X.dot(f.dot(self.X))
        return moved

    def whole(self) -> Array:
        """As in KeptRows."""
        A = self.blocks.whole()
        A -= self.X @ self.X.T
        A.ravel()[:: len(A) + 1] += self.floor
        return A

    def _make(self, new: Array, rows: Array) -> None:
        at = components(new)
        rows[:] = self.blocks.rows_of(new)
        rows -= (self.X[at] @ self.X.T).reshape(rows.shape)
        rows.reshape(len(at), -1)[np.arange(len(at)), at] += self.floor
