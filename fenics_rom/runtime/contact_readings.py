"""What is read of contact of a reduced body: its points, and the forces on them."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.nodal_contact import Touch, TouchedBody
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.stepper import ReducedStepper

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment


class ContactReadings(TouchedBody):
    """Of a body as its stepper has it.

    Attributes:
        read_touch: of a body in a world, which finds what touches it.
    """

    read_touch: Callable[[], Touch | None] | None = None

    rom: Rom
    environment: "ActiveEnvironment | None"
    _stepper: ReducedStepper

    def _touch(self) -> tuple[ContactPoints, Touch | None] | None:
        interface, contact = self._stepper.interface, self._stepper.contact
        if interface is None:
            return None
        if self.read_touch is not None:
            return interface.points, self.read_touch()
        return interface.points, None if contact is None else Touch(contact.forces, contact.normal_forces)

    def _surface_at_rest(self) -> tuple[Array, Array, Array]:
        surfaces = [*self.rom.contact_surfaces.values(), np.empty(0, dtype=int)]
        return self.rom.nodes, self.rom.triangles, np.concatenate(surfaces)

    def contact_forces(self, obstacle: str | None = None) -> Array:
        """Forces on the body in the last step, N: of an obstacle (3,), or on every contact point (P, 3).

        Raises:
            StepError: no such obstacle, or no contact in the scene.
        """
        interface, contact = self._stepper.interface, self._stepper.contact
        if interface is None or self.environment is None:
            why = "nothing acts but inputs" if self.environment is None else "the scene has no contact"
            raise StepError(f"there are no contact forces: {why}")
        if obstacle is None:
            return np.zeros(interface.points.coordinates.shape) if contact is None else contact.forces
        names = list(self.environment.obstacles)
        check_known("obstacle", obstacle, names, StepError)
        return self.obstacle_forces()[names.index(obstacle)]

    def obstacle_forces(self) -> Array:
        """Forces of all obstacles on the body in the last step, (O, 3), N; none where there are none."""
        contact, obstacles = self._stepper.contact, {} if self.environment is None else self.environment.obstacles
        return np.zeros((len(obstacles), 3)) if contact is None else contact.by_obstacle

    @property
    def contact_points(self) -> Array:
        """Nodes that obstacles can touch; none where the scene has no contact."""
        interface = self._stepper.interface
        return np.empty(0, dtype=int) if interface is None else interface.points.nodes

    @property
    def contact_coordinates(self) -> Array:
        """All contact points at rest, (P, 3), m: nodes, then those between; in the order of `contact_forces`."""
        interface = self._stepper.interface
        return np.empty((0, 3)) if interface is None else interface.points.coordinates
