"""What every kernel has. A kernel is the arithmetic of one step; a stepper has one, or one for each contact mode."""

from typing import Any

import numpy as np

from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion

Array = np.ndarray


class Kernel:
    """What every kernel has; for most of them the answers here are right.

    Attributes:
        h: time step, s; 0 before the first `set_time_step`.
        state: [e, r] (2m,), e = √γ q; ½|state|² is the stored energy of a linear model.
        contact: in the last step; None where nothing touched.
        auxiliary: what a step carries along besides.
        mismatch: of strains that are carried along and those of the shape; None where there are none.
    """

    h: float
    state: Any
    contact: ContactSolution | None = None
    auxiliary: Array = np.empty(0)
    mismatch: float | None = None

    @property
    def energy(self) -> float:
        """Stored, J."""
        return float(self.state.dot(self.state)) / 2

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know of the run so far."""
        return ()

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """Takes a step under u (p,), N, and returns twice the stored energy, J, which need not be finite.

        Raises:
            ValueError: u has another shape; no step was taken.
            StepError: there are no contact forces, or no state; no step was taken.
        """
        raise NotImplementedError

    def set_time_step(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        raise NotImplementedError

    def rollback(self) -> None:
        """Takes the last step back."""
        raise NotImplementedError

    def flush(self) -> None:
        """Books what the steps so far supplied and dissipated."""
        raise NotImplementedError

    def reset_buffer(self) -> None:
        """Books, and begins anew: what follows is then the same to the bit, whatever came before."""
        self.flush()

    def point_displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""
        raise NotImplementedError

    def resume(self, auxiliary: Array) -> None:
        """Goes on from a state that was put in, with what was saved beside it (empty: nothing was)."""
