"""How turning and bending of a full-order body drive each other in a step, and what finds both together.

With A = 2/h M + D + h/2 K of the displacements, J of the turning, C of what turning does to the balance of the
displacements and Bᵀ of what bending does to that of angular momentum, a correction (δω, δr) of lacks (a, b) is

    [J  Bᵀ] [δω]   [a]         δω = (J - Bᵀ A⁻¹ C)⁻¹ (a - Bᵀ A⁻¹ b)
    [C  A ] [δr] = [b],        δr = A⁻¹ b - A⁻¹ C δω

with one factor, that of A, and a Schur complement of three rows. What A lacks of the displacements' own balance, that a
frame which turns bends them aside, mixing corrects (Anderson, J. ACM 12, 1965): of the corrections of some last
iterations that combination is taken that leaves least.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy import ndarray as Array

NO_FORCE = np.zeros(3)
MOST_MIXED = 12  # corrections
_INDEPENDENT = 1e-10  # share of the largest singular value below which corrections say nothing new


class Factored(Protocol):
    """Who has the factor of A."""

    def inverted(self, ρ: Array, h: float) -> Array:
        """A⁻¹ρ (rows here, k)."""

    def inner(self, a: Array, b: Array) -> Array:
        """aᵀb over all ranks."""


class Coupling:
    """What is kept of turning and bending at some motion.

    Args:
        h: of the step, s.
        top: (J - Bᵀ A⁻¹ C)⁻¹ (3, 3); of a body that is tied to the ground (6, 6), of its translation, too.
        by_bending: B (rows here, 3 or 6).
        bent: A⁻¹ C (rows here, 3 or 6).
        project: Bᵀ of a column (rows here, 1), over all ranks, (3,).

    Attributes:
        h, top: as given.
    """

    def __init__(self, h: float, top: Array, by_bending: Array, bent: Array, project: Callable[[Array], Array]):
        self.h, self.top, self._by_bending, self._bent, self._project = h, top, by_bending, bent, project
        self._moved = len(top) - 3
        self._bends: Array | None = None

    @classmethod
    def of(cls, body: Factored, h: float, turning: Array, by_bending: Array, by_turning: Array) -> "Coupling":
        """Of J (3, 3), B and C (rows here, 3)."""
        bent = body.inverted(by_turning, h)
        top = np.linalg.inv(turning - body.inner(by_bending, bent))
        return cls(h, top, by_bending, bent, lambda column: body.inner(by_bending, column)[:, 0])

    def solve(self, a: Array, inside: Array, force: Array = NO_FORCE) -> Array:
        """The correction of lacks a (3,) and b, with A⁻¹ b inside (rows here,); of a tied body under a force, too."""
        lacks = np.concatenate([force, a]) if self._moved else a
        δ = self.top @ (lacks - self._project(inside.reshape(-1, 1)))
        return np.concatenate([δ[self._moved :], inside - self._bent @ δ])

    def fields(self, body: Factored) -> tuple[Array, Array]:
        """A⁻¹ C and A⁻¹ B (rows here, 3 or 6)."""
        if self._bends is None:
            self._bends = body.inverted(self._by_bending, self.h)
        return self._bent, self._bends


class _NoCoupling(Coupling):
    """Of a body that a base turns."""

    def __init__(self) -> None:
        self.h = 0.0

    def solve(self, a: Array, inside: Array, force: Array = NO_FORCE) -> Array:
        """As in Coupling."""
        return inside


NO_COUPLING = _NoCoupling()


class Mixing:
    """Of the corrections of the last iterations.

    Args:
        inner: product of two corrections.
    """

    def __init__(self, inner: Callable[[Array, Array], float]):
        self._inner = inner
        self._kept: list[tuple[Array, Array]] = []  # what x and its correction changed by
        self._gram = np.empty((0, 0))
        self._last: tuple[Array, Array] | None = None

    def next(self, x: Array, change: Array) -> Array:
        """Where to go on from x, whose correction is given."""
        if self._last is not None:
            step, gained = x - self._last[0], change - self._last[1]
            if len(self._kept) == MOST_MIXED:
                del self._kept[0]
                self._gram = self._gram[1:, 1:]
            self._kept.append((step, gained))
            column = np.array([self._inner(gained, each) for _, each in self._kept])
            self._gram = np.block([[self._gram, column[:-1, None]], [column[None]]])
        self._last = x, change
        if not (self._kept and np.isfinite(self._gram).all()):
            return x + change
        lengths = np.sqrt(np.maximum(self._gram.diagonal(), np.finfo(float).tiny))
        along = np.array([self._inner(each, change) for _, each in self._kept]) / lengths
        shares = np.linalg.lstsq(self._gram / np.outer(lengths, lengths), along, rcond=_INDEPENDENT)[0] / lengths
        mixed: Array = x + change
        for share, (step, gained) in zip(shares, self._kept, strict=True):
            mixed -= share * (step + gained)
        return mixed
