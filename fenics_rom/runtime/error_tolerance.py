"""An error that a run is to keep to: it is looked at after each step, and where it is larger the run says so at once.

It is the estimate that is compared, of the displacements of all outputs. In the energy norm no run would pass its first
steps: these are what a small basis follows worst, and no energy is there yet to compare with. A bound of outputs never
falls, and would say so long before the error is there.
"""

import warnings
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import is_number
from fenics_rom.errors import StepError, ToleranceWarning, shown
from fenics_rom.rom.rom import Rom

NO_MORE = "the run goes on, but its outputs may be further off; take a higher order"
ADVICE = f"{NO_MORE}, or, with the full system at hand, let directions be added (enrich)"
NO_OUTPUTS = "error_tolerance: is of the errors of outputs, of which ROM {!r} has none"
ADDED = "directions are added to the basis"


class Exceeded(NamedTuple):
    """Where the estimate was first larger than the tolerance."""

    time: float  # s
    error: float  # m, of
    output: str

    def message(self, tolerance: float, advice: str) -> str:
        """What to say of it."""
        return (
            f"error_tolerance = {tolerance:g} m: at {self.time:.6g} s output {self.output!r} is off by "
            f"{self.error:.3g} m, by the estimate of a finer model; {advice}"
        )


def tell(message: str) -> None:
    """Says so at once."""
    warnings.warn(message, ToleranceWarning, stacklevel=6)


def checked_tolerance(tolerance: object) -> float:
    """The tolerance, m; a StepError where it is none."""
    if not (is_number(tolerance) and 0 < tolerance < np.inf):  # type: ignore[operator]
        raise StepError(f"error_tolerance = {shown(tolerance)}: use a number > 0, m")
    return float(tolerance)  # type: ignore[arg-type]


class OutputErrors:
    """Estimates of the errors of all outputs of a ROM, from the energy coordinates of the finer and the reduced model.

    Raises:
        StepError: no error of an output can be told.
    """

    def __init__(self, rom: Rom):
        errors = rom.error_model
        assert errors is not None
        if not rom.outputs:
            raise StepError(NO_OUTPUTS.format(rom.name))
        if errors.couples_rigid_motions:
            raise StepError(
                "error_tolerance: dashpots couple how the body moves as a whole with how it strains; use a body "
                "whose errors of outputs are known"
            )
        self._rom, ω = rom, np.sqrt(errors.eigenvalues)
        stacked = np.vstack([errors.outputs[name] for name in rom.outputs])
        self._names = [name for name, rows in errors.outputs.items() for _ in rows]
        self._finer, self._beyond = stacked / np.where(ω > 0, ω, np.inf), stacked @ errors.coordinates
        self._reduced: dict[str, Array] = {}

    def largest(self, contact: str, finer: Array, reduced: Array, beyond: Array | None) -> tuple[float, str]:
        """The largest component, m, and whose, of states [e, r] of both; `beyond` as in `ErrorWatch.estimate`."""
        if contact not in self._reduced:
            model = self._rom.contact_models[contact]
            self._reduced[contact] = self._beyond @ (model.coordinates / model.safe_frequencies)
        rows = self._reduced[contact]
        off = self._finer.dot(finer[: self._finer.shape[1]]) - rows.dot(reduced[: rows.shape[1]])
        if beyond is not None:
            off -= self._beyond.dot(beyond)
        sizes = np.abs(off)
        largest = int(sizes.argmax())
        return sizes.item(largest), self._names[largest]
