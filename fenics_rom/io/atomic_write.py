"""Files that are there whole or not at all, and checks of where they are to go before the work that fills them."""

import os
from pathlib import Path

from fenics_rom.errors import FileError
from fenics_rom.io.mpi_ranks import is_rank_0


def write_whole(path: Path, *parts: bytes | memoryview) -> None:
    """Writes a file beside its place and renames it, so that there is never half of it; under MPI, rank 0 does.

    Of two that write one file at a time, the last one's stays. Where SIGKILL ends it meanwhile, `.NAME.*.part` is left
    beside the file, which nothing reads and which may be removed.

    Raises:
        FileError: it cannot be written.
    """
    if not is_rank_0():
        return
    import tempfile  # here, as who only reads a ROM need not wait for it

    temporary = None
    try:
        check_place(path)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as stream:
            for part in parts:
                stream.write(part)
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {system_reason(error)}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def check_place(path: Path) -> None:
    """Checks, before long work, that a file can be put there, and over nothing else: root could replace /dev/null."""
    if not path.parent.is_dir():
        raise FileError(f"{path}: cannot be written: folder {path.parent} does not exist")
    if path.exists() and not path.is_file():
        raise FileError(f"{path}: cannot be written: it is a folder or a device")
    if not os.access(path.parent, os.W_OK):
        raise FileError(f"{path}: cannot be written: no permission to write in {path.parent}")


def check_folder(folder: Path) -> None:
    """Checks, before long work, that a folder of results is there or can be made; FileError where it cannot."""
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder}: is a file; allowed is a folder, or a name that is free")
    if not folder.resolve().parent.is_dir():
        raise FileError(f"{folder}: cannot be made: folder {folder.resolve().parent} does not exist")


def make_folder(folder: Path) -> None:
    """Makes a folder of results where there is none; FileError where it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: cannot be made: {error.strerror}") from error


def system_reason(error: Exception) -> str:
    """The system's words, where there are some, and not HDF5's."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)
