"""Meshes read by Gmsh in this process: one for each of the thousand meshes of the tests would take minutes."""

from pathlib import Path
from typing import Any

import gmsh

from fenics_rom.errors import MeshError
from fenics_rom.fem import gmsh_process


def arrays_found_here(file: Path) -> dict[str, Any]:
    """What `gmsh_file.read_arrays` gives."""
    try:
        return gmsh_process.read_arrays(str(file))
    except Exception as error:
        raise MeshError(f"mesh file {file}: Gmsh cannot read it: {error}") from error
    finally:
        gmsh.finalize()
