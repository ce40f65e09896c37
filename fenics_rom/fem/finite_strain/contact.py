"""Contact inside Newton's method.

The iteration knows the forces f it has and asks for those that a velocity v̂ needs, found with them: free = S v̂ - W f is
what the points would do without, and after the change of f is put through A⁻¹, S v̂ = free + W f obeys the contact law
exactly, whatever W = S A⁻¹ Sᵀ stands for. So only the balance of momentum is left to converge.
"""

import numpy as np

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.full_order_body import FullOrderInterface
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion

Array = np.ndarray


class ContactInNewton:
    """Contact in the iteration of a step; for each part of one `begin`, then `resolve` and `push`."""

    def __init__(self, interface: FullOrderInterface):
        self._interface = interface
        self._is_rigid = not interface.solver.law.stiffness
        self._factor: PetscFactor | None = None
        self._delassus: Array | None = None

    def begin(self, x: Array, v: Array, h: float, obstacles: ObstacleMotion, quasi_static: bool) -> None:
        """Notes where a part of h, s, of a step begins, which may lead to an equilibrium: x and v (rows here, 1)."""
        self._x, self._v, self._h = self._interface.at_points(x), self._interface.at_points(v), h
        self._obstacles, self._quasi_static = obstacles, quasi_static
        solver = self._interface.solver
        self._before = solver.last_forces, solver.residual
        self._gap = float(solver.gaps(self._x, obstacles.start).min())

    def use(self, factor: PetscFactor) -> None:
        """The factor of A; W (3P, 3P), m/s/N, is made of it as soon as an obstacle is within reach."""
        if self._factor is not factor:
            self._factor, self._delassus = factor, None

    def resolve(self, v: Array, last: ContactSolution | None) -> ContactSolution | None:
        """Contact with a mid-step velocity (rows here, 1) that was found with the last contact of this step."""
        self.rollback()
        free = self._interface.at_points(v)
        if last is None and self._is_out_of_reach(free):
            return None
        if self._delassus is None:
            assert self._factor is not None
            self._delassus = self._interface.delassus(self._factor.solve(self._interface.Sᵀ))
        W = self._delassus
        if last is not None:
            free = free - (W @ last.forces.ravel()).reshape(-1, 3)
        points = PointMotion(self._x, self._v, free)
        return self._interface.solver.solve(points, W, self._h, self._obstacles, self._quasi_static)

    def push(self, contact: ContactSolution | None) -> Array:
        """The contact force (rows here, 1), N."""
        return self._interface.force(contact)

    def rollback(self) -> None:
        """Forgets the contact that was found since `begin`."""
        solver = self._interface.solver
        solver.last_forces, solver.residual = self._before

    def _is_out_of_reach(self, v: Array) -> bool:
        """Whether no pair of the rigid law can come too close at velocities v (P, 3) of the points."""
        if not self._is_rigid:
            return False
        velocities = v, self._v, self._obstacles.velocities(self._h), self._obstacles.velocities_before
        fastest = [np.sqrt(np.square(w).sum(axis=1).max()) for w in velocities]
        w = max(fastest[2], fastest[3])
        return self._gap > self._h * (2 * fastest[0] + fastest[1] + 4 * float(w))
