"""A reduced body as readings ask for it."""

from collections.abc import Iterable
from itertools import takewhile

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.readings import ReadableBody, Reading, swept_volume
from fenics_rom.rom.deformation import monomials
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.contact_interface import ContactInterface


def named_reading(rom: Rom, name: str) -> Reading:
    """A reading of a ROM.

    Raises:
        StepError: there is none of that name.
    """
    check_known("reading", name, rom.readings, StepError)
    return rom.readings[name]


def read_each(rom: Rom, name: str, contact_modes: Iterable[str], states: Array) -> Array:
    """A reading of bodies that nothing touches, of their contact modes and reduced displacements (bodies, m)."""
    reading, models = named_reading(rom, name), rom.contact_models
    bodies = zip(contact_modes, states, strict=True)
    return np.array([reading.read(readable(rom, mode, q[: models[mode].order])) for mode, q in bodies])


def readable(
    rom: Rom,
    contact_mode: str,
    q: Array,
    interface: ContactInterface | None = None,
    contact: ContactSolution | None = None,
    shape: Array | None = None,
) -> ReadableBody:
    """A state of a ROM, as readings ask for it.

    Args:
        rom: the reduced model.
        contact_mode: the active one.
        q: (m,) in its basis.
        interface: the contact points; None where nothing can touch.
        contact: of the last step; None where nothing touched.
        shape: (k,) in the shared basis; None: that of q.
    """
    model, body = rom.contact_models[contact_mode], rom.deformation

    def stroke(actuator: str) -> float:
        if body is None:
            before = takewhile(lambda name: name != actuator, rom.actuators)
            column = rom.contacts[contact_mode] + sum(rom.actuators[name] for name in before)
            return float(model.inputs[:, column] @ q)
        if actuator in body.tendons:
            return body.tendons[actuator].stroke(q)
        return swept_volume(lambda q: body.pressures[actuator] @ monomials(q), q)

    law = None if body is None else body.law
    coordinates = model.coordinates @ q if shape is None else shape
    return ReadableBody(law, lambda: coordinates, stroke, interface and interface.points, contact)
