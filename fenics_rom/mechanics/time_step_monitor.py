"""Whether the time step is short enough for what moves; the same for reduced and full-order runs.

The midpoint rule keeps the amplitude of every eigenvector's motion at any step, but its oscillations take longer than
they should: by a share of (ω h)²/12, to leading order. It changes the velocity along an eigenvector by ω h times the
mid-step velocity, root mean square, so that |v⁺ - v|² / |v̂|² in the mass norm, summed over steps, is the mean of
(ω h)² over what moves, weighted by its kinetic energy.
"""

import math

MIN_STEPS_PER_OSCILLATION = 10.0  # it then takes 3 % too long


class TimeStepMonitor:
    """Measures how many steps the oscillations of a run take.

    Attributes:
        steps_per_oscillation: of what moves, as the root mean square says; inf where nothing moved.
    """

    def __init__(self) -> None:
        self._changed = self._moved = 0.0

    def add(self, changed: float, moved: float) -> None:
        """Takes one step into account: |v⁺ - v|² and |v̂|² in the mass norm, twice J."""
        self._changed += changed
        self._moved += moved

    @property
    def steps_per_oscillation(self) -> float:
        """See the class."""
        return math.tau * math.sqrt(self._moved / self._changed) if self._changed > 0 else math.inf

    @property
    def message(self) -> str:
        """What the user should know; empty where steps are short enough."""
        steps = self.steps_per_oscillation
        if steps >= MIN_STEPS_PER_OSCILLATION:
            return ""
        period_error = 100 * (math.tau / steps) ** 2 / 12 if steps else math.inf
        return (
            f"the time step is long for what moves: {steps:.2g} steps in an oscillation (root mean square), "
            f"which makes oscillations take some {period_error:.2g} % too long; "
            f"{MIN_STEPS_PER_OSCILLATION:g} steps are good to 3 %"
        )
