"""Contact forces that a world hands to the stepper of a soft body, in place of a search among obstacles."""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.points_operator import Operator


class Handed(ContactSolution):
    """Forces of other bodies: what work they do is supplied, and what contact dissipates is not this body's."""

    def work_at(self, power: float, dt: float) -> ContactWork:
        """See ContactSolution."""
        return ContactWork(dt * power, 0.0, 0.0)

    @property
    def by_obstacle(self) -> Array:
        """See ContactSolution: of all other bodies together, (1, 3), N."""
        return self.forces.sum(axis=0, keepdims=True)


def handed(forces: Array, reached: Array) -> Handed:
    """Forces (P, 3) on all contact points, and which they may act on."""
    pushed = forces[reached]
    return Handed(forces, 0, reached, 0 * pushed, pushed, np.zeros((0, 3)), None)


def handed_in(forces: Array) -> Handed | None:
    """Forces (P, 3) that others handed to a body, of which a copy is made; None: there are none."""
    reached = forces.any(axis=1).nonzero()[0]
    return handed(forces.copy(), reached) if len(reached) else None


class HandedForces(ContactSolver):
    """In place of what finds the forces of obstacles.

    Attributes:
        reached: contact points (s,) that forces may act on in this step.
        forces: (P, 3) that do, N.
        point_gaps: (P,), m; infinite of points that nothing is near to.
        delassus: W (3 P, 3 P) that the stepper gave last.
    """

    reached: Array = np.empty(0, dtype=int)
    forces: Array = np.empty((0, 3))

    def gaps(self, displacement: Array, offsets: Array) -> Array:
        """See ContactSolver."""
        return self.point_gaps

    def check_start(self, displacement: Array, offsets: Array, names: Any) -> None:
        """See ContactSolver: the world checks it."""
        self.point_gaps = np.full(len(self.points), np.inf)

    def within_reach(self, points: PointMotion, dt: float, obstacles: ObstacleMotion) -> Array:
        """See ContactSolver."""
        return self.reached

    def solve(self, points: PointMotion, delassus: Operator, *_: Any, **__: Any) -> Handed | None:
        """See ContactSolver."""
        self.delassus = delassus
        return handed(self.forces, self.reached) if len(self.reached) else None
