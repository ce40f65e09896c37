"""What contact does in a step that finds forces of actuators, and how these hold its points back."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.points_operator import Operator, held_back

if TYPE_CHECKING:
    from fenics_rom.mechanics.contact import ContactSolution

OfForces = Callable[[Array, Array], "tuple[ContactSolution | None, Array]"]  # as Touch, of strokes that do not give way


class Touch(Protocol):
    """What contact does under forces, and the rates (n,) that it adds where these stay as they are."""

    def __call__(self, z: Array, holding: Array, /, *, gives: Array | None) -> "tuple[ContactSolution | None, Array]":
        """Of forces z (n,), which of them (n,) are within their bounds, and what gas gives way by beside W (n,)."""


class PointsHeldBack:
    """Delassus operators (3P, 3P) of points that strokes hold back, of one without, X (3P, n) and W (n, n).

    They are kept, as the solver of contact keeps parts of one that it is given again.
    """

    def __init__(self, delassus: Operator, X: Array, W: Array):
        self._free, self._X, self._W, self._kept = delassus, X, W, dict[bytes, Operator]()

    def delassus(self, holding: Array, gives: Array | None = None) -> Operator:
        """Where some (n,) of the forces are within their bounds, of strokes that give way by so much beside W (n,)."""
        held, key = np.flatnonzero(holding), holding.tobytes()
        if not len(held):
            return self._free
        if gives is not None:  # in each iteration by something else
            return self._held(held, self._W + np.diag(gives))
        if key not in self._kept:
            self._kept[key] = self._held(held, self._W)
        return self._kept[key]

    def _held(self, held: Array, W: Array) -> Operator:
        return held_back(self._free, np.linalg.solve(np.linalg.cholesky(W[np.ix_(held, held)]), self._X[:, held].T))
