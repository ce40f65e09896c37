"""HDF5 files that are what they say: arrays in tables of name, unit, kind and shape, checked on writing and reading.

A file is written beside its place and renamed, so there is never half a file. Under MPI rank 0 alone writes.

The first 512 bytes are a user block, which HDF5 leaves to whoever wrote the file. Here it seals the rest: a line of
text with its SHA-256. No bit of a file can change unnoticed, and HDF5, which crashes on some damaged files, sees none.
"""

import hashlib
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy import ndarray as Array

from fenics_rom import version
from fenics_rom.arguments import path_in
from fenics_rom.errors import FenicsRomError, FileError, RomFileError, TrajectoryFileError
from fenics_rom.io.atomic_write import check_place, system_reason, write_whole
from fenics_rom.io.mpi_ranks import is_rank_0
from fenics_rom.io.names import NAME, NAME_IN_WORDS

FORMAT = "fenics-rom"
VERSION = "2.8"
READ_VERSIONS = ("1", "2")  # first numbers of those that can be read
LONGEST_TEXT = 60_000  # bytes; HDF5 keeps attributes in a header of 64 KiB
SEAL_SIZE = 512  # bytes; the smallest user block there is
KINDS = {  # of files by their content, in words
    "rom": "a ROM",
    "run": "a run",
    "part": "a contact mode of an unfinished reduction",
    "training run": "a training run of an unfinished reduction",
    "solve": "a solution of an unfinished reduction",
}
ERROR_OF: dict[str, type[FileError]] = {"rom": RomFileError, "run": TrajectoryFileError}  # of files with that content

T = TypeVar("T")
Sizes = dict[str, int]


@dataclass(frozen=True)
class Entry:
    """What one dataset is."""

    unit: str  # "1" for a pure number
    shape: tuple[str | int, ...]  # numbers, or names of sizes that must agree wherever they occur
    kind: str = "f"  # "f" real or "i" whole numbers
    optional: bool = False  # whether it may be absent


Table = Mapping[str, Entry]


def write_file(file: str | Path, content: str, fill: Callable[[h5py.File], None]) -> None:
    """Writes a file of some content, such as "rom" or "run", or nothing.

    Raises:
        FileError: it cannot be written, or its content does not hold together; of a ROM RomFileError, of a run
            TrajectoryFileError.
    """
    path = path_in("write", file, ERROR_OF.get(content, FileError))
    if not is_rank_0():
        return
    try:
        check_place(path)
        memory = io.BytesIO()  # not the disk: HDF5 does not take it well when that is full
        with h5py.File(memory, "w", track_order=True, userblock_size=SEAL_SIZE) as h5:
            put_text(h5, format=FORMAT, format_version=VERSION, content=content, software=f"{FORMAT} {version.VERSION}")
            fill(h5)
        with memory.getbuffer() as whole, whole[SEAL_SIZE:] as rest:  # let go of, also where writing fails
            write_whole(path, sealed(whole), rest)
    except FileError as error:
        raise ERROR_OF.get(content, FileError)(str(error)) from error
    except OSError as error:
        raise ERROR_OF.get(content, FileError)(f"{path}: cannot be written: {system_reason(error)}") from error


def read_file(
    file: str | Path,
    content: str,
    take: Callable[[h5py.File], T],
    upgrade: Callable[[h5py.File], None] = lambda h5: None,
) -> T:
    """Reads a file of that content.

    Args:
        file: path.
        content: such as "rom" or "run".
        take: reads what is in a file of this release's format.
        upgrade: makes what is in a copy, in memory, of a file of format 1.x what a file of this release has.

    Raises:
        FileError: it is missing, damaged, of another format, or its content does not hold together; of a ROM
            RomFileError, of a run TrajectoryFileError.
    """
    path = path_in("read", file, ERROR_OF.get(content, FileError))
    with _errors_of_reading(path, ERROR_OF.get(content, FileError)), _opened(path) as h5:
        given = get_text(h5, "content")
        if given != content:
            raise FileError(f"is {KINDS.get(given, f'a {given}')}; use {KINDS.get(content, f'a {content}')}")
        if get_text(h5, "format_version").startswith(VERSION.partition(".")[0]):
            return take(h5)
        with h5py.File(io.BytesIO(), "w") as copy:
            for name in h5:
                h5.copy(name, copy)
            copy.attrs.update(h5.attrs)
            upgrade(copy)
            return take(copy)


