"""The energy account of a run, J: running sums that together with the stored energy must close to round-off."""

from dataclasses import dataclass


@dataclass
class Ledger:
    """E - E₀ = supplied - dissipated - lost_in_switching.

    The sums of the steps carry their rounding errors along (Kahan), so that a million small works add up.

    Attributes:
        supplied: work of the inputs, Σ h (B u)ᵀ v̂.
        dissipated: Σ h v̂ᵀ D v̂, never negative.
        lost_in_switching: taken out of the state by projections; negative only for oblique switching.
    """

    supplied: float = 0.0
    dissipated: float = 0.0
    lost_in_switching: float = 0.0
    _supplied_excess: float = 0.0
    _dissipated_excess: float = 0.0

    def become(self, other: "Ledger") -> None:
        """Takes the sums of another account; who holds this one goes on seeing the run's."""
        vars(self).update(vars(other))

    def book(self, supplied: float, dissipated: float) -> None:
        """Adds what a step supplied and dissipated, J."""
        old, more = self.supplied, supplied - self._supplied_excess
        self.supplied = new = old + more
        self._supplied_excess = (new - old) - more
        old, more = self.dissipated, dissipated - self._dissipated_excess
        self.dissipated = new = old + more
        self._dissipated_excess = (new - old) - more
