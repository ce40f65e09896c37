"""A reduced body as readings ask for it."""

from itertools import takewhile
from typing import Any

from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.readable_body import ReadableBody
from fenics_rom.mechanics.readings import Reading, swept_volume
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.deformation import monomials
from fenics_rom.rom.rom import Rom


def named_reading(rom: Rom, name: str) -> Reading:
    """A reading of a ROM.

    Raises:
        StepError: there is none of that name.
    """
    check_known("reading", name, rom.readings, StepError)
    return rom.readings[name]


def readable(
    rom: Rom,
    contact_mode: str,
    q: Array,
    shape: Array,
    points: ContactPoints | None = None,
    pressing: Array | None = None,
    model: ContactModel | None = None,
    **touched: Any,
) -> ReadableBody:
    """A state of a ROM, as readings ask for it.

    Args:
        rom: the reduced model.
        contact_mode: the active one.
        q: (m,) in its basis.
        shape: (k,) in the shared basis, with what contact points yield beyond the contact mode.
        points: what obstacles can touch; None where there are none.
        pressing: normal forces on them in the last step, (P,), N; None where nothing touched.
        model: of the contact mode with what a switch carried along; None: without.
        touched: what else `ReadableBody` has of contact, and of the last step.
    """
    model, body = rom.contact_models[contact_mode] if model is None else model, rom.deformation

    def stroke(actuator: str) -> float:
        if body is None:
            before = takewhile(lambda name: name != actuator, rom.actuators)
            column = rom.contacts[contact_mode] + sum(rom.actuators[name] for name in before)
            return float(model.inputs[:, column] @ q)
        if actuator in body.tendons:
            return body.tendons[actuator].stroke(q)
        return swept_volume(lambda q: body.pressures[actuator] @ monomials(q), q)

    law = None if body is None else body.law
    return ReadableBody(law, lambda: shape, stroke, points, pressing, **touched)
