"""A symmetric matrix of points in space by blocks: of points far from each other few columns suffice.

What forces on points do far away is smooth there, so that such a block is a product U V of few columns and rows: a
hierarchical matrix (Hackbusch 1999). `reduction.block_compression` makes it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.points_operator import components
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

    def rows_of(self, some: Array) -> Array:
        """Rows of some points that are all different, (s, 3, 3P)."""
        P = len(self.order)
        place = np.empty(P, int)
        place[self.order] = np.arange(P)
        at = np.argsort(place[some])
        places, A = place[some[at]], np.empty((len(some), 3, P, 3))
        rows, columns = np.searchsorted(places, self.blocks[:, :4]).reshape(-1, 2, 2).swapaxes(0, 1)  # of each block
        for which in ((rows[:, 0] < rows[:, 1]) | (columns[:, 0] < columns[:, 1])).nonzero()[0]:
            U, V, _, _ = self._parts(which)
            first, last, left, right, _ = self.blocks[which]
            both = (U, V, rows, first, left, right), (V.T, U.T, columns, left, first, last)
            for M, N, asked, begin, low, high in both[: 1 if first == left else 2]:
                to = slice(*asked[which])
                own = M.reshape(len(M) // 3, 3, len(N))[places[to] - begin]
                A[to, :, low:high] = (own @ N).reshape(len(own), 3, high - low, 3)
        in_order = A[np.argsort(at)]
        rows_of: Array = in_order[:, :, place].reshape(len(some), 3, 3 * P)
        return rows_of

    def moved_by(self, f: Array) -> Array:
        """A f (3P,)."""
        f, moved = f.reshape(-1, 3), np.zeros((len(self.order), 3))
        for which in range(len(self.blocks)):
            U, V, points, others = self._parts(which)
            moved[points] += (U @ (V @ f[others].ravel())).reshape(-1, 3)
            if self.blocks[which, 0] != self.blocks[which, 2]:
                moved[others] += ((f[points].ravel() @ U) @ V).reshape(-1, 3)
        return moved.ravel()

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
        for which in range(len(self.blocks)):
            U, V, points, others = self._parts(which)
            yield components(points), components(others), U @ V

    def _parts(self, which: int) -> tuple[Array, Array, Array, Array]:
        """U (r, k) and V (k, c) of a block, and the points of its rows and columns."""
        first, last, left, right, rank = self.blocks[which].tolist()
        start, points, others = self.starts[which], self.order[first:last], self.order[left:right]
        rows, columns = 3 * len(points), 3 * len(others)
        if rank == WHOLE:
            return self.values[start : start + rows * columns].reshape(rows, columns), np.eye(columns), points, others
        middle, end = start + rows * rank, start + (rows + columns) * rank
        U, V = self.values[start:middle].reshape(rows, rank), self.values[middle:end].reshape(rank, columns)
        return U, V, points, others

    @cached_property
    def starts(self) -> Array:
        """Where the values of each block begin."""
        ends: Array = np.cumsum(_sizes(self.blocks))
        return np.concatenate([[0], ends[:-1]])


def _sizes(blocks: Array) -> Array:
    """How many numbers each block has."""
    first, last, left, right, rank = blocks.T
    rows, columns = 3 * (last - first), 3 * (right - left)
    sizes: Array = np.where(rank == WHOLE, rows * columns, rank * (rows + columns))
    return sizes
