"""Signals from CSV files, whose first row names the columns."""

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.signals import Signal


class SignalTables:
    """The tables that a scene names.

    Args:
        folder: what their paths are relative to.
        given: tables by name, as they travel with a ROM; read from files where this is None.

    Attributes:
        found: those that were asked for, by name.
    """

    def __init__(self, folder: Path, given: Mapping[str, np.ndarray] | None):
        self._folder, self._given = folder, given
        self.found: dict[str, np.ndarray] = {}

    def signal(self, name: str, columns: int | None) -> Signal:
        """The signal of a table, of so many columns beside the time; None: of any number. SceneError of others."""
        if name not in self.found:
            if self._given is not None and name not in self._given:
                raise SceneError(f"force table {name}: did not come with the scene")
            self.found[name] = read_table(self._folder / name) if self._given is None else self._given[name]
        table = self.found[name]
        _check_table(table, name, columns)
        return Signal(table[:, 1:].copy(), table[:, 0].copy())


def unread_signal(name: str, columns: int | None) -> Signal:
    """Stands for the signal of a table until it is read."""
    return Signal(np.zeros(columns or 1))


def read_table(file: Path) -> np.ndarray:
    """Times and values (times, 1 + columns) of a file; SceneError where it cannot be read, or holds something else."""
    try:
        if file.exists() and not file.is_file():  # a device may have no end, a pipe no beginning
            raise SceneError(f"force table {file}: cannot be read: is a folder or a device")
        with file.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise SceneError(f"force table {file}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if not rows or all(_is_number(cell) for cell in rows[0]):
        raise SceneError(f"force table {file}: its first row must name the columns, such as: time, x, y, z")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(rows[0]):
            raise SceneError(f"force table {file}: row {number} has {len(row)} columns, the first has {len(rows[0])}")
        for cell in row:
            if not _is_number(cell):
                raise SceneError(f"force table {file}: row {number}: {cell!r} is not a number")
    return np.array([[float(cell) for cell in row] for row in rows[1:]], dtype=float)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _check_table(table: np.ndarray, name: str, columns: int | None) -> None:
    if table.ndim != 2 or table.shape[0] < 2 or table.shape[1] < 2:
        raise SceneError(f"force table {name}: allowed are two or more rows: time in s, forces in N")
    if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise SceneError(f"force table {name}: allowed are finite numbers and strictly increasing times")
    if columns is not None and table.shape[1] != 1 + columns:
        raise SceneError(
            f"table {name}: columns beside the time: given {table.shape[1] - 1}, allowed {columns} for what uses it"
        )
