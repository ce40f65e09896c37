"""A symmetric matrix of points in space by blocks: of points far from each other few columns suffice.

What forces on points do far away is smooth there, so that such a block is a product U V of few columns and rows: a
hierarchical matrix (Hackbusch 1999). `reduction.block_compression` makes it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.content import ByContent

WHOLE = -1  # in place of a rank: a block as it is


@dataclass(frozen=True, eq=False)
class BlockMatrix(ByContent):
    """A symmetric matrix A (3P, 3P), three rows for each of P points.

    Attributes:
        order: of the points (P,), in which each block is of points in a row.
        blocks: (b, 5), of each the first and one past the last of the points of its rows, the same of its columns, and
            its rank, or WHOLE. Of two blocks that mirror each other there is one.
        values: of one block after the other, by rows: the block (r, c), or U (r, rank) and V (rank, c).
    """

    order: Array
    blocks: Array
    values: Array

    def whole(self) -> Array:
        """A (3P, 3P)."""
        A = np.empty((3 * len(self.order),) * 2)
        for rows, columns, block in self._each():
            A[rows[:, None], columns] = block
            A[columns[:, None], rows] = block.T
        return A

    def mistake(self) -> str:
        """What does not fit together, in words; empty where all does."""
        P = len(self.order)
        if not np.array_equal(np.sort(self.order), np.arange(P)):
            return f"order is none of {P} points"
        first, last, left, right, rank = self.blocks.T
        if (np.stack([first, left, P - last, P - right, last - first - 1, right - left - 1, rank - WHOLE]) < 0).any():
            return f"blocks are not of {P} points in a row"
        count = int(_sizes(self.blocks).sum())
        if len(self.values) != count:
            return f"values are {len(self.values)}, and blocks have {count}"
        covered = np.zeros((P, P), np.uint8)
        for a, b, c, d, _ in self.blocks.tolist():
            covered[a:b, c:d] += 1
            if (a, b) != (c, d):
                covered[c:d, a:b] += 1
        return "" if (covered == 1).all() else "blocks do not have each pair of points once"

    def _each(self) -> Iterator[tuple[Array, Array, Array]]:
        """Rows (r,), columns (c,) and numbers (r, c) of each block."""
        rows = (3 * self.order[:, None] + np.arange(3)).ravel()
        ends = np.cumsum(_sizes(self.blocks)).tolist()
        for (a, b, c, d, rank), start, end in zip(self.blocks.tolist(), [0, *ends], ends, strict=False):
            shape, middle = (3 * (b - a), 3 * (d - c)), start + 3 * (b - a) * rank
            if rank == WHOLE:
                block = self.values[start:end].reshape(shape)
            else:
                U, V = self.values[start:middle], self.values[middle:end]
                block = U.reshape(shape[0], rank) @ V.reshape(rank, shape[1])
            yield rows[3 * a : 3 * b], rows[3 * c : 3 * d], block


def _sizes(blocks: Array) -> Array:
    """How many numbers each block has."""
    first, last, left, right, rank = blocks.T
    rows, columns = 3 * (last - first), 3 * (right - left)
    sizes: Array = np.where(rank == WHOLE, rows * columns, rank * (rows + columns))
    return sizes
