"""A ROM as the plant of another program: what it can become, and how."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fenics_rom.deployment.c_source import c_source
from fenics_rom.deployment.fmu import write_fmu
from fenics_rom.deployment.identifiers import check_identifier
from fenics_rom.deployment.matrices import write_matrices
from fenics_rom.errors import FileError
from fenics_rom.io.atomic_write import write_whole
from fenics_rom.rom.midpoint_map import checked_dt
from fenics_rom.rom.rom import Rom

PLANT_FORMATS = (".npz", ".mat", ".c", ".fmu")


def write_plant(place: Path, rom: Rom, outputs: Sequence[str] | None, dt: float | None, at: Any = None) -> None:
    """Writes the linear models of a ROM as the file that its ending says; beside one in C a header.

    Args:
        place: the file.
        rom: the reduced model.
        outputs: names of those that are read; None: all.
        dt: time step, s; None: continuous time, of code that of the scene's run.
        at: of a body that is not linear: the state about which it is linearised, as of `Rom.state_space`.

    Raises:
        StepError: as `Rom.state_space`.
        FileError: a file cannot be written, a name cannot be one in it, or code has no time step.
        MissingPackageError: SciPy, which .mat needs, or the C compiler, which .fmu needs, is not there.
    """
    if place.suffix in (".npz", ".mat"):
        write_matrices(place, rom, outputs, dt, at)
        return
    check_identifier(place.stem, str(place))
    plant = c_source(rom, place.stem, outputs, _step_of_code(place, rom, dt), at)
    if place.suffix == ".fmu":
        write_fmu(place, rom, plant)
        return
    header = place.with_suffix(".h")
    write_whole(header, plant.header.encode())
    write_whole(place, plant.source.encode())


def _step_of_code(place: Path, rom: Rom, dt: float | None) -> float:
    if dt is None and rom.environment.run is None:
        raise FileError(f"{place}: the scene has no run, so that a time step is missing: --dt, in s")
    return checked_dt(rom.environment.run.dt if dt is None and rom.environment.run is not None else dt)  # type: ignore[arg-type]
