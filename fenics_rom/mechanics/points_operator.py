"""Operators of P points in space, velocities or displacements per force: as an array, or by what is asked of it.

Of thousands of points an array (3P, 3P) takes hundreds of MB, and a step asks for what few of them do.
"""

from typing import Protocol

import numpy as np
from numpy import ndarray as Array


class PointsOperator(Protocol):
    """A symmetric operator (3P, 3P) that is never made as a whole."""

    def among(self, some: Array) -> Array:
        """What forces on some points (s,) do to these, (3 s, 3 s)."""

    def columns(self, some: Array) -> Array:
        """What they do to all points, (3P, 3 s)."""

    def moved_by(self, forces: Array) -> Array:
        """What forces (P, 3) do to all points, (3P,)."""

    def whole(self) -> Array:
        """As an array (3P, 3P), which takes its room."""

    def plus(self, U: Array, V: Array) -> "PointsOperator":
        """The same and U Vᵀ, which is symmetric, of (3P, k) each."""


Operator = Array | PointsOperator  # an array is (3P, 3P)


class OfSome:
    """A PointsOperator of which only some points are known; the others yield by themselves.

    Args:
        W: of these, (3 s, 3 s), symmetric.
        some: which they are (s,), ascending.
        P: how many points there are.
        others: by what each of the others yields.
    """

    def __init__(self, W: Array, some: Array, P: int, others: float):
        self._W, self._some, self._rows, self._count, self._others = W, some, components(some), 3 * P, others

    def among(self, some: Array) -> Array:
        """As in PointsOperator."""
        known, at = self._places(some)
        rows, of = components(known.nonzero()[0]), components(at[known])
        part = np.diag(np.repeat(np.where(known, 0.0, self._others), 3))
        part[rows[:, None], rows] = self._W[of[:, None], of]
        return part

    def columns(self, some: Array) -> Array:
        """As in PointsOperator."""
        known, at = self._places(some)
        columns, own = np.zeros((self._count, 3 * len(some))), np.arange(3 * len(some))
        columns[components(some), own] = self._others
        columns[self._rows[:, None], components(known.nonzero()[0])] = self._W[:, components(at[known])]
        return columns

    def moved_by(self, forces: Array) -> Array:
        """As in PointsOperator."""
        moved: Array = self._others * forces.ravel()
        moved[self._rows] = self._W.dot(forces[self._some].ravel())
        return moved

    def whole(self) -> Array:
        """As in PointsOperator."""
        return self.columns(np.arange(self._count // 3))

    def plus(self, U: Array, V: Array) -> "OfSome":
        """As in PointsOperator, where U and V have nothing of the others."""
        W = self._W + U[self._rows] @ V[self._rows].T
        return OfSome(W, self._some, self._count // 3, self._others)

    def _places(self, some: Array) -> tuple[Array, Array]:
        """Which points (k,) are known, and where each of these is among them."""
        at = np.minimum(np.searchsorted(self._some, some), len(self._some) - 1)
        return self._some[at] == some, at


class TurnedPoints:
    """A PointsOperator M W Mᵀ of each two points, with a matrix M (3, 3) for all of them."""

    def __init__(self, W: PointsOperator, M: Array):
        self._W, self._M = W, M

    def among(self, some: Array) -> Array:
        """As in PointsOperator."""
        return self._turned(self._W.among(some))

    def columns(self, some: Array) -> Array:
        """As in PointsOperator."""
        return self._turned(self._W.columns(some))

    def moved_by(self, forces: Array) -> Array:
        """As in PointsOperator."""
        moved: Array = self._W.moved_by(forces @ self._M).reshape(-1, 3) @ self._M.T
        return moved.ravel()

    def whole(self) -> Array:
        """As in PointsOperator."""
        return self._turned(self._W.whole())

    def plus(self, U: Array, V: Array) -> "TurnedPoints":
        """As in PointsOperator."""
        inverse = np.linalg.inv(self._M)
        U, V = ((inverse @ part.reshape(-1, 3, part.shape[1])).reshape(part.shape) for part in (U, V))
        return TurnedPoints(self._W.plus(U, V), self._M)

    def _turned(self, A: Array) -> Array:
        turned: Array = np.einsum("ij,pjqk,lk->piql", self._M, A.reshape(len(A) // 3, 3, -1, 3), self._M, optimize=True)
        return turned.reshape(A.shape)


def components(points: Array) -> Array:
    """Numbers (3 s,) of the components of points (s,)."""
    numbers: Array = (3 * points[:, None] + np.arange(3)).ravel()
    return numbers


def operator_of(W: Operator, some: Array) -> Array:
    """What is of some points (s,) in an operator, (3 s, 3 s)."""
    if not isinstance(W, np.ndarray):
        return W.among(some)
    rows = components(some)
    part: Array = W[rows[:, None], rows]
    return part


def part_with(W: Operator, points: Array) -> tuple[Array, Array, Array | slice]:
    """An array that has some points (any) of an operator, which of its points each of these is, and what it has of all.

    An operator that is an array is given as it is.
    """
    if isinstance(W, np.ndarray):
        return W, points, slice(None)
    some, at = np.unique(points, return_inverse=True)
    return W.among(some), at.reshape(points.shape), some


def columns_of(W: Operator, some: Array) -> Array:
    """What forces on some points (s,) do to all, (3P, 3 s)."""
    return W[:, components(some)] if isinstance(W, np.ndarray) else W.columns(some)


def moved_by(W: Operator, forces: Array) -> Array:
    """W f (3P,) of forces on points (P, 3), of which there may be few."""
    if not isinstance(W, np.ndarray):
        return W.moved_by(forces)
    touched = forces.any(axis=1).nonzero()[0]
    if 2 * len(touched) >= len(forces):
        return W.dot(forces.ravel())
    rows = W.reshape(-1, 3, len(W)).take(touched, axis=0).reshape(-1, len(W))  # which lie in one piece
    return forces.take(touched, axis=0).ravel().dot(rows)


def delassus_of(Sᵀ: Array, spread: Array, by: float, beyond: Operator | None) -> Operator:
    """S A⁻¹ Sᵀ of points with rows S, from Sᵀ and A⁻¹ Sᵀ times a number, (m, 3P), and what is beside it."""
    if beyond is not None and not isinstance(beyond, np.ndarray):
        return beyond.plus(Sᵀ.T, spread.T / by)
    W = Sᵀ.T @ spread / by
    W = (W + W.T) / 2
    return W if beyond is None else W + beyond


def whole_of(W: Operator) -> Array:
    """An operator as an array (3P, 3P)."""
    return W if isinstance(W, np.ndarray) else W.whole()


def held_back(W: Operator, root: Array) -> Operator:
    """W less rootᵀ root, of what holds points back, (n, 3P)."""
    return W - root.T.dot(root) if isinstance(W, np.ndarray) else W.plus(-root.T, root.T)
