"""Contact inside Newton's method.

The iteration knows the forces f it has and asks for those that a velocity v̂ needs, found with them: free = S v̂ - W f is
what the points would do without, and after the change of f is put through A⁻¹, S v̂ = free + W f obeys the contact law
exactly, whatever W = S A⁻¹ Sᵀ stands for. So only the balance of momentum is left to converge.
"""

import numpy as np

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.mechanics.active_environment import ActiveEnvironment, ContactPoints
from fenics_rom.mechanics.contact import Contact, ContactSolution
from fenics_rom.system.system import System

Array = np.ndarray


class Touching:
    """The contact points of a body and the obstacles; for each part of a step `begin`, then `resolve` and `push`.

    Args:
        system: the body.
        surroundings: with a contact law.

    Attributes:
        points: all nodes that can be touched.
        contact: where the forces come from.
    """

    def __init__(self, system: System, surroundings: ActiveEnvironment):
        self._algebra, self._rigid_law = system.algebra, surroundings.law is not None and not surroundings.law.stiffness
        self.points = ContactPoints(system.contact_points, system.body.nodes)
        assert surroundings.law is not None
        self.contact = Contact(self.points.places, list(surroundings.obstacles.values()), surroundings.law)
        self.contact.check_start(np.zeros(self.points.places.shape), surroundings.offsets, list(surroundings.obstacles))
        self._Sᵀ = system.at_nodes(self.points.nodes)
        self._of: PetscFactor | None = None
        self._W = np.empty((0, 0))

    def at_points(self, x: Array) -> Array:
        """What a field (rows here, 1) is at the contact points, (P, 3)."""
        return self._algebra.inner(self._Sᵀ, x).reshape(-1, 3)

    def begin(
        self, x: Array, v: Array, h: float, offsets: tuple[Array, Array], w_before: Array, quasi_static: bool
    ) -> None:
        """Notes where a part of a step begins.

        Args:
            x, v: displacement and velocity (rows here, 1), m and m/s.
            h: of the part, s.
            offsets: of the obstacles (O, 3) at its start and its end, m.
            w_before: velocities of the obstacles (O, 3) before, m/s.
            quasi_static: whether it leads to an equilibrium.
        """
        self._x, self._v, self._h = self.at_points(x), self.at_points(v), h
        self._offsets, self._w_before, self._quasi_static = offsets, w_before, quasi_static
        self._past = self.contact.last, self.contact.loose
        self._gap = float(self.contact.gaps(self._x, offsets[0]).min())

    def use(self, factor: PetscFactor) -> None:
        """The factor of A; W is made of it as soon as an obstacle is within reach."""
        if self._of is not factor:
            self._of, self._W = factor, np.empty((0, 0))

    def resolve(self, v: Array, last: ContactSolution | None) -> ContactSolution | None:
        """Contact with a mid-step velocity (rows here, 1) that was found with the last contact of this step.

        Raises:
            StepError: no forces were found.
        """
        self.rollback()
        at_points = self.at_points(v)
        if last is None and self._out_of_reach(at_points):
            return None
        W = self._compliance()
        free = at_points if last is None else at_points - (W @ last.forces.ravel()).reshape(-1, 3)
        (before, after), h = self._offsets, self._h
        return self.contact.resolve(self._x, self._v, free, W, h, before, after, self._quasi_static, self._w_before)

    def push(self, touched: ContactSolution | None) -> Array:
        """The contact force (rows here, 1), N."""
        if touched is None:
            return np.zeros((len(self._Sᵀ), 1))
        return self._Sᵀ @ touched.forces.reshape(-1, 1)

    def rollback(self) -> None:
        """Forgets the contact that was found since `begin`."""
        self.contact.last, self.contact.loose = self._past

    def _compliance(self) -> Array:
        """W (3P, 3P), m/s/N."""
        if not self._W.size:
            assert self._of is not None
            W = self._algebra.inner(self._Sᵀ, self._of.solve(self._Sᵀ))
            self._W = (W + W.T) / 2
        return self._W

    def _out_of_reach(self, v: Array) -> bool:
        """Whether no pair of the rigid law can come too close at velocities v (P, 3) of the points."""
        if not self._rigid_law:
            return False
        before, after = self._offsets
        fastest = [np.sqrt(np.square(w).sum(axis=1).max()) for w in (v, self._v, (after - before) / self._h)]
        w = max(fastest[2], np.sqrt(np.square(self._w_before).sum(axis=1).max()))
        return self._gap > self._h * (2 * fastest[0] + fastest[1] + 4 * float(w))
