"""Files that are there whole or not at all, and checks of where they are to go before the work that fills them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fenics_rom.errors import FileError
from fenics_rom.io.mpi_ranks import is_rank_0, is_root_process


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
    with _errors_of_place(path):
        _check_place(path)


@contextmanager
def _errors_of_place(path: Path) -> Iterator[None]:
    """What the system says of a place, as of a name that is too long, as a FileError."""
    try:
        yield
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {system_reason(error)}") from error


def _check_place(path: Path) -> None:
    if not path.parent.is_dir():
        raise FileError(f"{path}: cannot be written: folder {path.parent} does not exist")
    if path.exists() and not path.is_file():
        raise FileError(f"{path}: cannot be written: it is a folder or a device")
    if not os.access(path.parent, os.W_OK):
        raise FileError(f"{path}: cannot be written: no permission to write in {path.parent}")


def check_folder(folder: Path) -> None:
    """Checks, before long work, that a folder of results is there or can be made; FileError where it cannot."""
    with _errors_of_place(folder):
        _check_folder(folder)


def _check_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder}: is a file; use a folder, or a name that is free")
    if not folder.resolve().parent.is_dir():
        raise FileError(f"{folder}: cannot be made: folder {folder.resolve().parent} does not exist")


def make_folder(folder: Path) -> None:
    """Makes a folder of results where there is none; FileError where it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: cannot be made: {error.strerror}") from error


@contextmanager
def sole_writer(output: Path, folder: Path) -> Iterator[None]:
    """Holds the folder of what is unfinished of an output; a FileError says that another process does.

    The system lets go of it with the process, however that ends. Under MPI rank 0 holds it.
    """
    if not is_root_process():
        yield
        return
    handle = _hold(folder, output)
    try:
        yield
    finally:
        with suppress(OSError):  # it holds something, or is gone already
            folder.rmdir()
        os.close(handle)


def _hold(folder: Path, output: Path) -> int:
    """A locked handle of a folder, which is made where it is missing."""
    import fcntl  # which Windows, where the runtime works, has not

    while True:
        make_folder(folder)
        with suppress(FileNotFoundError):  # whoever held it has removed it since: the next folder is held
            handle = os.open(folder, os.O_RDONLY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                os.close(handle)
                raise FileError(f"{output}: another process is writing it; wait, or give another file") from error
            except OSError:  # a file system without locks
                return handle
            if os.path.samestat(os.fstat(handle), folder.stat()):
                return handle


def system_reason(error: Exception) -> str:
    """The system's words, where there are some, and not HDF5's."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)
