"""A closed surface, or a STEP body, filled with tetrahedra by Gmsh."""

from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem.mesh import SURFACES, Mesh, checked_mesh
from fenics_rom.fem.mesh_arrays import MeshArrays
from fenics_rom.fem.msh_writer import write_msh
from fenics_rom.scene import foreign_file

REGION = "body"  # name of all cells in the file


def fill_surface(file: Path, output: Path, size: float, scale: float = 1.0, glue: bool = False) -> Mesh:
    """Fills a surface, writes a `.msh` file and returns the mesh, in m.

    Args:
        file: `.stl`, or `.step` or `.stp`, which say their unit.
        output: `.msh` file, of coordinates in m.
        size: length of the cells' edges, m.
        scale: metres that a unit of an `.stl` file is worth.
        glue: let solids of a `.step` file that touch share their nodes there; what two have in common is filled once.

    Raises:
        MeshError: Gmsh cannot read or fill it: it is open, intersects itself, or holds no solid.
        FileError: the output cannot be written.
    """
    if file.suffix.lower() not in SURFACES:
        raise MeshError(f"mesh file {file}: use a file that ends in {', '.join(SURFACES)}")
    try:
        is_there = file.is_file()
    except OSError as error:  # as of a name that is too long
        raise MeshError(f"mesh file {file}: cannot be read: {error.strerror}") from error
    if not is_there:
        raise MeshError(f"mesh file {file}: not found")
    if scale != 1.0 and file.suffix.lower() != ".stl":
        raise MeshError(f"mesh file {file}: says its unit; a scale is for .stl")
    arrays = foreign_file.fill_surface(file, size / scale, glue)
    points, cells = arrays["points"].reshape(-1, 3), arrays["cells"].reshape(-1, 4)
    mesh = checked_mesh(MeshArrays(points, cells, {}, {REGION: np.arange(len(cells))}), file, scale)
    write_msh(output, mesh)
    return mesh
