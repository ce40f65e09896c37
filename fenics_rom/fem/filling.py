"""A closed surface, or a STEP body, filled with tetrahedra by Gmsh."""

from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem import foreign_file
from fenics_rom.fem.mesh import SURFACES, Mesh, check_cells, oriented
from fenics_rom.fem.mesh_quality import check_filling, radius_ratios
from fenics_rom.io.atomic_write import write_whole
from fenics_rom.mechanics.body_facts import CellQuality, quality_of

REGION = "body"  # name of all cells in the file


def fill_surface(file: Path, output: Path, size: float, scale: float = 1.0) -> tuple[Mesh, CellQuality]:
    """Fills a surface, writes a `.msh` file and returns the mesh, in m, and how good it is.

    Args:
        file: `.stl`, or `.step` or `.stp`, which say their unit.
        output: `.msh` file, of coordinates in m.
        size: length of the cells' edges, m.
        scale: metres that a unit of an `.stl` file is worth.

    Raises:
        MeshError: Gmsh cannot read or fill it: it is open, intersects itself, or holds no solid.
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
    arrays = foreign_file.fill_surface(file, size / scale)
    points, cells = scale * arrays["points"].reshape(-1, 3), arrays["cells"].reshape(-1, 4)
    check_cells(points, cells, file)
    cells = oriented(points, cells)
    check_filling(points, cells, f"mesh file {file}")
    write_whole(output, _as_msh(points, cells).encode())
    mesh = Mesh(points, cells, {}, {REGION: np.arange(len(cells))}, str(output))
    return mesh, quality_of(radius_ratios(points, cells))


def _as_msh(points: np.ndarray, cells: np.ndarray) -> str:
    """Gmsh's MSH format 2.2."""
    nodes = "\n".join(f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(points.tolist(), 1))
    elements = "\n".join(f"{k} 4 2 1 1 {' '.join(map(str, cell))}" for k, cell in enumerate((cells + 1).tolist(), 1))
    return (
        f'$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 "{REGION}"\n$EndPhysicalNames\n'
        f"$Nodes\n{len(points)}\n{nodes}\n$EndNodes\n$Elements\n{len(cells)}\n{elements}\n$EndElements\n"
    )
