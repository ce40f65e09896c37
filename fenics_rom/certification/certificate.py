"""A certificate of impact: the runs that it rests on, and what follows from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.certification.impacts import QUANTITIES
from fenics_rom.certification.limits import Limits
from fenics_rom.certification.ranges import Parameter, parameters_of
from fenics_rom.certification.search import Cover
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.world_format import WorldScene

MOST_CORNERS = 6  # dimensions: beyond them corners are too many
RICHARDSON = 2.0  # peaks of contact converge with the step, at least: an error is twice what half of the step changes


@dataclass(frozen=True)
class Finding:
    """What is known of a quantity, in its unit.

    Attributes:
        largest: that was found in a run.
        at: the parameters there.
        bound: nowhere in the ranges it is larger, if nothing changes faster than `search.SAFETY` times what was seen.
        reduction, time_step: largest errors that were measured.
        limit: of the region, if there is one.
    """

    largest: float
    at: tuple[float, ...]
    bound: float
    reduction: float
    time_step: float
    limit: float | None

    @property
    def certified(self) -> float:
        """The bound with both errors."""
        return self.bound + self.reduction + self.time_step

    @property
    def is_kept(self) -> bool | None:
        """Whether the limit is kept."""
        return None if self.limit is None else self.certified <= self.limit


@dataclass(frozen=True)
class Certificate:
    """The largest force, pressure and energy of an impact, over all of its ranges.

    Attributes:
        scene: the world.
        cover: runs of the search.
        corners: (c, 3) of the runs in the corners of the ranges, as `corners_of` gives these.
        finer, halved: (k, 3) of the runs that tell errors, at `compared`: with finer models, and with half of the step.
        limits: of the region, if it was named.
        roms: models of the soft bodies.
        warnings: which errors are estimates, and those of the runs, each once.

    Example:
        >>> fr.read_certificate("impact.json").findings["force"].is_kept  # doctest: +SKIP
        True
    """

    scene: WorldScene
    cover: Cover
    corners: Array
    finer: Array
    halved: Array
    limits: Limits | None
    roms: Mapping[str, Rom]
    warnings: Sequence[str] = field(default=())

    @cached_property
    def parameters(self) -> list[Parameter]:
        """What changes, in the order of the components of points."""
        table = self.scene.file.certificate
        assert table is not None
        return parameters_of(table.ranges)

    @cached_property
    def findings(self) -> dict[str, Finding]:
        """By quantity."""
        points, peaks = self.points, self.peaks
        fitted = self.cover.fitted(corners_of(len(self.parameters)), self.corners)
        bound = np.maximum(fitted.bound, peaks.max(axis=0))
        reduction = np.abs(self.finer - peaks[self.compared]).max(axis=0)
        step = RICHARDSON * np.abs(self.halved - peaks[self.compared]).max(axis=0)
        found = {}
        for k, quantity in enumerate(QUANTITIES):
            at = self.values_at(points[peaks[:, k].argmax()])
            limit = None if self.limits is None else self.limits.of.get(quantity)
            most, of_model, of_step = (float(each[k]) for each in (bound, reduction, step))
            found[quantity] = Finding(float(peaks[:, k].max()), at, most, of_model, of_step, limit)
        return found

    @property
    def is_kept(self) -> bool | None:
        """Whether all limits are kept; None where there are none."""
        kept = [each.is_kept for each in self.findings.values() if each.is_kept is not None]
        return all(kept) if kept else None

    @property
    def points(self) -> Array:
        """(r, d) of all runs but those that tell errors: of the search, and then the corners."""
        return np.concatenate([self.cover.middles, corners_of(len(self.parameters))])

    @property
    def peaks(self) -> Array:
        """(r, 3) there."""
        return np.concatenate([self.cover.values, self.corners])

    @property
    def compared(self) -> Array:
        """(k,) rows of `points` whose runs tell errors: the middle of the ranges, and where a quantity is largest."""
        return compared_rows(self.peaks)

    def values_at(self, point: Array) -> tuple[float, ...]:
        """The parameters at a point (d,) of [0, 1]^d."""
        return tuple(each.at(float(share)) for each, share in zip(self.parameters, point, strict=True))

    def __repr__(self) -> str:
        parts = [f"{name} {each.certified:.4g} {QUANTITIES[name]}" for name, each in self.findings.items()]
        return f"Certificate {self.scene.file.name!r} of {len(self.peaks)} runs: at most {', '.join(parts)}"


def compared_rows(peaks: Array) -> Array:
    """(k,) rows of the peaks (r, 3) of all runs that tell errors: the first, and the largest of each quantity."""
    return np.unique([0, *peaks.argmax(axis=0)])


def corners_of(dimension: int) -> Array:
    """Of [0, 1]^d, (2^d, d), the last one first: there speeds and masses are largest. Of too many dimensions none."""
    if dimension > MOST_CORNERS:
        return np.empty((0, dimension))
    every: Any = np.indices((2,) * dimension).reshape(dimension, -1).T
    return np.asarray(every[::-1], dtype=float)
