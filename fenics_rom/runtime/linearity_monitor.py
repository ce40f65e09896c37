"""Saying when a reduced run leaves what a linear model can follow."""

import sys
import warnings
from collections.abc import Callable

import numpy as np

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.linearity import ModeGauge, SurfaceStrainPeak, basis_rows, warning
from fenics_rom.rom.rom import Rom

Array = np.ndarray

# High states between two looks, so that looking costs less than stepping: before a limit was passed, and after.
PATIENCE = {False: 10, True: 100}


class LinearityMonitor:
    """Looks at the surface of a body when its stored energy would allow it to turn or strain too far.

    Args:
        rom: the reduced model; without a mesh there is nothing to look at.
        rigid: gives the displacement along the rigid motions (ρ,), which energy coordinates do not hold.

    Attributes:
        seen: how far the surface went, of all looks.
    """

    def __init__(self, rom: Rom, rigid: Callable[[], Array] = lambda: np.empty(0)):
        self._rom, self._rigid, self._gauges = rom, rigid, dict[str, ModeGauge]()
        # A body that deforms largely has no linear limit to look out for.
        self._rows = basis_rows(rom) if rom.deformation is None else np.empty((0, rom.basis.shape[1]))
        self.begin(SurfaceStrainPeak())

    def begin(self, seen: SurfaceStrainPeak) -> None:
        """Goes on from what was seen, with a look as soon as there is need."""
        self.seen = seen
        self._margin, self._last = 0.0, np.empty(0)
        self._since = max(PATIENCE.values())

    def enter(self, contact: str) -> float:
        """Watches a contact mode; returns twice the stored energy, J, up to which there is no need to look."""
        if contact not in self._gauges:
            mode = self._rom.contact_models[contact]
            self._gauges[contact] = ModeGauge(self._rows @ mode.coordinates, mode.eigenvalues)
        self._safe_frequencies = self._rom.contact_models[contact].safe_frequencies
        self._margin = 0.0  # what was safe in another mode's coordinates says nothing here
        self._gauge = self._gauges[contact]
        return min(2 * self._gauge.safe_energy, sys.float_info.max)  # infinite is never safe

    def look(self, e: Array, time: float) -> None:
        """Looks at the state e = ω q (m,) of an energy that is not safe in itself, unless the last look says it is.

        Warns of the first one beyond the limits.
        """
        self._since += 1
        if self._since < PATIENCE[self.seen.beyond]:
            return
        if self._margin and np.square(e - self._last).sum() / 2 < self._margin:
            return
        q, s = e / self._safe_frequencies, self._rigid()
        q[: len(s)] = s
        before, now = self.seen, SurfaceStrainPeak(*self._gauge.read(q), time)
        self.seen = before.joined(now)
        self._margin, self._last, self._since = self._gauge.safe_change(now.severity), e.copy(), 0
        if now.beyond and not before.beyond:
            warnings.warn(warning(now), FenicsRomWarning, stacklevel=4)
