"""Contact in steps that compiled loops take: what they begin with of it, and what comes of it for those that follow."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.compiled.contact_law import Law, pairs_from
from fenics_rom.mechanics.compiled_contact import CompiledContact, Told
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.runtime.compiled.touching import Begun, Last, StepContact


class ContactInLoops:
    """Of steps of h s.

    Args:
        solver: finds forces.
        h: s.
    """

    def __init__(self, solver: CompiledContact, h: float):
        self._h, self._solver = h, solver
        self._rates = np.zeros(3 * len(solver.points))

    @property
    def _law(self) -> Law:
        """In these steps."""
        return self._solver.law_in_steps(self._h)

    def _begun(self) -> Begun:
        """What a step begins with."""
        return Begun(self._solver.search.forces, self._solver.swung(self._solver.search))

    def _for_found(self) -> StepContact:
        """Where a step tells what it found."""
        search, P = self._solver.search, len(self._solver.points)
        pairs = pairs_from(search.forces, self._solver.law.friction)
        return StepContact(pairs, np.empty(len(search.forces)), np.zeros((4, 3 * P)), np.empty(3 * P))

    def _for_many(self) -> tuple[Begun, Last]:
        """What steps in a row begin with, which they change; and where the last one tells of itself."""
        begun = Begun(*(each.copy() for each in self._begun()))
        return begun, Last(Begun(*map(np.empty_like, begun)), self._for_found())

    def _keep(
        self, found: StepContact, W: Array, obstacles: ObstacleMotion, sweeps: int, normal_power: float
    ) -> ContactSolution | None:
        """Contact of a step that was taken; the next search begins with it."""
        pairs, gaps, motion, forces = found
        self._rates, law, swung = motion[3], self._law, self._solver.search.swung
        power = normal_power if law.friction > 0 else None
        told = Told(law, pairs, gaps, forces.reshape(-1, 3), sweeps, power, swung)

        def points() -> PointMotion:
            return PointMotion(*motion[:3].reshape(3, -1, 3))

        known = told.known(self._solver, self._solver.search.forces, points, W, self._h, obstacles)
        seen = self._solver.seen(points().displacement, obstacles, self._h) if told.touches else None
        return self._solver.keep(told, known, obstacles.velocities(self._h), seen)

    def _begin_last(self, begun: Begun) -> None:
        """Has the last of steps in a row have begun so."""
        swung = begun.swung if begun.swung.any() else None
        self._solver.search = self._solver.search._replace(forces=begun.forces, swung=swung)
