"""Saying when a full-order run leaves what its model can follow."""

import warnings

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.mechanics.linearity import SurfaceGauges, SurfaceStrainPeak, measure_peaks
from fenics_rom.system.system import Array, System


class SurfaceMonitor:
    """Watches whether the surface turns or strains more than a linear model can follow."""

    def __init__(self, system: System):
        self._gauges, self._peak = SurfaceGauges(system.body.nodes, system.body.triangles), SurfaceStrainPeak()

    def look(self, displacement: Array, time: float) -> None:
        """Notes displacements of all nodes (N, 3), m, at a time, s, and warns at the first that is too much."""
        now = SurfaceStrainPeak(*measure_peaks(self._gauges.components(displacement)), time)
        if now.beyond and not self._peak.beyond:
            warnings.warn(now.warning, FenicsRomWarning, stacklevel=3)
        self._peak = self._peak.joined(now)

    @property
    def summary(self) -> str:
        """What to say of the run; empty where there is nothing to say."""
        return self._peak.summary


class InversionMonitor:
    """Watches whether points of a body that deforms largely are turned inside out."""

    def __init__(self, stepper: FiniteStrainStepper):
        self._stepper, self._most, self._first = stepper, 0, 0.0

    def look(self, displacement: Array, time: float) -> None:
        """As in SurfaceMonitor."""
        count = self._stepper.inverted
        first = count > 0 and self._most == 0
        self._most = max(self._most, count)
        if first:
            self._first = time
            warnings.warn(self.summary, FenicsRomWarning, stacklevel=3)

    @property
    def summary(self) -> str:
        """As in SurfaceMonitor."""
        if not self._most:
            return ""
        return (
            f"up to {self._most} points of the body were turned inside out, from t = {self._first:.4g} s on: shapes "
            "and forces there are not to be trusted; a finer mesh or a smaller load may help"
        )
