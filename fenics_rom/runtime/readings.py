"""A reduced body as readings ask for it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fenics_rom.errors import StepError, unknown
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.readings import Reading, swept_volume
from fenics_rom.rom.deformation import monomials
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.contact_interface import ContactInterface

Array = np.ndarray


def named_reading(rom: Rom, name: str) -> Reading:
    """A reading of a ROM.

    Raises:
        StepError: there is none of that name.
    """
    if name not in rom.readings:
        raise StepError(unknown("reading", name, rom.readings))
    return rom.readings[name]


def read_each(rom: Rom, name: str, contact_modes: Iterable[str], states: Array) -> Array:
    """A reading of bodies that nothing touches, of their contact modes and reduced displacements (bodies, m)."""
    reading, models = named_reading(rom, name), rom.contact_models
    bodies = (
        ReadableReduced(rom, mode, q[: models[mode].order], None, None)
        for mode, q in zip(contact_modes, states, strict=True)
    )
    return np.array([reading.read(body) for body in bodies])


@dataclass(frozen=True)
class ReadableReduced:
    """A state of a ROM; see ReadableBody.

    Attributes:
        rom: the reduced model.
        contact_mode: the active one.
        q: (m,) in its basis.
        interface: the contact points; None where nothing can touch.
        contact: of the last step; None where nothing touched.
    """

    rom: Rom
    contact_mode: str
    q: Array
    interface: ContactInterface | None
    contact: ContactSolution | None

    @property
    def coordinates(self) -> Array:
        """See ReadableBody: in the shared basis, (k,)."""
        return self.rom.contact_models[self.contact_mode].coordinates @ self.q

    @property
    def law(self) -> str | None:
        """See ReadableBody."""
        return None if self.rom.deformation is None else self.rom.deformation.law

    def stroke(self, actuator: str) -> float:
        """See ReadableBody."""
        body, q = self.rom.deformation, self.q
        if body is None:
            column = self.rom.contacts[self.contact_mode]
            for name, width in self.rom.actuators.items():
                if name == actuator:
                    break
                column += width
            return float(self.rom.contact_models[self.contact_mode].inputs[:, column] @ q)
        if actuator in body.tendons:
            return body.tendons[actuator].stroke(q)
        return swept_volume(lambda q: body.pressures[actuator] @ monomials(q), q)

    def normal_forces(self, nodes: Array) -> Array:
        """See ReadableBody."""
        if self.interface is None:
            return np.zeros(len(nodes))
        return self.interface.points.normal_forces(self.contact, nodes)
