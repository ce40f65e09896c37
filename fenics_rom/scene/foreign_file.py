"""What is in a mesh file of another program, read by Gmsh or VTK in a process of its own.

A damaged file may crash it or hang it there.
"""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.scene import foreign_process
from fenics_rom.scene.foreign_process import program_of

LAUNCHER_VARIABLES = ("OMPI_", "PMIX_", "PRTE_", "PMI_", "HYDRA_", "HYDI_")  # what mpirun says is not for this process
BASE_TIMEOUT = 60.0  # s that a program may take for any file
MIN_READING_RATE = 1e6  # bytes/s that it reads beyond that
MESHING_TIMEOUT = 3600.0  # s that Gmsh may take to mesh a body


def read_arrays(file: Path) -> Mapping[str, np.ndarray]:
    """What `foreign_process` finds in a file of cells, of any version of its format, text or binary.

    Raises:
        MeshError: the program cannot read the file, crashed, or was not done in time.
    """
    return _arrays(file, timeout=BASE_TIMEOUT + file.stat().st_size / MIN_READING_RATE)


def read_surface_arrays(file: Path) -> Mapping[str, np.ndarray]:
    """Points (3 N,) and triangles (3 T,) of a surface in a file of VTK, or around the solids of a STEP file.

    Raises:
        MeshError: as `read_arrays`.
    """
    return _arrays(file, "surface", timeout=BASE_TIMEOUT + file.stat().st_size / MIN_READING_RATE)


def fill_surface(file: Path, size: float, glue: bool = False) -> Mapping[str, np.ndarray]:
    """Points (3 N,) and cells (4 C,) of tetrahedra that Gmsh fills a closed surface or a STEP body with.

    Args:
        file: `.stl`, `.step` or `.stp`.
        size: length of their edges in the file's unit; of STEP, m.
        glue: let solids of STEP that touch or overlap share their nodes.

    Raises:
        MeshError: as `read_arrays`; or the surface is open or intersects itself.
    """
    return _arrays(file, str(size), *["glue"] * glue, timeout=MESHING_TIMEOUT)


def _arrays(file: Path, *words: str, timeout: float) -> Mapping[str, np.ndarray]:
    program = program_of(file)
    try:
        process = subprocess.run(
            [sys.executable, "-P", foreign_process.__file__, file, *words],
            env=_clean_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        raise MeshError(f"mesh file {file}: {program} could not read it (it went on for {timeout:.0f} s)") from None
    if process.returncode < 0:
        name = signal.strsignal(-process.returncode)
        raise MeshError(f"mesh file {file}: {program} could not read it (signal {-process.returncode}: {name})")
    if process.returncode:
        messages = process.stderr.decode(errors="replace").strip().splitlines()
        reason = messages[-1] if messages else "it does not say why"
        raise MeshError(f"mesh file {file}: {program} cannot read it: {reason}")
    with np.load(io.BytesIO(process.stdout), allow_pickle=False) as arrays:
        return dict(arrays)


def _clean_environment() -> dict[str, str]:
    """This process's, less what would make the other a rank; with the same packages, and no home to write to."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHER_VARIABLES)}
    return variables | {"HOME": os.devnull, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
