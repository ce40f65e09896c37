"""The energy account of a run, J: running sums that together with the stored energy must close to round-off."""

from dataclasses import dataclass


@dataclass
class Ledger:
    """E - E₀ = supplied - dissipated - lost_in_switching.

    Attributes:
        supplied: work of the inputs, Σ h (B u)ᵀ v̂.
        dissipated: Σ h v̂ᵀ D v̂, never negative.
        lost_in_switching: taken out of the state by projections; negative only for oblique switching.
    """

    supplied: float = 0.0
    dissipated: float = 0.0
    lost_in_switching: float = 0.0
