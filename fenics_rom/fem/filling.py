"""A closed surface, or a STEP body, filled with tetrahedra by Gmsh; a surface that it cannot fill by fTetWild."""

from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import SURFACES, Mesh, checked_mesh
from fenics_rom.fem.mesh_arrays import MeshArrays
from fenics_rom.fem.msh_writer import write_msh
from fenics_rom.scene import foreign_file

REGION = "body"  # name of all cells in the file
LARGE = 5.0  # m: a soft body of that size is rather one in mm


def fill_surface(file: Path, output: Path, size: float | None, scale: float = 1.0, glue: bool = False) -> Mesh:
    """Fills a surface, writes a `.msh` file and returns the mesh, in m.

    Args:
        file: `.stl`, or `.step` or `.stp`, which say their unit.
        output: `.msh` file, of coordinates in m.
        size: length of the cells' edges, m; None for some 5,000 cells.
        scale: metres that a unit of an `.stl` file is worth.
        glue: let solids of a `.step` file that touch share their nodes there; what two have in common is filled once.

    Raises:
        MeshError: Gmsh cannot read or fill it: it is open, intersects itself, holds no solid, or would have 2e7 cells.
        FileError: the output cannot be written.
    """
    if file.suffix.lower() not in SURFACES:
        raise MeshError(f"mesh file {file}: allowed endings are {', '.join(SURFACES)}")
    try:
        is_there = file.is_file()
    except OSError as error:  # as of a name that is too long
        raise MeshError(f"mesh file {file}: cannot be read: {error.strerror}") from error
    if not is_there:
        raise MeshError(f"mesh file {file}: not found")
    if scale != 1.0 and file.suffix.lower() != ".stl":
        raise MeshError(f"mesh file {file}: says its unit; a scale is allowed of .stl")
    arrays, why = foreign_file.fill_surface(file, None if size is None else size / scale, glue)
    points, cells = arrays["points"].reshape(-1, 3), arrays["cells"].reshape(-1, 4)
    notes, extent = [], float(np.ptp(scale * points, axis=0).max())
    if size is None:
        notes.append(f"cells have edges of {scale * float(arrays['size']):.2g} m; --size gives another length")
    if why:
        within = scale * float(arrays["within"])
        notes.append(f"{why}; fTetWild filled it instead, and follows the surface to {within:.1g} m")
    if extent > LARGE and scale == 1.0:
        notes.append(f"the body is {extent:.3g} m long; if {file.name} is in mm, give --scale 1e-3")
    parts = MeshArrays(points, cells, {}, {REGION: np.arange(len(cells))}, notes=tuple(notes))
    mesh = checked_mesh(parts, file, scale)
    write_msh(output, mesh)
    return mesh
