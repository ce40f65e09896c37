"""Exports in a process of their own, where dolfinx is loaded.

dolfinx 0.5 makes the symbols of its libraries global, and VTK, which takes some of them for its own, may abort.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from fenics_rom.errors import FenicsRomError
from fenics_rom.io.atomic_write import check_place
from fenics_rom.rom.file import write_rom
from fenics_rom.rom.rom import Rom
from fenics_rom.trajectory.file import write_trajectory
from fenics_rom.trajectory.trajectory import Trajectory


def dolfinx_is_loaded() -> bool:
    """Whether this process has loaded dolfinx."""
    return "dolfinx" in sys.modules


def export_in_subprocess(model: Rom | Trajectory, place: Path, **choices: str | float | bool | None) -> None:
    """Does what `export` does by the command of that name.

    Args:
        model: the ROM or the run.
        place: the file.
        choices: options of the command; what is None or False is left out.

    Raises:
        FenicsRomError: what the command says.
    """
    check_place(place)
    with TemporaryDirectory(prefix=".", dir=place.parent) as folder:
        file = Path(folder) / "model.h5"
        if isinstance(model, Rom):
            write_rom(file, model)
        else:
            write_trajectory(file, model)
        words = [str(file), "-o", str(place)]
        for name, value in choices.items():
            if value is not None and value is not False:
                words += [f"--{name}"] if value is True else [f"--{name}", str(value)]
        run = subprocess.run([sys.executable, "-m", "fenics_rom", "export", *words], capture_output=True, text=True)
    if run.returncode:
        lines = run.stderr.strip().splitlines()
        raise FenicsRomError(lines[-1].removeprefix("fenics-rom: ") if lines else f"{place}: could not be drawn")
