"""Contact of held bodies that deform largely, as their compiled steps are told of it, and tell of it."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain
from fenics_rom.mechanics.compiled.contact_law import Law
from fenics_rom.mechanics.compiled.obstacle_motion import Moving
from fenics_rom.mechanics.compiled_contact import CompiledContact
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.runtime.compiled.held_own import Own
from fenics_rom.runtime.compiled.held_step import Step
from fenics_rom.runtime.compiled.held_touch import Among, Touch
from fenics_rom.runtime.compiled.touching import Last
from fenics_rom.runtime.steppers.compiled_step import Relaxing
from fenics_rom.runtime.steppers.contact_in_loops import ContactInLoops
from fenics_rom.runtime.steppers.residual_motion import ResidualMotion


class HeldContact(ContactInLoops):
    """Arguments as in ContactInLoops.

    Args:
        points: Sᵀ (m, 3P).
        residual: how points yield beyond the basis, if that is known.

    Attributes:
        touch: where points are, as arrays.
    """

    def __init__(self, solver: CompiledContact, points: Array, residual: ResidualMotion | None, h: float):
        super().__init__(solver, h)
        self._residual = residual
        R, times, beyond = np.empty((0, 0)), (0.0, 1.0, 0.0, 0.0), (np.zeros((4, 0)), np.zeros((4, 0)))
        if self._residual is not None:
            R, times, beyond = self._residual.part.compliance, self._residual.times, self._residual.states
        self.touch, self._beyond = Touch(in_plain(points), in_plain(self._solver.points), in_plain(R), *times), beyond
        branches, n = None if residual is None else residual.branches, points.shape[1]
        self._relaxing = Relaxing(branches, 0 if branches is None else len(branches.state), n)
        self._by_branches = np.zeros((0 if branches is None else 2, n))
        self._spread = np.zeros(points.shape)
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
        n = self.touch.points.shape[1]
        return self._among(obstacles, self._law, self._solver.shapes, np.empty((n, n)), None)

    def _among(self, obstacles: ObstacleMotion, law: Law, shapes: Array, W: Array, own: Own | None) -> Among:
        """The same of shapes (O, 17); W (3P, 3P): another one each time, as the solver keeps parts of it."""
        begun, found = self._begun(), self._for_found()
        self._relaxing.begin()
        branches = self._relaxing.rows, self._relaxing.rows_before, self._by_branches
        beyond = *self._beyond, *branches
        return Among(self.touch, law, shapes, Moving(*obstacles), begun, *beyond, found, self._spread, W, own)

    def for_many(self, among: Among) -> tuple[Among, Last]:
        """The same for steps in a row, which change what they begin with; and where the last one is kept."""
        begun, last = self._for_many()
        return among._replace(begun=begun), last

    def keep(self, step: Step, among: Among) -> ContactSolution | None:
        """Contact of a step that was taken; the next search begins with it."""
        self._relaxing.end()
        contact = self._keep(among.found, among.W, self._motion(among), step.sweeps, step.normal_power)
        self._pushing = contact
        return contact

    def keep_last(self, step: Step, among: Among, last: Last) -> ContactSolution | None:
        """The same of steps in a row."""
        self._begin_last(last.begun)
        return self.keep(step, among._replace(found=last.found))

    @staticmethod
    def _motion(among: Among) -> ObstacleMotion:
        return ObstacleMotion(*among.moving)
