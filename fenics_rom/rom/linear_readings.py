"""Readings of a linear body as rows of its reduced displacement: those that are linear in it."""

from collections.abc import Mapping
from itertools import takewhile
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.hyperelastic import small_strain
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.readings import (
    READING_UNITS,
    READING_WORDS,
    MarkerReading,
    Reading,
    StressReading,
    StrokeReading,
    SurfaceReading,
)
from fenics_rom.mechanics.voigt import VOIGT_SHEAR
from fenics_rom.rom.contact_model import ContactModel


class ReadRows(NamedTuple):
    """What is read of a contact mode's displacement."""

    shape: tuple[int, ...]
    rows: Array  # (the product of the shape, m)
    unit: str


def reading_rows(name: str, reading: Reading, model: ContactModel, inputs: Mapping[str, int]) -> ReadRows:
    """Those of a reading: of a length or a volume what it is more than at rest, of a strain, a stress (its six
    components) and a marker the whole.

    Args:
        name: of the reading.
        reading: of what.
        model: the contact mode.
        inputs: number of columns of each of its inputs, by name, in their order.

    Raises:
        StepError: it is not linear.
    """
    unit = READING_UNITS[reading.quantity]
    if isinstance(reading, SurfaceReading | StressReading) and reading.quantity != "strain" and reading.expansions:
        raise StepError(
            f"reading {name!r}: {READING_WORDS[reading.quantity]} is of temperatures, too, which are inputs; use "
            "readings of displacements alone"
        )
    if isinstance(reading, StrokeReading):
        before = takewhile(lambda actuator: actuator != reading.of, inputs)
        column = model.inputs[:, sum(inputs[actuator] for actuator in before)]
        return ReadRows((), (-1 if reading.quantity == "length" else 1) * column[None], unit)
    if isinstance(reading, MarkerReading):
        return ReadRows((3,), reading.small_motion @ reading.operator @ model.coordinates, unit)
    if isinstance(reading, SurfaceReading) and reading.quantity == "strain":
        gradients = (reading.operator @ model.coordinates).reshape(3, 3, -1, model.order)
        strains = small_strain(gradients) / VOIGT_SHEAR[:, :, None]
        return ReadRows((strains.shape[1], 6), strains.swapaxes(0, 1).reshape(-1, model.order), unit)
    if isinstance(reading, SurfaceReading) and reading.quantity in ("pressure", "surface_stress"):
        gradients = (reading.operator @ model.coordinates).reshape(3, 3, -1, model.order)
        σ = PointMaterial("", reading.first_lame, reading.shear, reading.fibres).linear_stress(small_strain(gradients))
        if reading.quantity == "surface_stress":
            return ReadRows((σ.shape[1], 6), σ.swapaxes(0, 1).reshape(-1, model.order), unit)
        return ReadRows((σ.shape[1],), -σ[:3].mean(axis=0), unit)
    if isinstance(reading, StressReading):
        gradients = (reading.operator @ model.coordinates).reshape(3, 3, -1, model.order)
        stresses = reading.components(gradients)
        return ReadRows((stresses.shape[1], 6), stresses.swapaxes(0, 1).reshape(-1, model.order), unit)
    raise StepError(
        f"reading {name!r}: {READING_WORDS[reading.quantity]} is not linear in displacements; use lengths, "
        "volumes, strains, pressures, stresses by component and markers"
    )