def content_of(file: str | Path) -> str:
    """What a file holds, "rom" or "run".

    Raises:
        FileError: it is no such file.
    """
    content = sealed_content(file)
    if content not in ERROR_OF:
        raise FileError(f"{file}: holds neither a rom nor a run")
    return content


def sealed_content(file: str | Path) -> str:
    """What a file holds that this package has written, whatever it is; FileError where it is none, or damaged."""
    path = path_in("read", file)
    with _errors_of_reading(path, FileError), _opened(path) as h5:
        return get_text(h5, "content")


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """A file that is whole, and of a format that this release reads."""
    if not path.is_file():
        raise FileError("is a folder or a device" if path.exists() else "not found")
    _check_seal(path)
    with h5py.File(path, "r") as h5:
        if get_text(h5, "format") != FORMAT:
            raise FileError("is not a fenics-rom file")
        version = get_text(h5, "format_version")
        if version.split(".")[0] not in READ_VERSIONS:
            raise FileError(f"has format version {version}; this release reads {' and '.join(READ_VERSIONS)}.x")
        yield h5


@contextmanager
def _errors_of_reading(path: Path, kind: type[FileError]) -> Iterator[None]:
    """Whatever goes wrong while a file is read, as one kind of error that names it."""
    try:
        yield
    except FenicsRomError as error:
        raise kind(f"{path}: {error}") from error
    except (OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError, MemoryError) as error:
        raise kind(f"{path}: cannot be read: {system_reason(error)}") from error


def sealed(content: bytes | memoryview) -> bytes:
    """The user block that belongs to a whole file: the seal of what follows it."""
    return _seal(hashlib.sha256(memoryview(content)[SEAL_SIZE:]).hexdigest())


def _check_seal(path: Path) -> None:
    with path.open("rb", buffering=0) as stream:
        seal = stream.read(SEAL_SIZE)
        if not seal.startswith(f"{FORMAT} ".encode()):
            hint = "; of a scene `reduce` makes a ROM and `simulate` a run" if path.suffix == ".toml" else ""
            raise FileError(f"is not a fenics-rom file{hint}")
        if seal != _seal(hashlib.file_digest(stream, "sha256").hexdigest()):  # of what is still to be read
            raise FileError("is damaged: its content is not what was written (the checksum differs)")


def _seal(digest: str) -> bytes:
    return f"{FORMAT} HDF5 file; SHA-256 from byte {SEAL_SIZE}: {digest}\n".encode().ljust(SEAL_SIZE, b"\0")


def is_sealed(file: str | Path) -> bool:
    """Whether a file begins as those of this package do, a ROM or a run, damaged or not."""
    path = path_in("read", file)
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with path.open("rb") as stream:
            return stream.read(len(FORMAT) + 1) == f"{FORMAT} ".encode()
    except OSError:  # whoever reads it is told why
        return False


def check_names(names: Iterable[str]) -> None:
    """Checks names that are to become names in a file; FileError where one of them cannot."""
    for name in names:
        if not NAME.fullmatch(name):
            raise FileError(f"name {name!r}: use {NAME_IN_WORDS}")


def put_text(group: h5py.Group, **texts: str) -> None:
    """Keeps short texts as attributes; FileError where a text is too long for an attribute."""
    for name, text in texts.items():
        data = text.encode(errors="replace")  # a name of a file may be no UTF-8
        if len(data) > LONGEST_TEXT:
            raise FileError(f"text {name!r} has {len(data)} bytes; at most {LONGEST_TEXT}")
        group.attrs[name] = np.bytes_(data) if data else h5py.Empty("S1")


def get_text(group: h5py.Group, name: str) -> str:
    """A text that `put_text` kept; FileError where it is missing or not text."""
    value = group.attrs.get(name)
    if isinstance(value, h5py.Empty):
        return ""
    if not isinstance(value, bytes):
        raise FileError(f"attribute {name!r} of {group.name} is missing or not text")
    try:
        return value.decode()
    except UnicodeDecodeError as error:
        raise FileError(f"attribute {name!r} of {group.name} is not UTF-8") from error


def put_arrays(group: h5py.Group, table: Table, sizes: Sizes, arrays: Mapping[str, Any]) -> None:
    """Writes arrays and numbers of a table; None leaves an optional one out; FileError of those that do not fit."""
    for name, entry in table.items():
        array = arrays[name]
        if array is None:
            if not entry.optional:
                raise FileError(f"{group.name.rstrip('/')}/{name} is missing")
            continue
        array = np.atleast_1d(np.asarray(array, dtype=np.int64 if entry.kind == "i" else np.float64))
        _check(f"{group.name.rstrip('/')}/{name}", array, entry, sizes)
        dataset = group.create_dataset(name, data=array)
        dataset.attrs["unit"] = np.bytes_(entry.unit.encode())


