"""Saying when a reduced run leaves what a linear model can follow."""

import math
import sys
import warnings
from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomWarning
from fenics_rom.mechanics.linearity import ROTATION_LIMIT, STRAIN_LIMIT, SurfaceGauges, SurfaceStrainPeak, measure_peaks
from fenics_rom.rom.contact_model import ContactModel, safe_frequencies
from fenics_rom.rom.rom import Rom

# High states between two looks, so that looking costs less than stepping: before a limit was passed, and after.
LOOK_INTERVAL = {False: 10, True: 100}
ROTATION_ROUND_OFF = 1e-9  # share of the largest slope of the basis that is none


class LinearityMonitor:
    """Looks at the surface of a body when its stored energy would allow it to turn or strain too far.

    `rigid` gives the displacement along the rigid motions (ρ,), which energy coordinates do not hold; `peak` is how far
    the surface went, of all looks. Without a mesh there is nothing to look at.
    """

    def __init__(self, rom: Rom, rigid: Callable[[], Array] = lambda: np.empty(0)):
        self._rigid, self._gauges = rigid, dict[str, tuple[ContactModel, ReducedGauges]]()
        # A body that deforms largely has no linear limit to look out for.
        self._rows = gauge_basis(rom) if rom.deformation is None else np.empty((0, rom.basis.shape[1]))
        self.begin(SurfaceStrainPeak())

    def begin(self, peak: SurfaceStrainPeak) -> None:
        """Goes on from a peak, with a look as soon as there is need."""
        self.peak, self._interval = peak, LOOK_INTERVAL[peak.beyond]
        self._margin, self._last = 0.0, (np.empty(0), np.empty(0))
        self._since = max(LOOK_INTERVAL.values())

    def enter(self, contact: str, model: ContactModel) -> float:
        """Watches a contact mode; returns twice the stored energy, J, up to which there is no need to look.

        Its model is the ROM's, or one with further modes.
        """
        if contact not in self._gauges or self._gauges[contact][0] is not model:
            gauges = ReducedGauges(self._rows @ model.coordinates, model.eigenvalues)
            self._gauges[contact] = model, gauges
        self._safe_frequencies = model.safe_frequencies
        self._margin = 0.0  # what was safe in another mode's coordinates says nothing here
        self._gauge = self._gauges[contact][1]
        return min(2 * self._gauge.safe_energy, sys.float_info.max)  # infinite is never safe

    @property
    def in_loops(self) -> tuple[int, int, float]:
        """What tells loops when to look.

        After how many high states a look is due, how many there were, and how far coordinates e may then be from
        those of the last look without one, √J.
        """
        is_turned = len(self._last[1]) > 0  # by rigid motions, of which e does not tell
        return self._interval, self._since, 0.0 if is_turned else self._margin * self._gauge.strained_at

    @property
    def looked_at(self) -> Array:
        """Coordinates e of the last look; (0,) before the first one."""
        return self._last[0]

    def go_on(self, e: Array, time: float, since: int, is_due: bool) -> None:
        """Goes on from where loops led: so many high states after a look was due, and to one that may be due."""
        self._since = since
        if is_due:
            self.look(e, time, 0)

    def look(self, e: Array, time: float, steps: int = 1) -> None:
        """Looks at the state e = ω q (m,) of an energy that is not safe in itself, unless the last look says it is.

        Warns of the first one beyond the limits. `steps`: how many led there since the last such state.
        """
        self._since += steps
        if self._since < self._interval:
            return
        self._since, s = 0, self._rigid()
        if self._margin and self._gauge.largest_change(e - self._last[0], s - self._last[1]) < self._margin:
            return
        q = e / self._safe_frequencies
        q[: len(s)] = s
        before, now = self.peak, SurfaceStrainPeak(*self._gauge.read(q), time)
        self.peak = before.joined(now)
        self._interval = LOOK_INTERVAL[self.peak.beyond]
        self._margin, self._last = max(1 - now.severity, 0.0), (e.copy(), s.copy())
        if now.beyond and not before.beyond:
            warnings.warn(now.warning, FenicsRomWarning, stacklevel=4)


def gauge_basis(rom: Rom) -> Array:
    """Components (6g, k) of the shared basis Q: those of the state q of a contact mode are `gauge_basis(rom) @ C @ q`.

    A ROM without a mesh has none, (0, k).
    """
    k = rom.basis.shape[1]
    if len(rom.triangles) == 0:
        return np.empty((0, k))
    gauges = SurfaceGauges(rom.nodes, rom.triangles)
    return gauges.of_corners(rom.rows_of(gauges.triangles)).reshape(-1, k)


class ReducedGauges:
    """Reads rotation and strain off the state q of one contact mode, and says when there is no need to.

    With q = diag(1/√γ) y, |y|² = qᵀ diag(γ) q is at most 2 E. So no triangle turns by more than ρ √(2E), ρ the largest
    spectral norm of (its rows of ω) diag(1/√γ), and some state does; for strain, whose |ε| bounds the principal
    strains to a factor of at most √2, likewise. No energy bounds a rigid rotation: where there is one, none is safe.
    It turns all triangles alike.

    Args:
        rows: (6g, m) components of the basis W of the contact mode.
        eigenvalues: γ (m,), 1/s².

    Attributes:
        safe_energy: with no more than this stored energy nothing is beyond its limit, J; inf without rows.
        strained_at: coordinates e of this size may be at the limit of strain, √J.
    """

    def __init__(self, rows: Array, eigenvalues: Array):
        self._rows = rows
        self.safe_energy = _safe_energy((rows / safe_frequencies(eigenvalues)).reshape(-1, 2, 3, len(eigenvalues)))
        self.strained_at, self._turns = math.sqrt(2 * self.safe_energy), rows[:3, eigenvalues == 0]
        slopes = np.abs(rows)
        if slopes[:, eigenvalues == 0].max(initial=0.0) > ROTATION_ROUND_OFF * slopes.max(initial=0.0):
            self.safe_energy = 0.0  # translations turn nothing but by round-off

    def read(self, q: Array) -> tuple[float, float]:
        """Largest |ω|, rad, and largest |principal strain|, of the state q (m,)."""
        return measure_peaks((self._rows @ q).reshape(-1, 6))

    def largest_change(self, e: Array, s: Array) -> float:
        """The most by which severity changes with energy coordinates, by e (m,), and along rigid motions, by s (ρ,)."""
        strained, turned = math.sqrt(e.dot(e)), self._turns.dot(s)
        by_strain = strained / self.strained_at if self.strained_at else math.inf
        return by_strain + math.sqrt(turned.dot(turned)) / ROTATION_LIMIT


def _safe_energy(components: Array) -> float:
    """Energy with which nothing is beyond its limit, of the components (g, 2, 3, m) of energy coordinates, J."""
    scale = np.abs(components).max(initial=0.0)  # squares may overflow, or vanish
    if scale == 0:
        return math.inf
    if not np.isfinite(scale):
        return 0.0
    components = components / scale
    ρ_squared = np.linalg.eigvalsh(components @ components.swapaxes(2, 3))[:, :, -1].max(axis=0, initial=0.0)
    severity = float(scale) * float((np.sqrt(ρ_squared) / [ROTATION_LIMIT, STRAIN_LIMIT]).max())
    return 0.5 / severity / severity
