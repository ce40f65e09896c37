"""What a study leaves in its folder for people to read: tables and pictures."""

from pathlib import Path

from fenics_rom.io.atomic_write import write_whole
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.studies.study_results import StudyResults
from fenics_rom.studies.tables import csv_table, markdown_report


def write_report(folder: Path, results: StudyResults, command: str) -> None:
    """Writes study.csv, study.md, and the pictures speed, orders and parts; under MPI, rank 0 does.

    Args:
        folder: where.
        results: of the study.
        command: that made them, as it is typed.

    Raises:
        FileError: a file cannot be written.
    """
    if not is_rank_0():
        return
    from fenics_rom.studies.plots import draw

    write_whole(folder / "study.csv", csv_table(results).encode())
    write_whole(folder / "study.md", markdown_report(results, command).encode())
    draw(results, folder)
