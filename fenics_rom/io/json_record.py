"""Frozen records in JSON files, from which interrupted work goes on."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import make_folder, write_whole

T = TypeVar("T")


def write_record(file: Path, record: Any) -> None:
    """Writes a dataclass of numbers, texts and their like, or nothing; FileError where the file cannot be written."""
    write_whole(file, json.dumps(asdict(record), indent=1).encode())


def read_record(file: Path, what: str, make: Callable[[dict[str, Any]], T]) -> T:
    """The record that `make` makes of a file; FileError where there is none, or it does not hold `what`."""
    try:
        return make(json.loads(file.read_text()))
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FileError(f"{file}: does not hold {what}") from error


def read_earlier(file: Path, read: Callable[[Path], T], resume: bool) -> T | None:
    """What interrupted work left, where it is to go on; makes the folder where it is missing."""
    make_folder(file.parent)
    return read(file) if resume and file.exists() else None
