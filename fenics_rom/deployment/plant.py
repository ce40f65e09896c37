"""A ROM as the plant of another program: what it can become, and how."""

from collections.abc import Sequence
from pathlib import Path

from fenics_rom.deployment.matrices import write_matrices
from fenics_rom.rom.rom import Rom

PLANT_FORMATS = (".npz", ".mat")


def write_plant(place: Path, rom: Rom, outputs: Sequence[str] | None, dt: float | None) -> None:
    """Writes the linear models of a ROM as the file that its ending says."""
    write_matrices(place, rom, outputs, dt)
