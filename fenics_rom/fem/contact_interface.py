"""Where a full-order body can be touched, and what finds the forces there."""

import numpy as np

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ContactPoints, ContactSolution
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.system.system import Array, System


class FullOrderInterface:
    """The contact points of a body and the obstacles; every rank must call every method.

    Args:
        system: the body.
        environment: with a contact law.

    Attributes:
        points: nodes that can be touched.
        solver: of the contact law.
        Sᵀ: (rows here, 3P) unit forces on the points.

    Raises:
        StepError: the body begins in an obstacle.
    """

    def __init__(self, system: System, environment: ActiveEnvironment):
        law = environment.environment.contact_law
        assert law is not None
        self._algebra = system.algebra
        self.points = ContactPoints(system.contact_points, system.body.nodes)
        self.solver = ContactSolver(self.points.coordinates, list(environment.obstacles.values()), law)
        at_rest = np.zeros(self.points.coordinates.shape)
        self.solver.check_start(at_rest, environment.state.offsets, list(environment.obstacles))
        self.Sᵀ = system.at_nodes(self.points.nodes)

    def at_points(self, x: Array) -> Array:
        """What a field (rows here, 1) is at the contact points, (P, 3)."""
        return self._algebra.inner(self.Sᵀ, x).reshape(-1, 3)

    def force(self, contact: ContactSolution | None) -> Array:
        """The contact force (rows here, 1), N."""
        if contact is None:
            return np.zeros((len(self.Sᵀ), 1))
        return self.Sᵀ @ contact.forces.reshape(-1, 1)

    def delassus(self, solved: Array) -> Array:
        """W (3P, 3P), m/s/N, from A⁻¹ Sᵀ (rows here, 3P)."""
        W = self._algebra.inner(self.Sᵀ, solved)
        return (W + W.T) / 2


def interface_of(system: System, environment: ActiveEnvironment | None) -> FullOrderInterface | None:
    """The interface of a body in an environment; None where nothing can touch it."""
    if environment is None or environment.environment.contact_law is None:
        return None
    return FullOrderInterface(system, environment)