def get_arrays(group: h5py.Group, table: Table, sizes: Sizes, others: tuple[str, ...] = ()) -> dict[str, Array | None]:
    """Reads the arrays of a table from a group, which may hold nothing else but `others`; FileError of all else."""
    there = set(group)
    if extra := there - set(table) - set(others):
        shown = (name if NAME.fullmatch(name) else repr(name) for name in sorted(extra))
        raise FileError(f"unexpected {', '.join(shown)} in {group.name}")
    arrays: dict[str, Array | None] = {}
    for name, entry in table.items():
        where = f"{group.name.rstrip('/')}/{name}"
        if name not in there:
            if not entry.optional:
                raise FileError(f"{where} is missing")
            arrays[name] = None
            continue
        dataset = _stored_here(group, name, h5py.Dataset)
        if dataset is None or dataset.dtype.kind != entry.kind or dataset.dtype.itemsize != 8:
            raise FileError(f"{where} is not an array of {'whole' if entry.kind == 'i' else 'real'} numbers")
        size = 8 * math.prod(dataset.shape)  # Python's whole numbers: NumPy's would overflow
        if size > dataset.id.get_storage_size():  # a size that lies would be answered with memory
            raise FileError(f"{where} says it has {size} bytes, but fewer are stored")
        if dataset.is_virtual or dataset.external or dataset.chunks:  # elsewhere, or in less room than it takes
            raise FileError(f"{where} is not stored in one piece")
        if get_text(dataset, "unit") != entry.unit:
            raise FileError(f"{where} has unit {get_text(dataset, 'unit')!r}, not {entry.unit!r}")
        array = dataset[()]
        _check(where, array, entry, sizes)
        arrays[name] = array
    return arrays


def get_record(
    group: h5py.Group, table: Table, sizes: Sizes | None = None, others: tuple[str, ...] = ()
) -> dict[str, Any]:
    """The same as records have it: a number, or a tuple of some, where the table says how many there are."""
    found = get_arrays(group, table, {} if sizes is None else sizes, others)
    return {name: array if array is None else _of_record(array, table[name]) for name, array in found.items()}


def _of_record(array: Array, entry: Entry) -> Any:
    if len(entry.shape) > 1 or isinstance(entry.shape[0], str):
        return array
    return array[0].item() if entry.shape == (1,) else tuple(array.tolist())


def put_each(
    parent: h5py.Group, kind: str, entry: Entry, arrays: Mapping[str, Any], sizes: Mapping[str, int] | None = None
) -> None:
    """Writes a group of arrays of one kind by name, each with sizes of its own beside those that are given."""
    group = parent.create_group(kind, track_order=True)
    for name, array in arrays.items():
        put_arrays(group, {name: entry}, dict(sizes or {}), {name: array})


def get_each(group: h5py.Group, entry: Entry, sizes: Mapping[str, int] | None = None) -> dict[str, Any]:
    """Reads what `put_each` wrote."""
    return {name: get_record(group, {name: entry}, dict(sizes or {}), tuple(group))[name] for name in group}


def rename_all(h5: h5py.Group, names: Mapping[str, str]) -> None:
    """Gives what is in a group other names, new ones by old ones; what is not there is passed over."""
    for old, new in names.items():
        if old in h5:
            h5.move(old, new)


def get_group(parent: h5py.Group, name: str) -> h5py.Group:
    """A group that must be there; FileError where it is not."""
    group = _stored_here(parent, name, h5py.Group)
    if group is None:
        raise FileError(f"{parent.name.rstrip('/')}/{name} is missing")
    return group


def _stored_here(group: h5py.Group, name: str, kind: type[T]) -> T | None:
    """What has that name and is of that kind; None where it is not, or where a link leads elsewhere."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        return None
    item = group[name]
    return item if isinstance(item, kind) else None


def _check(where: str, array: Array, entry: Entry, sizes: Sizes) -> None:
    if array.ndim != len(entry.shape):
        raise FileError(f"{where} has {array.ndim} dimensions, not {len(entry.shape)}")
    for got, size in zip(array.shape, entry.shape, strict=True):
        expected = sizes.setdefault(size, got) if isinstance(size, str) else size
        if got != expected:
            raise FileError(f"{where} has shape {array.shape}; use {entry.shape} with {size} = {expected}")
    if entry.kind == "f" and not np.isfinite(array).all():
        raise FileError(f"{where} holds numbers that are not finite")
