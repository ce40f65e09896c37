"""Where a body goes next, by its last mid-step velocities: by a cubic through them where it moves smoothly."""

from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

LINE, CUBIC = np.array([2.0, -1.0]), np.array([4.0, -6.0, 4.0, -1.0])  # the last velocity first


class Predictor:
    """Guesses of mid-step velocities; `dot` is the product of columns (rows here, 1).

    Attributes:
        is_smooth: whether the cubic was nearer in the last step than the line.
    """

    def __init__(self, dot: Callable[[Array, Array], float]):
        self._dot = dot
        self.forget()

    def forget(self) -> None:
        """What was before says nothing of what comes."""
        self._past: list[Array] = []
        self._h = 0.0
        self.is_smooth = False

    @property
    def last(self) -> list[Array]:
        """The velocity of the last step, if there was one."""
        return self._past[:1]

    def guesses(self, v: Array) -> list[Array]:
        """Of a step that begins at a velocity (rows here, 1)."""
        if self.is_smooth:
            return [self._expected(CUBIC)]
        return [v, self._expected(LINE)] if len(self._past) >= len(LINE) else [v]

    def note(self, found: Array, h: float) -> None:
        """Learns the mid-step velocity (rows here, 1) of a step, or a part, of h, s; where h changes it forgets all."""
        if h != self._h:
            self.forget()
            self._h = h
        if len(self._past) == len(CUBIC):
            by_line, by_cubic = (found - self._expected(coefficients) for coefficients in (LINE, CUBIC))
            self.is_smooth = self._dot(by_cubic, by_cubic) < self._dot(by_line, by_line)
        self._past = [found, *self._past[: len(CUBIC) - 1]]

    def _expected(self, coefficients: Array) -> Array:
        expected: Array = np.hstack(self._past[: len(coefficients)]) @ coefficients[:, None]
        return expected
