"""Contact of held bodies that deform largely, as their compiled steps are told of it, and tell of it."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain
from fenics_rom.mechanics.compiled.contact_law import pairs_from
from fenics_rom.mechanics.compiled_contact import CompiledContact, Told
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.runtime.compiled.held_step import Among, Step, Touch
from fenics_rom.runtime.compiled.held_steps import Last
from fenics_rom.runtime.compiled.touching import Begun, StepContact
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


class HeldContact:
    """Of steps of h s.

    Args:
        solver: finds forces.
        points: Sᵀ (m, 3P).
        residual: how points yield beyond the basis, if that is known.
        h: s.

    Attributes:
        touch: where points are, as arrays.
    """

    def __init__(self, solver: CompiledContact, points: Array, residual: ResidualMotion | None, h: float):
        self._h, self._solver, self._residual, n = h, solver, residual, points.shape[1]
        (R, *times), beyond = (np.empty((0, 0)), 0.0, 1.0, 0.0, 0.0), (np.zeros((4, 0)), np.zeros((4, 0)))
        if self._residual is not None:
            (R, *times), beyond = self._residual.numbers, self._residual.states
        self.touch, self._beyond = Touch(in_plain(points), in_plain(self._solver.points), in_plain(R), *times), beyond
        self._spread = np.zeros(points.shape)
        self._rates = np.zeros(n)
        self.forget()

    @property
    def beyond(self) -> Array | None:
        """Velocities (P, 3) of the points beyond the basis in the last step, m/s; None where they have none."""
        return None if self._residual is None else self._rates.reshape(-1, 3)

    def forget(self) -> None:
        """Which forces were in the step before."""
        self._pushing: ContactSolution | bool | None = False

    def know(self, contact: ContactSolution | None) -> None:
        """That these were in the step before."""
        self._pushing = contact

    def set_pushed(self, pushed: Array, contact: ContactSolution | None) -> None:
        """Sets the generalized forces (m,) of contact in the step before, unless they are those that a step set."""
        if contact is not self._pushing:
            pushed[:] = 0.0 if contact is None else self.touch.points.dot(contact.forces.ravel())
            self._pushing = contact

    def among(self, obstacles: ObstacleMotion) -> Among:
        """What a step is told, and where it tells what it found."""
        search, P = self._solver.search, len(self._solver.points)
        pairs = pairs_from(search.forces, self._solver.law.friction)
        found = StepContact(pairs, np.empty(len(search.forces)), np.zeros((4, 3 * P)), np.empty(3 * P))
        begun = Begun(search.forces, self._solver.swung(search))
        law, shapes = self._solver.law_in_steps(self._h), self._solver.shapes
        W = np.empty((3 * P, 3 * P))  # another one each time, as the solver keeps parts of it
        return Among(self.touch, law, shapes, *obstacles, begun, *self._beyond, found, self._spread, W)

    def for_many(self, among: Among) -> tuple[Among, Last]:
        """The same for steps in a row, which change what they begin with; and where the last one is kept."""
        begun, found = Begun(*(each.copy() for each in among.begun)), self.among(self._motion(among)).found
        return among._replace(begun=begun), Last(Begun(*map(np.empty_like, begun)), found)

    def keep(self, step: Step, among: Among) -> ContactSolution | None:
        """Contact of a step that was taken; the next search begins with it."""
        pairs, gaps, motion, forces = among.found
        self._rates, law = motion[3], among.law
        power = step.normal_power if law.friction > 0 else None
        swung = self._solver.search.swung
        told = Told(law, pairs, gaps, forces.reshape(-1, 3), step.sweeps, power, swung)

        def points() -> PointMotion:
            return PointMotion(*motion[:3].reshape(3, -1, 3))

        contact = self._solver.keep(told, points, among.W, self._h, self._motion(among))
        self._pushing = contact
        return contact

    def keep_last(self, step: Step, among: Among, last: Last) -> ContactSolution | None:
        """The same of steps in a row."""
        swung = last.begun.swung if last.begun.swung.any() else None
        self._solver.search = self._solver.search._replace(forces=last.begun.forces, swung=swung)
        return self.keep(step, among._replace(found=last.found))

    @staticmethod
    def _motion(among: Among) -> ObstacleMotion:
        return ObstacleMotion(among.start, among.end, among.w_before)
