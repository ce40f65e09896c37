"""Where a run goes beyond its error tolerance, and what goes on from there: itself, or a body with more directions."""

from typing import Protocol

import numpy as np

from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.error_tolerance import ADDED, Exceeded
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.trajectory.error_series import ErrorTolerance


class Enriches(Protocol):
    """What adds directions to the basis of a body, see `reduction.enrichment`."""

    rom: Rom  # with the directions that were added so far

    def enrich(self, body: Simulator) -> Simulator:
        """The body that goes on; the same one where there is nothing to add."""


class Exceedings:
    """Where a run went beyond its tolerance, with the orders before and after."""

    def __init__(self, enrichment: Enriches | None):
        self._enrichment, self._found = enrichment, list[tuple[Exceeded, int, int]]()

    def follow(self, body: Simulator) -> Simulator:
        """The body that goes on after a step: the same, unless directions are added where it went beyond just now."""
        found = body.exceeded
        if found is None or (self._found and self._found[-1][0] is found):
            return body
        before = body.model.order
        if self._enrichment is not None:
            body = self._enrichment.enrich(body)
        self._found.append((found, before, body.model.order))
        return body

    def kept(self, tolerance: float | None) -> ErrorTolerance | None:
        """For the trajectory; None where there was no tolerance."""
        if tolerance is None:
            return None
        found = [of for of, *_ in self._found]
        return ErrorTolerance(
            value=tolerance,
            times=np.array([of.time for of in found]),
            errors=np.array([of.error for of in found]),
            outputs=tuple(of.output for of in found),
            orders=np.array([orders for _, *orders in self._found], dtype=np.int64).reshape(-1, 2),
        )

    def messages(self, tolerance: float | None) -> list[str]:
        """What to say of directions that were added."""
        return [
            of.message(tolerance, f"{ADDED}, and its order goes from {before} to {after}")
            for of, before, after in self._found
            if tolerance is not None and after > before
        ]
