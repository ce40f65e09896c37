"""What may be written over: no file that the same work reads, and, unless that is forced, none of another kind."""

from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from fenics_rom.arguments import check_flag
from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import check_folder, check_place, system_reason
from fenics_rom.io.hdf5 import KINDS, is_sealed, sealed_content, write_file

FIRST_BYTES = {  # of files of other programs that begin so
    b"\x89HDF": "an HDF5 file of another program",
    b"\x89PNG": "a picture (PNG)",
    b"GIF8": "a film (GIF)",
    b"%PDF": "a PDF",
    b"PK\3\4": "an archive (ZIP)",
    b"MATLAB 5.0": "a file of MATLAB",
    b"$MeshFormat": "a mesh of Gmsh",
}
KIND_OF_ENDING = {".png": b"\x89PNG", ".gif": b"GIF8", ".pdf": b"%PDF", ".npz": b"PK\3\4", ".fmu": b"PK\3\4"}
KIND_OF_ENDING |= {".mat": b"MATLAB 5.0", ".msh": b"$MeshFormat"}
OTHER_ENDINGS = {
    *KIND_OF_ENDING,
    ".csv",
    ".txt",
    ".toml",
    ".json",
    ".svg",
    ".mp4",
    ".vtk",
    ".vtu",
    ".pvd",
    ".c",
    ".inp",
}


def check_outputs(
    *files: Path, content: str | None = None, inputs: Iterable[str | PathLike[str]] = (), force: bool = False
) -> None:
    """Checks, before long work, that files can be put where they are to go, and that nothing else is lost by that.

    Args:
        files: that will be written; an empty file is always written over.
        content: "rom", "run" or another one of KINDS; None: what the ending of each file says.
        inputs: files that the same work reads; none of them is written over, by whatever name or link, forced or not.
        force: whether an existing file of another kind is written over.

    Raises:
        FileError: a file cannot be put there, is one of the inputs, is there already and of another kind, or has the
            ending of another kind.
    """
    check_flag("force", force, FileError)
    read = [path for path in map(Path, inputs) if _is_there(path)]
    for file in files:
        check_place(file)
        if not file.exists():
            if content and not force and file.suffix in OTHER_ENDINGS:
                raise FileError(
                    f"{file}: {KINDS[content]} is an HDF5 file, and would look like a {file.suffix} file; end its name "
                    "in .h5, or allow it by --force (in Python force=True)"
                )
            continue
        for other in read:
            if file.samefile(other):
                alias = "" if other == file else f" (it is {other})"
                raise FileError(
                    f"{file}: is read by this command, so it cannot be its output{alias}; give another name"
                )
        if force:
            continue
        wanted = KINDS[content] if content else _kind_of_ending(file)
        if (found := _kind(file)) not in (wanted, None):
            raise FileError(
                f"{file}: is {found}, and would be replaced by {wanted}; give another name, or allow it by --force "
                "(in Python force=True)"
            )


def check_outputs_in(
    folder: Path,
    names: Iterable[str],
    contents: Mapping[str, str] | None = None,
    *,
    inputs: Iterable[str | PathLike[str]] = (),
    force: bool = False,
) -> None:
    """The same of files in a folder of results, which is there or can be made; with contents by name."""
    check_folder(folder)
    for name in names if folder.is_dir() else ():
        check_outputs(folder / name, content=(contents or {}).get(name), inputs=inputs, force=force)


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long, or a folder that may not be looked into
        return False


def write_over(file: str | Path, content: str, fill: Callable[[Any], None], *, force: bool = False) -> None:
    """`hdf5.write_file` that replaces, unless it is forced, no file of another kind."""

    def checked(h5: Any) -> None:
        check_outputs(Path(file), content=content, force=force)
        fill(h5)

    write_file(file, content, checked)


def _kind(file: Path) -> str | None:
    """What a file is, by its first bytes, else by its ending; None where it is empty."""
    try:
        with file.open("rb") as stream:
            head = stream.read(16)
        if not head:
            return None
        if is_sealed(file):
            return KINDS.get(content := sealed_content(file), f"a {content} of fenics-rom")
    except FileError:
        return "a file of fenics-rom that is damaged, or of another release"
    except OSError as error:
        return f"a file that cannot be looked into ({system_reason(error)})"
    begun = next((begin for begin in FIRST_BYTES if head.startswith(begin)), None)
    if begun is not None:
        return _kind_of_ending(file) if KIND_OF_ENDING.get(file.suffix) == begun else FIRST_BYTES[begun]
    return "something else than its ending says" if file.suffix in KIND_OF_ENDING else _kind_of_ending(file)


def _kind_of_ending(file: Path) -> str:
    return f"a {file.suffix} file" if file.suffix else "a file without ending"
