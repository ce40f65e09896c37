"""The JSON file in which a study keeps what it has measured, and from which an interrupted one goes on."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import write_whole

T = TypeVar("T")


def write_json(file: Path, results: Any) -> None:
    """Writes results, a dataclass, or nothing.

    Raises:
        FileError: the file cannot be written.
    """
    write_whole(file, json.dumps(asdict(results), indent=1).encode())


def read_json(file: Path, build: Callable[[dict[str, Any]], T], what: str) -> T:
    """Reads results.

    Args:
        file: that `write_json` has written.
        build: makes the results of the numbers and texts that the file holds.
        what: the file should hold, for the message.

    Raises:
        FileError: there is no such file, or it holds something else.
    """
    try:
        return build(json.loads(file.read_text()))
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FileError(f"{file}: does not hold {what}") from error


def read_earlier(file: Path, read: Callable[[Path], T], resume: bool) -> T | None:
    """What an interrupted study left, where it is to go on; makes the folder where it is missing.

    Raises:
        FileError: the folder cannot be made, or the file holds something else.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{file.parent}: cannot be made: {error.strerror}") from error
    return read(file) if resume and file.exists() else None
