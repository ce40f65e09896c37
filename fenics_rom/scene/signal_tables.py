"""Signals from CSV files, whose first row names the columns, and may name their units; and surfaces in files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.io.tables import Table, read_table
from fenics_rom.io.units import QUANTITIES, UNITS
from fenics_rom.mechanics.base_path import BasePath
from fenics_rom.mechanics.signals import Signal
from fenics_rom.scene.surface_file import FileTriangles, read_surface

POSES = {"time": "s"} | dict.fromkeys(("position.x", "position.y", "position.z"), "m")
POSES |= dict.fromkeys(("rotation.w", "rotation.x", "rotation.y", "rotation.z"), "1")
TWISTS = dict.fromkeys(("velocity.x", "velocity.y", "velocity.z"), "m/s")
TWISTS |= dict.fromkeys(("angular_velocity.x", "angular_velocity.y", "angular_velocity.z"), "rad/s")


class SignalTables:
    """The tables that a scene names, and its surfaces: rows (T, 9) of the corners of triangles.

    Args:
        folder: what their paths are relative to.
        given: tables by name, as they travel with a scene; read from files where this is None.
        load_units: SI units of the numbers of those that loads of the run name.

    Attributes:
        found: those that were asked for, by name, in SI units.
    """

    def __init__(self, folder: Path, given: Mapping[str, np.ndarray] | None, load_units: Mapping[str, set[str]]):
        self._folder, self._given, self._load_units = folder, given, load_units
        self._read: dict[str, Table] = {}
        self.found: dict[str, np.ndarray] = {}

    def signal(self, name: str, columns: int | None, unit: str) -> Signal:
        """The signal of a table, of so many columns beside the time; None: of any number. SceneError of others."""
        if self._given is None:
            for of in {unit} if unit else self._load_units[name]:
                self.found[name] = self._from_file(name, of)
        table = self._known(name)
        _check_table(table, name, columns)
        return Signal(table[:, 1:].copy(), table[:, 0].copy())

    def _known(self, name: str) -> np.ndarray:
        """The numbers of a table that was read, or that came with the scene."""
        if self._given is not None and name not in self._given:
            raise SceneError(f"table {name}: did not come with the scene")
        if self._given is not None:
            self.found[name] = self._given[name]
        return self.found[name]

    def path(self, name: str) -> BasePath:
        """The poses of a table and, if it has them, the twists. SceneError of others."""
        if self._given is None:
            try:
                self.found[name] = _path_columns(read_table(self._folder / name, SceneError))
            except SceneError as error:
                raise SceneError(f"table {error}") from error
        table = self._known(name)
        has_twists = table.ndim == 2 and table.shape[1] > len(POSES)
        _check_table(table, name, len(POSES | TWISTS if has_twists else POSES) - 1)
        times, *parts = np.split(table, (1, 4, 8, 11) if has_twists else (1, 4), axis=1)
        return BasePath(times[:, 0], *parts)

    def triangles(self, name: str) -> FileTriangles:
        """Those of a surface. SceneError of what is none."""
        if self._given is None:
            try:
                self.found[name] = read_surface(self._folder / name).corners.reshape(-1, 9)
            except SceneError as error:
                raise SceneError(f"surface {error}") from error
        corners = self._known(name)
        if corners.ndim != 2 or corners.shape[1] != 9:
            raise SceneError(f"surface {name}: use rows of nine numbers, the corners of triangles")
        return FileTriangles(corners.reshape(-1, 3, 3))

    def _from_file(self, name: str, unit: str) -> np.ndarray:
        """Times and values (times, 1 + columns), where its first row says nothing else than that unit."""
        try:
            if name not in self._read:
                self._read[name] = read_table(self._folder / name, SceneError)
            table = self._read[name]
            factors = _factors(table, unit)
            columns = zip(table.heading, factors, strict=True)
            return np.stack([table.numbers(column, factor) for column, factor in columns], axis=1)
        except SceneError as error:
            raise SceneError(f"table {error}") from error


class UnreadTables:
    """Stands for the tables until they are read."""

    def signal(self, name: str, columns: int | None, unit: str) -> Signal:
        """See SignalTables."""
        return Signal(np.zeros(columns or 1))

    def path(self, name: str) -> BasePath:
        """See SignalTables."""
        return BasePath(np.arange(2.0), np.zeros((2, 3)), np.ones((2, 4)) / 2)

    def triangles(self, name: str) -> FileTriangles:
        """See SignalTables; a tetrahedron."""
        return FileTriangles(np.vstack([np.zeros(3), np.eye(3)])[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]])


def _path_columns(table: Table) -> np.ndarray:
    """Time, poses and, if they are there, twists, (T, 8 or 14), in SI units."""
    allowed = POSES if len(table.heading) <= len(POSES) else POSES | TWISTS
    columns = []
    for k, (name, unit) in enumerate(allowed.items()):
        if k >= len(table.heading):
            table.refuse(1, table.heading[-1], f"is the last; {name} ({unit}) is missing: use {_named(POSES)}")
        column = table.heading[k]
        named, factor = table.unit(column, UNITS.get(unit, {unit: 1.0}), bare=True)
        if named.lower() != name and not (name == "time" and named.lower() == "t"):
            table.refuse(1, column, f"use here {name} ({unit}); of all {_named(POSES)}, then {_named(TWISTS)}")
        columns.append(table.numbers(column, factor))
    return np.stack(columns, axis=1)


def _named(columns: Mapping[str, str]) -> str:
    return ", ".join(columns)


def _factors(table: Table, unit: str) -> list[float]:
    """What each column is in SI units: of time, then of numbers in that unit; three of them are along x, y and z."""
    first, *others = table.heading
    named, seconds = table.unit(first, UNITS["s"], bare=True)
    if named.lower() not in ("time", "t"):
        table.refuse(1, first, f"its first row must name the columns, time first, such as: time (s), x ({unit}), ...")
    factors = [seconds]
    for k, column in enumerate(others):
        named, factor = table.unit(column, UNITS[unit], bare=True)
        for word in named.lower().replace(".", " ").replace("_", " ").split():
            if QUANTITIES.get(word, unit) != unit:
                table.refuse(1, column, f"is a {word}; use numbers in {unit}")
        if len(others) == 3 and named.lower()[-1:] != "xyz"[k]:
            table.refuse(1, column, "use x, y and z in this order, alone or after a name, as in force.x")
        factors.append(factor)
    return factors


def _check_table(table: np.ndarray, name: str, columns: int | None) -> None:
    if table.ndim != 2 or table.shape[0] < 2 or table.shape[1] < 2:
        raise SceneError(f"table {name}: use two or more rows, of a time and one number or more")
    if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise SceneError(f"table {name}: use finite numbers and strictly increasing times")
    if columns is not None and table.shape[1] != 1 + columns:
        raise SceneError(
            f"table {name}: use {columns} column{'s' * (columns > 1)} beside the time (got {table.shape[1] - 1})"
        )
