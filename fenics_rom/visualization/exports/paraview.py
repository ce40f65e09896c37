"""Files for ParaView: the surface of a body with displacements and velocities on all of its nodes.

A ROM and a run know the nodes and the surface of a body, not what is inside: cells are triangles. Numbers are in
double precision, as they are in the ROM or the run.
"""

import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from numpy import ndarray as Array

from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import check_folder, write_whole
from fenics_rom.visualization.optional_dependencies import pyvista_package


@dataclass(frozen=True)
class Fields:
    """By name: values on nodes (N,) or (N, 3), on triangles (F,) or (F, 6), and numbers of the whole body."""

    on_nodes: Mapping[str, Array]
    on_triangles: Mapping[str, Array] = field(default_factory=dict)
    whole: Mapping[str, Array] = field(default_factory=dict)


def write_grid(file: Path, nodes: Array, triangles: Array, fields: Fields) -> None:
    """Writes one .vtu file of nodes (N, 3) and triangles (F, 3), or nothing."""
    write_whole(file, _grid(nodes, triangles, fields))


def write_series(file: Path, times: Array, nodes: Array, triangles: Array, instants: Sequence[Fields]) -> None:
    """Writes a .pvd file, and beside it a folder of its name with one .vtu file for each instant; or nothing.

    A folder of that name is replaced if it holds nothing but what this has written there before. There is an
    instant for each of the times, s.

    Raises:
        FileError: they cannot be written, or there is something else in the folder.
    """
    folder = file.with_suffix("")
    _check_place(file)
    digits = max(4, len(str(len(times) - 1)))
    names = [f"{folder.name}_{k:0{digits}}.vtu" for k in range(len(times))]
    entries = [
        f'    <DataSet timestep="{float(t)!r}" part="0" file={quoteattr(f"{folder.name}/{name}")}/>'
        for t, name in zip(times, names, strict=True)
    ]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n  <Collection>'
    index = "\n".join([head, *entries, "  </Collection>", "</VTKFile>", ""])
    try:
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", suffix=".part", dir=folder.parent) as parent:
            staged = Path(parent) / folder.name
            staged.mkdir()
            for name, fields in zip(names, instants, strict=True):
                (staged / name).write_bytes(_grid(nodes, triangles, fields))
            if folder.exists():
                shutil.rmtree(folder)
            staged.replace(folder)
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror or error}") from error
    write_whole(file, index.encode())


def _check_place(file: Path) -> None:
    """Checks that the folder of a .pvd file can be made, or replaced without loss; raises FileError where it cannot."""
    folder = file.with_suffix("")
    check_folder(folder)
    ours = re.compile(re.escape(folder.name) + r"_\d{4,}\.vtu")
    others = [file.name for file in (folder.iterdir() if folder.exists() else ()) if not ours.fullmatch(file.name)]
    if others:
        raise FileError(
            f"{folder}: the folder that goes with {file.name} holds other things, such as {others[0]!r}; "
            "use a name whose folder is free"
        )


def _grid(nodes: Array, triangles: Array, fields: Fields) -> bytes:
    """The content of a .vtu file, written where VTK takes the name of any folder: it takes those in UTF-8 alone."""
    pv: Any = pyvista_package()
    grid = pv.UnstructuredGrid({pv.CellType.TRIANGLE: triangles}, nodes)
    for data, named in (
        (grid.point_data, fields.on_nodes),
        (grid.cell_data, fields.on_triangles),
        (grid.field_data, fields.whole),
    ):
        for name, values in named.items():
            data[name] = values
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "grid.vtu"
        grid.save(written)
        return written.read_bytes()
