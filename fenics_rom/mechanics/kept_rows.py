"""An operator of contact points of which steps ask for little: its rows are made of the points that forces act on.

They are put together once, and kept: as a rule the same points touch again.
"""

from typing import Generic, TypeVar

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.points_operator import components

AT_ONCE = 64  # points of which rows are looked at together


class KeptRows:
    """A symmetric operator R (3P, 3P), of which rows are kept of those points that were asked for last.

    Args:
        P: how many points there are.
        most: of how many rows are kept, at least AT_ONCE, or P.

    Attributes:
        slots: of each point where its rows are kept, (P,); below 0: they are not.
        rows: these, (slots, 3, 3P); the room is taken from the system as it is filled.
    """

    def __init__(self, P: int, most: int):
        self._count, self._most = 0, min(most, P)
        self.slots, self.rows = np.full(P, -1), np.empty((self._most, 3, 3 * P))

    def keep(self, some: Array) -> None:
        """Keeps those of some points, too, or of as many of these as there is room for."""
        new = np.unique(some[self.slots[some] < 0])
        if not len(new):
            return
        if self._count + len(new) > self._most:  # begins anew
            self.slots[:], self._count, new = -1, 0, np.unique(some)[: self._most]
        end = self._count + len(new)
        self._make(new, self._room(end)[self._count : end])
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

    def moved_by(self, forces: Array) -> Array:
        """What forces (P, 3) do, (3P,)."""
        touched, moved = forces.any(axis=1).nonzero()[0], np.zeros(forces.size)
        for first in range(0, len(touched), AT_ONCE):
            some = touched[first : first + AT_ONCE]
            moved += forces[some].ravel().dot(self.of(some))
        return moved

    def whole(self) -> Array:
        """All rows, (3P, 3P)."""
        raise NotImplementedError

    def _make(self, new: Array, rows: Array) -> None:
        """Sets the rows (s, 3, 3P) of points that are all different."""
        raise NotImplementedError

    def _room(self, count: int) -> Array:
        """That of rows, which has room for so many."""
        return self.rows


Rows = TypeVar("Rows", bound=KeptRows)


class RowsOperator(Generic[Rows]):
    """R/a + Σ U Vᵀ: `points_operator.PointsOperator`.

    Args:
        rows: of R.
        by: a.
        parts: U and V (3P, k) each; each product is symmetric.
    """

    def __init__(self, rows: Rows, by: float = 1.0, parts: tuple[tuple[Array, Array], ...] = ()):
        self.rows, self.by, self.parts = rows, by, parts

    def plus(self, U: Array, V: Array) -> "RowsOperator[Rows]":
        """As in PointsOperator."""
        return RowsOperator(self.rows, self.by, (*self.parts, (U, V)))

    def divided(self, by: float) -> "RowsOperator[Rows]":
        """The same, divided by a number, before there are parts."""
        return RowsOperator(self.rows, self.by * by)

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
        A = np.empty((3 * len(self.rows.slots), len(at)))
        for first in range(0, len(some), AT_ONCE):
            A[:, 3 * first : 3 * (first + AT_ONCE)] = self.rows.of(some[first : first + AT_ONCE]).T / self.by
        for U, V in self.parts:
            A += U @ V[at].T
        return A

    def moved_by(self, forces: Array) -> Array:
        """As in PointsOperator."""
        f, at = forces.ravel(), components(forces.any(axis=1).nonzero()[0])
        moved = self.rows.moved_by(forces)
        moved /= self.by
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
