"""What is in a .msh file, read by Gmsh in a process of its own, which a damaged file may crash or hang."""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.fem import gmsh_process

LAUNCHER_VARIABLES = ("OMPI_", "PMIX_", "PRTE_", "PMI_", "HYDRA_", "HYDI_")  # what mpirun says is not for this process
BASE_TIMEOUT = 60.0  # s that Gmsh may take for any file
MIN_READING_RATE = 1e6  # bytes/s that it reads beyond that


def read_arrays(file: Path) -> Mapping[str, np.ndarray]:
    """What `gmsh_process.read_arrays` finds, of any version of the format, text or binary, partitioned or not.

    Raises:
        MeshError: Gmsh cannot read the file, crashed, or was not done in time.
    """
    timeout = BASE_TIMEOUT + file.stat().st_size / MIN_READING_RATE
    try:
        process = subprocess.run(
            [sys.executable, "-P", gmsh_process.__file__, file],
            env=_clean_environment(),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        raise MeshError(f"mesh file {file}: Gmsh could not read it (it went on for {timeout:.0f} s)") from None
    if process.returncode < 0:
        name = signal.strsignal(-process.returncode)
        raise MeshError(f"mesh file {file}: Gmsh could not read it (signal {-process.returncode}: {name})")
    if process.returncode:
        messages = process.stderr.decode(errors="replace").strip().splitlines()
        raise MeshError(f"mesh file {file}: Gmsh cannot read it: {messages[-1] if messages else 'it does not say why'}")
    with np.load(io.BytesIO(process.stdout), allow_pickle=False) as arrays:
        return dict(arrays)


def _clean_environment() -> dict[str, str]:
    """This process's, less what would make the other a rank; with the same packages, and no home to write to."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHER_VARIABLES)}
    return variables | {"HOME": os.devnull, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
