"""What kernels share whose steps are booked one by one: the state, the one before it, and the account between them."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.rom import ContactModel
from fenics_rom.runtime.steppers.kernel import Kernel

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface

Array = np.ndarray


class StepWork(NamedTuple):
    """What a step is to be booked for.

    Attributes:
        supplied, dissipated: but for contact, J.
        contacts: contact in each part of the step, mid-step velocities of the points (P, 3), m/s, and its length, s.
    """

    supplied: float
    dissipated: float
    contacts: tuple[tuple[ContactSolution, Array, float], ...]


class BookedKernel(Kernel):
    """State and account of steps that are booked one by one.

    Args:
        model: the reduced model of a contact mode.
        ledger: the account to book in, if one is kept.
        rigid_displacement: along the rigid motions (ρ,), which energy coordinates lack; steps add to it.
        interface: the contact points, if there are any.

    Attributes as in Kernel.
    """

    def __init__(
        self,
        model: ContactModel,
        ledger: EnergyLedger | None,
        rigid_displacement: Array,
        interface: "ContactInterface | None",
    ):
        self._model, self._ledger, self._interface = model, ledger, interface
        self._rigid_displacement = rigid_displacement
        self.h = 0.0
        self._contact_before: ContactSolution | None = None
        self._ω, self._inverse_ω = np.sqrt(model.eigenvalues), 1 / model.safe_frequencies
        self.state, self._state_before = np.zeros(2 * model.order), np.zeros(2 * model.order)
        self._rigid_before = rigid_displacement.copy()
        self._halves = self.state.reshape(2, -1)
        self._e, self._r = self._halves
        self._owed: StepWork | None = None
        self._motion = np.zeros((3, model.order))  # q, r and v̂, of which the points' are read together
        self._delassus = np.empty((0, 0))  # W (3P, 3P)
        if interface is not None:
            self._Sᵀ = np.ascontiguousarray((interface.rows @ model.coordinates).T)

    def point_displacement(self) -> Array:
        """As in Kernel."""
        return self._coordinates().dot(self._Sᵀ).reshape(-1, 3)

    def rollback(self) -> None:
        """As in Kernel."""
        self.state[:] = self._state_before
        self._rigid_displacement[:] = self._rigid_before
        self._owed, self.contact = None, self._contact_before

    def flush(self) -> None:
        """As in Kernel."""
        owed, self._owed = self._owed, None
        if owed is None or self._ledger is None:
            return
        self._ledger.book(supplied=owed.supplied, dissipated=owed.dissipated)
        for contact, velocities, h in owed.contacts:
            self._ledger.book_contact(*contact.work(velocities, h))

    def _coordinates(self) -> Array:
        """q (m,), which a later call overwrites."""
        q = self._motion[0]
        np.multiply(self._e, self._inverse_ω, q)
        if len(self._rigid_displacement):
            q[: len(self._rigid_displacement)] = self._rigid_displacement
        return q

    def _solve_contact(
        self, free: Array, obstacles: ObstacleMotion | None, quasi_static: bool = False
    ) -> ContactSolution | None:
        """Contact of a step, from its mid-step velocity without (m,) and the Delassus operator."""
        if self._interface is None or obstacles is None:
            return None
        self._coordinates()
        self._motion[1], self._motion[2] = self._r, free
        points = PointMotion(*self._motion.dot(self._Sᵀ).reshape(3, -1, 3))
        return self._interface.solve(points, self._delassus, self.h, obstacles, quasi_static)

    def _contacts(
        self, v: Array, contact: ContactSolution | None, h: float
    ) -> tuple[tuple[ContactSolution, Array, float], ...]:
        """What StepWork holds of contact at mid-step velocities v̂ (m,) in h s; nothing where nothing touches."""
        return () if contact is None else ((contact, v.dot(self._Sᵀ).reshape(-1, 3), h),)

    def _leave(self, work: StepWork) -> None:
        """Notes what is there before a step, and what is to be booked after it."""
        self.flush()
        self._state_before[:] = self.state
        self._rigid_before[:] = self._rigid_displacement
        self._owed, self._contact_before = work, self.contact


def symmetric(matrix: Array) -> Array:
    """(A + Aᵀ)/2."""
    return (matrix + matrix.T) / 2
