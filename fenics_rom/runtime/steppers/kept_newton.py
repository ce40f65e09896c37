"""Newton's method with a Jacobian that is kept while it pays.

It is found anew when a step took longer than the mean of all steps with it, what it cost included, and where
corrections shrink slowly.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.runtime.steppers.inertia import MOST_ITERATIONS, ROUND_OFF, SLOW, TOLERANCE

STAGNATION = 1e-11  # of the velocities: a correction that may be round-off, where the next is hardly smaller
GROWING = 1e-8  # of them: one that is round-off, where it grows though the Jacobian was found in this step
JACOBIAN = 4  # iterations that it takes the time of to find one


class KeptNewton:
    """One such method for all steps of a body.

    Args:
        eliminated: how many unknowns come before those of x in a Jacobian, whose equations are always fulfilled.

    Attributes:
        inverse: of the Jacobian that is kept, as far as x goes; None: there is none.
        whole: all of it.
    """

    def __init__(self, eliminated: int = 0) -> None:
        self.inverse: Array | None = None
        self._eliminated = eliminated
        self._steps, self._iterations, self._last = 0, 0, 0  # with it, and in the last step

    def keep(self, J: Array) -> Array:
        """J⁻¹, all of it, which is kept from now on.

        Raises:
            StepError: J is singular.
        """
        try:
            self.whole = np.linalg.inv(J)
        except np.linalg.LinAlgError as error:
            raise StepError("no step was found: its equations are singular; a smaller dt helps") from error
        self._iterations, self._steps = JACOBIAN, 0
        self.inverse = np.ascontiguousarray(self.whole[self._eliminated :, self._eliminated :])
        return self.whole

    def solve(
        self,
        x: Array,
        residual: Callable[[Array], Array],
        jacobian: Callable[[Array], Array],
        size_of: Callable[[Array], float],
        scale_at: Callable[[Array], float],
        round_off: float = 0.0,
    ) -> float:
        """Corrects x until nothing changes; how much still does where that does not end, as a share, else 0.

        That is infinite where x leaves the finite numbers after its first correction.

        Args:
            x: near the solution; overwritten.
            residual, jacobian: at x.
            size_of: a correction.
            scale_at: x after the first correction: what corrections are small beside.
            round_off: of corrections, however small x is.

        Raises:
            StepError: the first correction is not finite, or a Jacobian is singular.
        """
        if self._last * self._steps > self._iterations:
            self.inverse = None
        scale, before, is_new = 0.0, math.inf, False
        for iteration in range(1, MOST_ITERATIONS + 1):
            ρ = residual(x)  # first: the Jacobian takes of it what only the start of the step says
            is_new = is_new or self.inverse is None
            if self.inverse is None:
                self.keep(jacobian(x))
            assert self.inverse is not None
            change = self.inverse.dot(ρ)
            x -= change
            size = size_of(change)
            if not math.isfinite(size):
                if iteration > 1:
                    return math.inf
                raise StepError("the inputs are so large that the step overflows; the state was left as it was")
            scale, ratio = scale or scale_at(x), size / before
            ends = (0 < ratio < 1 and size * ratio <= TOLERANCE * scale) or size <= ROUND_OFF * scale
            # or by the round-off of what forces are a difference of
            ends = ends or (ratio > 0.5 and size <= max(STAGNATION * scale, round_off))
            if ends or (is_new and ratio > 1 and size <= GROWING * scale):
                self._last, self._iterations, self._steps = iteration, self._iterations + iteration, self._steps + 1
                return 0.0
            before = size
            if ratio > SLOW and iteration > 1:
                self.inverse, before = None, math.inf
        return size / scale
