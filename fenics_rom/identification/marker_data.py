"""Measured displacements of markers, from CSV files whose header names every column with its unit.

A motion has its times in the first column, `time (s)`. It is a measurement of the scene's [run]; displacements count
from the shape of the mesh. Where a file has times before 0, when the body was still as its run begins, they count from
the mean of what was seen then, and so positions in place of displacements will do.

Equilibria have the name of a contact mode in the first column, `contact`, and its force in `force.x (N)`,
`force.y (N)`, `force.z (N)` (or `force.normal (N)`, where the mode's force is "normal"). Every row is an equilibrium
under that force, gravity, and prescribed forces that are constant.

The other columns are displacements: `NAME.x (m)` of an output of one point, `NAME[2].x (m)` of the third point of an
output. An empty cell is a marker that was not seen, or a component of the force that is zero.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import path_in
from fenics_rom.errors import DataError, check_type, unknown
from fenics_rom.io.tables import Table, read_table
from fenics_rom.io.units import UNITS
from fenics_rom.scene.scene import Scene

FORCES = {"resultant": ("force.x", "force.y", "force.z"), "normal": ("force.normal",)}  # of contact modes
AXES = ("x", "y", "z")
MARKER_PATTERN = re.compile(r"(?P<output>[\w-]+)(?:\[(?P<point>\d+)\])?\.(?P<axis>[xyz])")
END_TOLERANCE = 1e-9  # share of the run by which a time may be beyond its end, for round-off


@dataclass(frozen=True)
class Marker:
    """One component of the displacement of one point."""

    output: str  # or reading of a marker
    point: int
    axis: int

    @property
    def row(self) -> int:
        """Among the rows of the output."""
        return 3 * self.point + self.axis


@dataclass(frozen=True)
class Displacements:
    """What markers did."""

    scene: Scene  # that was measured
    file: str  # where it is from
    lines: Array  # (T,) of the file
    columns: tuple[str, ...]  # name of each marker's column
    markers: tuple[Marker, ...]  # (C,)
    measured: Array  # (T, C), m; NaN where a marker was not seen


@dataclass(frozen=True)
class Motion(Displacements):
    """What was measured in the scene's run, at times (T,), s."""

    times: Array
    relative: bool = False  # whether displacements count from where the run begins


@dataclass(frozen=True)
class Equilibria(Displacements):
    """What was measured at rest under known forces."""

    contacts: tuple[str, ...]  # contact mode of each row, (T,)
    forces: tuple[Array, ...]  # its force, (columns of the contact mode,) each, N


Data = Motion | Equilibria


def read_markers(file: str | Path, scene: Scene) -> Data:
    """Reads one file of a scene's outputs, contact modes and run, which `identify` takes beside those of other scenes.

    Raises:
        DataError: it cannot be read, or a line or column of it is not as it should be.

    Example:
        >>> fr.read_markers("markers.csv", scene).columns[0]
        'tip[0].x'
    """
    check_type("read_markers", scene, Scene, "fr.read_scene(file)")
    table = read_table(path_in("read_markers", file, DataError), DataError)
    first = table.heading[0]
    if first == "contact":
        return _equilibria(table, scene)
    if first.startswith("time"):
        return _motion(table, scene)
    table.refuse(1, first, "the first column must be one of 'time (s)', 'time (ms)' and 'contact'")


def clocks_of(motions: Sequence[Motion]) -> list[tuple[str, float]]:
    """Name of the clock of each file, and the time between two of its frames, s, which it may well be late by."""
    names = [Path(part.file).name for part in motions]
    spans = [float(np.diff(part.times, prepend=0.0).max()) for part in motions]
    return list(zip(names if len(set(names)) == len(names) else [part.file for part in motions], spans, strict=True))


def _numbers(table: Table, column: str, units: Mapping[str, float], *, empty: bool = False) -> Array:
    """A column in SI units; NaN where it is empty and may be."""
    return table.numbers(column, table.unit(column, units)[1], empty=empty)


