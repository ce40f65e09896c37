"""How the answer of a kept factor to the residual changes with the velocity, as it has done in the steps so far."""

import math
from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

SECANTS = 30  # that are kept
INDEPENDENCE = 1e-10  # of a secant of the others, squared, below which it counts for nothing


class Secants:
    """Of A⁻¹ r, without forces that are found, for velocities v̂; kept over steps, as long as a factor of A is.

    A residual that changed with the velocity as it has so far would be least where `direction` leads (Anderson, 1965;
    Fang & Saad, 2009); from one step to the next the tangent hardly changes (Degroote et al., 2009).

    Args:
        local: rows here.
        inner: leftᵀ right of columns (rows here, any) over all ranks.
    """

    def __init__(self, local: int, inner: Callable[[Array, Array], Array]):
        self._inner = inner
        self._changes, self._moves = np.empty((2, SECANTS, local))  # of unit length; those less the Newton steps
        self._products = np.empty((SECANTS, SECANTS))
        self.forget()
        self.begin()

    def begin(self) -> None:
        """Of another step, whose first velocity changes nothing that is known."""
        self._last: tuple[Array, Array] | None = None

    def forget(self) -> None:
        """What was noted led astray."""
        self._noted = 0

    def note(self, v: Array, answer: Array) -> None:
        """Learns what the answer (rows here, 1) to a velocity (rows here, 1) is."""
        before, self._last = self._last, (v, answer)
        if before is None:
            return
        change = answer - before[1]
        length = math.sqrt(self._inner(change, change).item())
        if length == 0.0:
            return
        slot, self._noted = self._noted % SECANTS, self._noted + 1
        self._changes[slot] = change[:, 0] / length
        self._moves[slot] = self._changes[slot] + (v - before[0])[:, 0] / length
        used = min(self._noted, SECANTS)
        products = self._inner(self._changes[:used].T, self._changes[slot, :, None])[:, 0]
        self._products[slot, :used] = self._products[:used, slot] = products

    def direction(self, answer: Array) -> Array:
        """Where a velocity with this answer (rows here, 1) is to go."""
        used = min(self._noted, SECANTS)
        products = self._products[:used, :used] + INDEPENDENCE * np.eye(used)
        weights = np.linalg.solve(products, self._inner(self._changes[:used].T, answer))
        return answer - self._moves[:used].T @ weights
