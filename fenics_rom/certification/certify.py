"""Runs of a world over the ranges of its certificate."""

import hashlib
import json
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.certification.certificate import Certificate, compared_rows, corners_of
from fenics_rom.certification.impacts import Impact, check_end, strike
from fenics_rom.certification.limits import EXAMPLES, read_limits
from fenics_rom.certification.models import models_of
from fenics_rom.certification.ranges import file_at, parameters_of
from fenics_rom.certification.search import search
from fenics_rom.errors import FenicsRomError, FenicsRomWarning, FileError, SceneError, check_type
from fenics_rom.io.progress import Report, silent
from fenics_rom.rom.rom import Rom
from fenics_rom.scene.world_file import files_of_world
from fenics_rom.scene.world_format import WorldScene
from fenics_rom.version import VERSION

NUMBER = re.compile(r"\d[\d.e+-]*")


def certify(scene: WorldScene, *, runs_file: Path | None = None, report: Report = silent) -> Certificate:
    """Searches the worst impacts of a world over the ranges of its [certificate], and measures the errors there.

    Args:
        scene: as `read_world` gives it.
        runs_file: keeps each run as soon as it is done; runs that are there already are not done again.
        report: called with the stage, how much of it is done, and of how much.

    Raises:
        SceneError: there is no [certificate], a body whose scene is not at hand, or nothing is hit.
        DataError: the table of limits cannot be used.
        StepError: a run could not be taken; it says at which parameters.

    Example:
        >>> fr.certify(fr.read_world("impact.toml")).findings["force"].certified  # doctest: +SKIP
        31.4
    """
    check_type("certify", scene, WorldScene, "fr.read_world(file)")
    file = scene.file
    table, run = file.certificate, file.run
    if table is None or run is None:
        raise SceneError(f"{scene.source}: has no [certificate], which says what is searched for; add one")
    limits = None
    if table.region is not None:
        limits = read_limits(table.region, EXAMPLES if table.limits is None else scene.folder / table.limits)
    dimension = len(parameters_of(table.ranges))
    roms, finer, notes = models_of(scene, report)
    strikes = Strikes(scene, roms, run.dt, runs_file)

    def values(point: Array) -> Array:
        report("runs, at most", strikes.count, table.runs)
        return strikes(point)

    cover = search(values, dimension, table.tolerance, table.runs)
    corners = corners_of(dimension)
    at_corners = np.array([values(point) for point in corners]).reshape(-1, cover.values.shape[1])
    report("runs, at most", table.runs, table.runs)
    points = np.concatenate([cover.middles, corners])
    found = np.concatenate([cover.values, at_corners])
    if not found[:, 0].any():
        raise SceneError(
            f"{scene.source}: in {len(found)} runs nothing hits {table.body!r}; use ranges and a run in which it is hit"
        )
    rows = compared_rows(found)
    others = Strikes(scene, finer, run.dt), Strikes(scene, roms, run.dt / 2)
    compared = []
    for k, each in enumerate(others):
        for j, row in enumerate(rows):
            report("errors", k * len(rows) + j, 2 * len(rows))
            compared.append(each(points[row]))
    report("errors", 2 * len(rows), 2 * len(rows))
    of_finer, halved = np.array(compared).reshape(2, len(rows), -1)
    told = (*notes, *strikes.warnings)
    return Certificate(scene, cover, at_corners, of_finer, halved, limits, roms, told)


class Strikes:
    """Peaks (3,) of runs at points (d,), each run once.

    Args:
        scene: with a certificate.
        roms: models of its soft bodies.
        dt: s.
        runs_file: where they are kept.
    """

    def __init__(self, scene: WorldScene, roms: Mapping[str, Rom], dt: float, runs_file: Path | None = None):
        self._scene, self._roms, self._dt, self._file = scene, roms, dt, runs_file
        self._known: dict[tuple[float, ...], Array] = {}
        self._told: dict[str, list[str]] = {}  # by their words, whatever their numbers
        for run in [] if runs_file is None else known_runs(runs_file, scene):
            self._keep(*run)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What runs told, each once, with the numbers of the first run that did, and in how many runs."""
        counted = ((texts[0], f"{len(texts)} run{'s' * (len(texts) > 1)}") for texts in self._told.values())
        return tuple(f"{text} (this or the like in {runs})" for text, runs in counted)

    @property
    def count(self) -> int:
        """Of runs that are known."""
        return len(self._known)

    def __call__(self, point: Array) -> Array:
        """The peaks of a run, which is run where they are not known."""
        key = tuple(point.tolist())
        if key not in self._known:
            impact = self.impact(point)
            run = key, impact.peaks.tolist(), impact.warnings
            self._keep(*run)
            if self._file is not None:
                with self._file.open("a") as stream:
                    stream.write(json.dumps(run) + "\n")
        return self._known[key]

    def _keep(self, key: tuple[float, ...], peaks: Sequence[float], told: Sequence[str] = ()) -> None:
        self._known[key] = np.array(peaks)
        for text in told:
            self._told.setdefault(NUMBER.sub("#", text), []).append(text)

    def impact(self, point: Array) -> Impact:
        """A run; whatever cannot be is told with its parameters."""
        scene = replace(self._scene, file=file_at(self._scene.file, point))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FenicsRomWarning)  # `impact.warnings` has them
                impact = strike(scene, self._roms, self._dt)
                check_end(impact)
        except FenicsRomError as error:
            raise type(error)(f"{self.where(point)}: {error}") from error
        return impact

    def where(self, point: Array) -> str:
        """The parameters of a run, for messages."""
        table = self._scene.file.certificate
        assert table is not None
        at = zip(parameters_of(table.ranges), point, strict=True)
        return ", ".join(f"{each.name} = {each.at(float(share)):.6g} {each.unit}" for each, share in at)


def known_runs(file: Path, scene: WorldScene) -> list[tuple[Any, ...]]:
    """Runs that interrupted work left in a file, which is begun where it is not there: point, peaks and warnings.

    Raises:
        FileError: they are of another world or version, or it cannot be read or written.
    """
    digest = hashlib.sha256(VERSION.encode())  # another one may find other forces
    for each in files_of_world(scene):
        digest.update(each.read_bytes())
    try:
        if not file.exists():
            file.write_text(f"{digest.hexdigest()}\n")
        first, *lines = file.read_text().splitlines()
        if first != digest.hexdigest():
            raise FileError(
                f"{file}: holds runs of another world, of this one before it was changed, or of another version of "
                "fenics_rom; remove it"
            )
        return [(tuple(point), *others) for point, *others in map(json.loads, lines)]
    except OSError as error:
        raise FileError(f"{file}: cannot be used: {error.strerror}") from error
    except (TypeError, ValueError) as error:
        raise FileError(f"{file}: does not hold runs of a certificate; remove it") from error