def _motion(table: Table, scene: Scene) -> Motion:
    if scene.run is None:
        raise DataError(f"{table.file}: has times, but {scene.source} has no [run] that they could be of")
    column = table.heading[0]
    if table.unit(column, UNITS["s"])[0] != "time":
        table.refuse(1, column, "the first column must be one of 'time (s)', 'time (ms)' and 'contact'")
    times = _numbers(table, column, UNITS["s"])
    end = round(scene.run.duration / scene.run.dt) * scene.run.dt
    for k, time in enumerate(times):
        if not time <= end * (1 + END_TOLERANCE):
            table.refuse(table.lines[k], column, f"{time:g} s was given; use up to the run's end, {end:g} s")
        if k and time <= times[k - 1]:
            table.refuse(table.lines[k], column, f"{time:g} s follows {times[k - 1]:g} s; use times that increase")
    seen = _read_displacements(table, table.heading[1:], scene)
    before = times < 0
    if before.all():
        raise DataError(f"{table.file}: has times before 0 alone; use some of the run, which begins at 0 s")
    if not before.any():
        return Motion(times=times, **vars(seen))
    for k, column in enumerate(seen.columns):
        if np.isnan(seen.measured[before, k]).all():
            raise DataError(f"{table.file}: {column!r} was not seen before 0 s, where its displacements count from")
    start = np.nanmean(seen.measured[before], axis=0)
    moving = replace(seen, lines=seen.lines[~before], measured=seen.measured[~before] - start)
    return Motion(times=times[~before], relative=True, **vars(moving))


def _equilibria(table: Table, scene: Scene) -> Equilibria:
    of_force = [column for column in table.heading if column.startswith("force")]
    if not of_force:
        raise DataError(f"{table.file}, line 1: no force was given; use 'force.x (N)', ... and 'force.normal (N)'")
    given = {table.unit(column, UNITS["N"])[0]: column for column in of_force}
    for name, column in given.items():
        if name not in chain(*FORCES.values()):
            table.refuse(1, column, "use force.x, force.y, force.z and force.normal, in N")
    values = {name: _numbers(table, column, UNITS["N"], empty=True) for name, column in given.items()}
    contacts, forces = [], []
    for k, (line, (contact, *_)) in enumerate(zip(table.lines, table.cells, strict=True)):
        if contact not in scene.contacts:
            table.refuse(line, "contact", unknown("contact mode", contact, scene.contacts))
        kind = scene.contacts[contact].force
        if kind not in FORCES:
            allowed = " and ".join(map(repr, FORCES))
            has = "moments" if kind == "wrench" else "a force at every node"
            table.refuse(line, "contact", f"{contact!r} has {has}; use {allowed}")
        pushed = {name: column[k] for name, column in values.items() if not np.isnan(column[k])}
        has = f"contact mode {contact!r} has {', '.join(FORCES[kind])}"
        for name in pushed:
            if name not in FORCES[kind]:
                table.refuse(line, given[name], f"{has}; leave this cell empty")
        if not pushed:
            table.refuse(line, of_force[0], f"no force was given; {has}")
        contacts.append(contact)
        forces.append(np.array([pushed.get(name, 0.0) for name in FORCES[kind]]))
    others = [column for column in table.heading[1:] if column not in of_force]
    return Equilibria(contacts=tuple(contacts), forces=tuple(forces), **vars(_read_displacements(table, others, scene)))


def _read_displacements(table: Table, columns: Sequence[str], scene: Scene) -> Displacements:
    """What both kinds of data have."""
    if not columns:
        raise DataError(f"{table.file}, line 1: no marker was given; use columns such as 'NAME.x (m)'")
    seen = _points_of(scene)
    markers = tuple(_marker(table, column, seen) for column in columns)
    for k, marker in enumerate(markers):
        if marker in markers[:k]:
            table.refuse(1, columns[k], f"is the same marker as {columns[markers.index(marker)]!r}")
    measured = np.stack([_numbers(table, column, UNITS["m"], empty=True) for column in columns], axis=1)
    return Displacements(
        scene=scene,
        file=str(table.file),
        lines=np.array(table.lines),
        columns=tuple(table.unit(column, UNITS["m"])[0] for column in columns),
        markers=markers,
        measured=measured,
    )


def _points_of(scene: Scene) -> dict[str, int]:
    """Outputs and readings that markers can be, and how many points each has."""
    outputs = {name: len(output.points or output.markers or [()]) for name, output in scene.outputs.items()}
    return outputs | {name: 1 for name, reading in scene.readings.items() if reading.quantity == "marker"}


def _marker(table: Table, column: str, seen: Mapping[str, int]) -> Marker:
    name, _ = table.unit(column, UNITS["m"])
    match = MARKER_PATTERN.fullmatch(name)
    if match is None:
        table.refuse(1, column, "use 'NAME.x (m)' and 'NAME[2].x (m)', with x, y or z, of an output of the scene")
    output = match["output"]
    if output not in seen:
        table.refuse(1, column, unknown("output", output, seen))
    points = seen[output]
    if match["point"] is None and points > 1:
        table.refuse(1, column, f"output {output!r} has {points} points; use {output}[0] to {output}[{points - 1}]")
    point = int(match["point"] or 0)
    if point >= points:
        table.refuse(1, column, f"output {output!r} has no point [{point}]; use [0] to [{points - 1}]")
    return Marker(output, point, AXES.index(match["axis"]))
