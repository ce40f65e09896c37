"""Tables in CSV files whose first row names the columns; whatever is wrong is told with its line and column."""

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import FenicsRomError

COLUMN_PATTERN = re.compile(r"(?P<what>[^()]*?)\s*\((?P<unit>[^()]*)\)")


@dataclass(frozen=True)
class Table:
    """The cells of a CSV file, and where they are."""

    file: Path  # it was read from
    error: type[FenicsRomError]  # raised where a cell cannot be used
    heading: tuple[str, ...]  # names of the columns, each once
    lines: tuple[int, ...]  # (T,) of the file
    cells: tuple[tuple[str, ...], ...]  # (T, columns) texts without spaces around them

    def refuse(self, line: int, column: str, what: str) -> NoReturn:
        """Raises the table's error about a cell."""
        raise self.error(f"{self.file}, line {line}, column {column!r}: {what}")

    def unit(self, column: str, units: Mapping[str, float], *, bare: bool = False) -> tuple[str, float]:
        """A column's name without its unit, and what that is in SI units; `bare`: where none is named, these."""
        match = COLUMN_PATTERN.fullmatch(column)
        if match is None and bare:
            return column, 1.0
        if match is None or match["unit"].strip() not in units:
            given = "no unit" if match is None else f"unit {match['unit']!r}"
            self.refuse(1, column, f"{given}; use a name and one of {', '.join(f'({unit})' for unit in units)}")
        return match["what"], units[match["unit"].strip()]

    def numbers(self, column: str, factor: float = 1.0, *, empty: bool = False) -> Array:
        """A column of finite numbers times a factor, (T,); NaN where it is empty and may be."""
        k, values = self.heading.index(column), []
        for line, cells in zip(self.lines, self.cells, strict=True):
            try:
                value = float(cells[k]) if cells[k] or not empty else None
            except ValueError:
                value = math.nan
            if value is not None and not math.isfinite(value):
                allowed = "a finite number, or nothing" if empty else "a finite number"
                self.refuse(line, column, f"{cells[k]!r} was given; use {allowed}")
            values.append(math.nan if value is None else factor * value)
        return np.array(values)


def read_table(file: Path, error: type[FenicsRomError]) -> Table:
    """Reads a CSV file, UTF-8 with or without a byte order mark, of at least one row; empty lines are passed over.

    Raises `error` where it cannot be read, names a column twice, or has rows of other lengths.
    """
    try:
        if file.exists() and not file.is_file():  # a device may have no end, a pipe no beginning
            raise error(f"{file}: cannot be read: is a folder or a device")
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            rows = [(reader.line_num, tuple(map(str.strip, row))) for row in reader if any(map(str.strip, row))]
    except UnicodeDecodeError as reason:
        raise error(f"{file}: is no text in UTF-8, at byte {reason.start}: use a CSV file, saved as UTF-8") from reason
    except (OSError, ValueError, csv.Error) as reason:
        raise error(f"{file}: cannot be read: {getattr(reason, 'strerror', None) or reason}") from reason
    if len(rows) < 2:
        raise error(f"{file}: use a line that names the columns and at least one line of data")
    heading = rows[0][1]
    for k, name in enumerate(heading):
        if name in heading[:k]:
            raise error(f"{file}, line 1: column {name!r} is there twice")
    for line, cells in rows[1:]:
        if len(cells) != len(heading):
            raise error(f"{file}, line {line}: has {len(cells)} cells; use {len(heading)}, as in line 1")
    return Table(file, error, heading, tuple(line for line, _ in rows[1:]), tuple(cells for _, cells in rows[1:]))
