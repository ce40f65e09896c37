"""What a region of a human body may feel in an impact: a table of examples, or one of the user's own.

The examples (body_regions.csv) are of short, free impacts (transient contact) after ISO/TS 15066:2016, Annex A: forces
and pressures are twice those of its Table A.2, the pressure that of the most sensitive place of the region (thresholds
of pain of 100 people: Muttray et al., University of Mainz, 2014), and the energy is F² / (2 k) with the stiffness k of
its Table A.3. It allows no such contact with the head. Before it is used for people, compare it with the standard that
applies.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_rom.errors import DataError, check_known
from fenics_rom.io.tables import read_table

EXAMPLES = Path(__file__).with_name("body_regions.csv")
COLUMNS = {"force": ("force_N", 1.0), "pressure": ("pressure_N_per_cm2", 1e4), "energy": ("energy_J", 1.0)}


@dataclass(frozen=True)
class Limits:
    """Of a region, in SI units by quantity; one without a limit is not there."""

    region: str
    of: Mapping[str, float]
    source: str


def read_limits(region: str, file: Path = EXAMPLES) -> Limits:
    """A row of a table; an empty cell is no limit.

    Raises:
        DataError: the table lacks columns or the region, or has limits that are none.
    """
    table = read_table(file, DataError)
    columns = ("region", *(column for column, _ in COLUMNS.values()), "source")
    missing = [column for column in columns if column not in table.heading]
    if missing:
        raise DataError(f"{file}, line 1: column {missing[0]!r} is missing; use {', '.join(columns)}")
    regions = [cells[table.heading.index("region")] for cells in table.cells]
    check_known("region", region, regions, DataError, f"{file}: ")
    row, of = regions.index(region), dict[str, float]()
    for quantity, (column, factor) in COLUMNS.items():
        value = table.numbers(column, factor, empty=True)[row]
        if value <= 0:
            table.refuse(table.lines[row], column, "use a number > 0, or nothing")
        if not np.isnan(value):
            of[quantity] = float(value)
    return Limits(region, of, table.cells[row][table.heading.index("source")])
