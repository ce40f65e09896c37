"""What is in a mesh file of another program, read by Gmsh or VTK in a process of its own.

A damaged file may crash it or hang it there.
"""

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from fenics_rom.errors import MeshError
from fenics_rom.scene import foreign_process
from fenics_rom.scene.foreign_process import program_of

LAUNCHER_VARIABLES = ("OMPI_", "PMIX_", "PRTE_", "PMI_", "HYDRA_", "HYDI_")  # what mpirun says is not for this process
BASE_TIMEOUT = 60.0  # s that a program may take for any file
MIN_READING_RATE = 1e6  # bytes/s that it reads beyond that
SECOND = 1.0


def read_arrays(file: Path) -> Mapping[str, np.ndarray]:
    """What `foreign_process` finds in a file of cells, of any version of its format, text or binary.

    Raises:
        MeshError: the program cannot read the file, crashed, or was not done in time.
    """
    return _arrays(file)


def read_surface_arrays(file: Path) -> Mapping[str, np.ndarray]:
    """Points (3 N,) and triangles (3 T,) of a surface in a file of VTK, or around the solids of a STEP file.

    Raises:
        MeshError: as `read_arrays`.
    """
    return _arrays(file, "surface")


def arrays_of(
    script: str,
    file: Path,
    *words: str,
    program: str,
    does: str,
    timeout: float,
    listen: Callable[[bytes], None] = lambda said: None,
) -> Mapping[str, np.ndarray]:
    """Arrays that a script finds in a process of its own.

    Args:
        script: its file.
        file, words: what it is told on its command line.
        program: what works there, for messages.
        does: what it does to the file, for messages.
        timeout: s that it may take.
        listen: is told every second all that it has said up to then.

    Raises:
        MeshError: it cannot do so, crashed, or was not done in time.
    """
    start = time.monotonic()
    with subprocess.Popen(
        [sys.executable, "-P", script, file, *words],
        env=_clean_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        try:
            while True:
                try:
                    content, said = process.communicate(timeout=min(SECOND, timeout))
                    break
                except subprocess.TimeoutExpired as still:
                    if time.monotonic() - start > timeout:
                        raise MeshError(
                            f"mesh file {file}: {program} could not {does} it (it went on for {timeout:.0f} s)"
                        ) from None
                    listen(still.stderr or b"")
        except BaseException:  # as of a user who waits no longer
            process.kill()
            raise
    if process.returncode < 0:
        name = signal.strsignal(-process.returncode)
        raise MeshError(f"mesh file {file}: {program} could not {does} it (signal {-process.returncode}: {name})")
    if process.returncode:
        messages = said.decode(errors="replace").strip().splitlines()
        reason = messages[-1] if messages else "it does not say why"
        raise MeshError(f"mesh file {file}: {program} cannot {does} it: {reason}")
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays)


def _arrays(file: Path, *words: str) -> Mapping[str, np.ndarray]:
    timeout, program = BASE_TIMEOUT + file.stat().st_size / MIN_READING_RATE, program_of(file)
    return arrays_of(foreign_process.__file__, file, *words, program=program, does="read", timeout=timeout)


def _clean_environment() -> dict[str, str]:
    """This process's, less what would make the other a rank; with the same packages, and no home to write to."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHER_VARIABLES)}
    return variables | {"HOME": os.devnull, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
