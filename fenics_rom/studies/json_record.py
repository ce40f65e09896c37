"""Frozen records in JSON files, from which interrupted work goes on."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import make_folder, system_reason, write_whole
from fenics_rom.io.mpi_ranks import is_rank_0

T = TypeVar("T")


def write_record(file: Path, record: Any) -> None:
    """Writes a dataclass of numbers, texts and their like, or nothing; FileError where the file cannot be written."""
    write_whole(file, json.dumps(asdict(record), indent=1).encode())


def read_record(file: Path, kind: type[T], what: str) -> T:
    """The dataclass of a kind in a file; FileError where there is none, or it does not hold `what`."""
    try:
        return TypeAdapter(kind).validate_python(json.loads(file.read_text()))
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # pydantic's, too
        raise FileError(f"{file}: does not hold {what}") from error


def read_earlier(file: Path, kind: type[T], what: str, resume: bool) -> T | None:
    """What interrupted work left, where it is to go on; makes the folder where it is missing."""
    make_folder(file.parent)
    return read_record(file, kind, what) if resume and file.exists() else None


def discard_record(file: Path) -> None:
    """Removes a record, if there is one, before files beside it are written anew: it tells that they belong together.

    Under MPI rank 0 does. FileError where it cannot be removed.
    """
    if not is_rank_0():
        return
    try:
        file.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(f"{file}: cannot be removed: {system_reason(error)}") from error
