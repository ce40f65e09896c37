"""What is read of contact of a reduced body: its points, and the forces on them."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.contact_points import ContactPoints
from fenics_rom.mechanics.nodal_contact import Touch, TouchedBody
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.stepper import ReducedStepper

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.readable_body import LastStep
    from fenics_rom.mechanics.readings import Reading
    from fenics_rom.mechanics.rubbing import Rubbing
    from fenics_rom.mechanics.sensor import SensedTouch


class ContactReadings(TouchedBody):
    """Of a body as its stepper has it.

    Attributes:
        read_touch, read_rubbing: of a body in a world, which finds what touches it.
        last_step: by the shared basis; None where nothing asks for it, or none was taken.
    """

    read_touch: Callable[[], Touch | None] | None = None
    read_rubbing: "Callable[[], Rubbing | None] | None" = None
    _rubbed: tuple[Any, ...] | None = None  # what was worked out last, and of which contact

    rom: Rom
    environment: "ActiveEnvironment | None"
    last_step: "LastStep | None" = None
    sensed: "SensedTouch | None" = None  # None where there is no sense of touch
    remembers_touch: bool = False  # a sensor, so that it has to look after every step
    steps: int
    _dt: float
    _stepper: ReducedStepper

    @property
    def time(self) -> float:
        """Simulated time, s."""
        raise NotImplementedError

    @property
    def _readings(self) -> "Mapping[str, Reading]":
        return self.rom.readings

    def _touch(self) -> tuple[ContactPoints, Touch | None] | None:
        interface, contact = self._stepper.interface, self._stepper.contact
        if interface is None:
            return None
        if self.read_touch is not None:
            return interface.points, self.read_touch()
        return interface.points, None if contact is None else Touch(contact.forces, contact.normal_forces)

    def _rubbing(self) -> "Rubbing | None":
        """What friction did at the contact points in the last step; None where nothing touched."""
        return self.own_rubbing() if self.read_rubbing is None else self.read_rubbing()

    def own_rubbing(self) -> "Rubbing | None":
        """The same of obstacles of its own."""
        from fenics_rom.mechanics.rubbing import rubbing_of  # here, as few bodies have a sense of touch

        interface, contact = self._stepper.interface, self._stepper.contact
        if interface is None or contact is None:
            return None
        if self._rubbed is None or self._rubbed[0] is not contact:
            kernel: Any = self._stepper.kernel
            self._rubbed = contact, rubbing_of(contact, kernel.touched, interface.solver.law.friction)
        rubbing: Rubbing = self._rubbed[1]
        return rubbing

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

    def reading(self, name: str) -> Array:
        """A reading of the scene as it is now; of contact, that of the last step.

        Length, m, and volume, m³, are (); contact pressure, Pa, is (s,) at the nodes of the contact surface; strain
        and stress (P, 6), with the components xx, yy, zz, yz, xz, xy, and von Mises stress, Pa, (P,) are on surface
        triangles;
        stress at points, Pa, (G, 11) has the parts `mechanics.readings.STRESS_PARTS`; a marker's displacement, m, (3,);
        a reaction, (6,), is the force, N, and the couple, N m, of supports in the last step, 0 before the first one;
        touch (V,) are the numbers that `touch` takes apart, with what its sensor adds. Which nodes, triangles and
        points: `rom.readings[name]`.

        Raises:
            StepError: no such reading.
        """
        return self.felt(name) if self.sensed is None else self.sensed.shown(name, self.time, self.steps)

    def felt(self, name: str) -> Array:
        """A reading without what a sensor adds; StepError where there is none of that name."""
        raise NotImplementedError

    def _begin_sensing(self) -> None:
        """Begins to know what sensors add, where some do."""
        if any(reading.quantity == "touch" for reading in self.rom.readings.values()):
            from fenics_rom.mechanics.sensor import SensedTouch  # here, as few bodies have a sense of touch

            self.sensed = SensedTouch(self.rom.readings, self.felt)
            self.remembers_touch = self.sensed.remembers

    def note_touch(self, more: int = 0) -> None:
        """Has sensors that remember look, after a step, or after one more than are counted."""
        assert self.sensed is not None
        self.sensed.note(self.time + more * self._dt, self._dt, self.steps + more)

    @property
    def _senses(self) -> "tuple[tuple[Any, ...], tuple[Any, ...] | None, LastStep | None]":
        """What sensors remember, what friction did in the last step, and that step: what there is to save of readings.

        As far as something asks for it.
        """
        if self.sensed is None:
            return (), None, self.last_step
        self._rubbing()
        return self.sensed.state, self._rubbed, self.last_step

    def _sense_again(
        self, sensed: tuple[Any, ...], rubbed: tuple[Any, ...] | None = None, last: "LastStep | None" = None
    ) -> None:
        """Goes on from that."""
        self.last_step = last
        if self.sensed is not None:
            self.sensed.state, self._rubbed = sensed, rubbed

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
