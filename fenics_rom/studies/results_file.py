"""The JSON file in which a study keeps what it has measured, and from which an interrupted one goes on."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from fenics_rom.errors import FileError
from fenics_rom.io.hdf5 import write_whole

T = TypeVar("T")


class Dataclass(Protocol):
    """An instance of any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


def write_json(file: Path, results: Dataclass) -> None:
    """Writes results, or nothing.

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


def make_folder(folder: Path) -> None:
    """Makes a folder where it is missing.

    Raises:
        FileError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: cannot be made: {error.strerror}") from error
