"""An operator of contact points whose larger part is kept by blocks: what steps ask of it, without the whole.

Rows of points that forces act on are put together once, and kept: as a rule the same ones touch again.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.points_operator import components
from fenics_rom.rom.block_matrix import BlockMatrix

MOST = 256  # points whose rows are kept: of 2,000 points 37 MB
AT_ONCE = 64  # points of which rows are looked at together


class KeptRows:
    """B + ε - X Xᵀ, of which rows are kept of those points that were asked for last.

    Args:
        blocks: B.
        floor: ε.
        X: (3P, k).

    Attributes:
        blocks, floor, X: as given.
        slots: of each point where its rows are kept, (P,); -1: they are not.
        rows: these, (slots, 3, 3P); the room is taken from the system as it is filled.
    """

    def __init__(self, blocks: BlockMatrix, floor: float, X: Array):
        self.blocks, self.floor, self.X, self._count, P = blocks, floor, X, 0, len(blocks.order)
        self.slots, self.rows = np.full(P, -1), np.empty((min(MOST, P), 3, 3 * P))

    def keep(self, some: Array) -> None:
        """Keeps those of some points, too, or of as many of these as there is room for."""
        new = np.unique(some[self.slots[some] < 0])
        if self._count + len(new) > len(self.rows):  # begins anew
            self.slots[:], self._count, new = -1, 0, np.unique(some)[: len(self.rows)]
        end, at = self._count + len(new), components(new)
        rows = self.rows[self._count : end]
        rows[:] = self.blocks.rows_of(new)
        rows -= (self.X[at] @ self.X.T).reshape(rows.shape)
        rows.reshape(len(at), -1)[np.arange(len(at)), at] += self.floor
        self.slots[new], self._count = np.arange(self._count, end), end

    def of(self, some: Array) -> Array:
        """Rows of at most AT_ONCE points, (3 s, 3P)."""
        if (self.slots[some] < 0).any():
            self.keep(some)
        return self.rows[self.slots[some]].reshape(3 * len(some), -1)

    def among(self, some: Array, columns: Array) -> Array:
        """Some columns (c,) of them, (3 s, c)."""
        if (self.slots[some] < 0).any():
            self.keep(some)
        part: Array = self.rows[self.slots[some][:, None, None], np.arange(3)[:, None], columns]
        return part.reshape(3 * len(some), -1)

    def moved_by(self, f: Array) -> Array:
        """What forces (3P,) on many points do, (3P,)."""
        moved: Array = self.blocks.moved_by(f) + self.floor * f - self.X.dot(f.dot(self.X))
        return moved

    def whole(self) -> Array:
        """All rows, (3P, 3P)."""
        A = self.blocks.whole()
        A -= self.X @ self.X.T
        A.ravel()[:: len(A) + 1] += self.floor
        return A


class BlockOperator:
    """R/a + Σ U Vᵀ: `mechanics.points_operator.PointsOperator`.

    Args:
        rows: of R.
        by: a.
        parts: U and V (3P, k) each; each product is symmetric.
    """

    def __init__(self, rows: KeptRows, by: float = 1.0, parts: tuple[tuple[Array, Array], ...] = ()):
        self.rows, self.by, self.parts = rows, by, parts

    def plus(self, U: Array, V: Array) -> "BlockOperator":
        """As in PointsOperator."""
        return BlockOperator(self.rows, self.by, (*self.parts, (U, V)))

    def divided(self, by: float) -> "BlockOperator":
        """The same, divided by a number, before there are parts."""
        return BlockOperator(self.rows, self.by * by)

    def among(self, some: Array) -> Array:
        """As in PointsOperator."""
        at = components(some)
        A = np.empty((len(at), len(at)))
        for first in range(0, len(some), AT_ONCE):
            own = slice(3 * first, 3 * (first + AT_ONCE))
            A[own] = self.rows.among(some[first : first + AT_ONCE], at) / self.by
        for U, V in self.parts:
            A += U[at] @ V[at].T
        return (A + A.T) / 2

    def columns(self, some: Array) -> Array:
        """As in PointsOperator."""
        at = components(some)
        A = np.empty((len(self.rows.X), len(at)))
        for first in range(0, len(some), AT_ONCE):
            A[:, 3 * first : 3 * (first + AT_ONCE)] = self.rows.of(some[first : first + AT_ONCE]).T / self.by
        for U, V in self.parts:
            A += U @ V[at].T
        return A

    def moved_by(self, forces: Array) -> Array:
        """As in PointsOperator."""
        f, touched = forces.ravel(), forces.any(axis=1).nonzero()[0]
        if len(touched) > len(self.rows.rows):
            moved = self.rows.moved_by(f)
        else:
            moved = np.zeros(len(f))
            for first in range(0, len(touched), AT_ONCE):
                some = touched[first : first + AT_ONCE]
                moved += forces[some].ravel().dot(self.rows.of(some))
        moved /= self.by
        at = components(touched)
        for U, V in self.parts:
            moved += U.dot(f[at].dot(V[at]))
        return moved

    def whole(self) -> Array:
        """The operator (3P, 3P): of thousands of points it takes hundreds of MB."""
        A = self.rows.whole()
        A /= self.by
        for U, V in self.parts:
            A += U @ V.T
        return A
