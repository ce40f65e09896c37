"""Steps of one contact mode among obstacles, and steps without inertia.

Contact points have the displacement S x, S their rows of the basis. In a step of passive midpoint integration

    v̂ = A⁻¹ (G u + 2/h r - ω e + Sᵀ f),

with forces f that `mechanics.contact` finds from the velocities S v̂ without them and W = S A⁻¹ Sᵀ. Without inertia a
step leads to the equilibrium e⁺ = ω⁻¹ (G u + Sᵀ f): that is the same with A = h K and b = G u - K x. On its way there
the body dissipates ½ |e⁺ - e|², as a damped motion would under this load.
"""

from typing import NamedTuple

import numpy as np

from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import Contact, ContactSolution
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.rom.rom import ContactModel
from fenics_rom.runtime.steppers.midpoint import compliance

Array = np.ndarray

MOTION = "inertia, damping, elasticity"  # what is not loads and contact


class Touch(NamedTuple):
    """What can touch: all contact points of the body, whatever contact mode is active, and the obstacles.

    Attributes:
        contact: where the forces come from.
        rows: (3P, k) of the points in the shared basis.
        surroundings: where the obstacles are.
    """

    contact: Contact
    rows: Array
    surroundings: ActiveEnvironment


class Work(NamedTuple):
    """What a step is to be booked for.

    Attributes:
        supplied, dissipated: but for contact, J.
        touches: contact in each part of the step, the mid-step velocities of the points (P, 3), m/s, and its length, s.
    """

    supplied: float
    dissipated: float
    touches: tuple[tuple[ContactSolution, Array, float], ...]


class ContactStepper:
    """What the forms here share: the state, the one before it, and the account of the step between them.

    Args:
        mode: the reduced model.
        ledger: the account to book in, if one is kept.
        rigid_displacement: displacement along the rigid motions (ρ,), which energy coordinates lack; steps add to it.
        touch: the obstacles, if there are any.

    Attributes:
        h: time step, s; 0 before the first `set_time_step`.
        state: [e, r] (2m,), ½|state|² is the stored energy.
        touched: contact in the last step; None where nothing touched.
    """

    def __init__(self, mode: ContactModel, ledger: EnergyLedger | None, rigid_displacement: Array, touch: Touch | None):
        self._mode, self._ledger, self._rigid_displacement, self._touch = mode, ledger, rigid_displacement, touch
        self.h = 0.0
        self.touched: ContactSolution | None = None
        self._touched_before: ContactSolution | None = None
        self._ω, self._inverse_ω = np.sqrt(mode.eigenvalues), 1 / mode.safe_frequencies
        self.state, self._before, self._drifted = (
            np.zeros(2 * mode.order),
            np.zeros(2 * mode.order),
            rigid_displacement.copy(),
        )
        self._halves = self.state.reshape(2, -1)
        self._e, self._r = self._halves
        self._owed: Work | None = None
        self._seen = np.zeros((3, mode.order))  # q, r and v̂, of which the points' are read together
        if touch is not None:
            self._Sᵀ = np.ascontiguousarray((touch.rows @ mode.coordinates).T)
            self._W = np.empty((0, 0))

    @property
    def energy(self) -> float:
        """Stored, J."""
        return float(self.state.dot(self.state)) / 2

    def displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""
        return self._coordinates().dot(self._Sᵀ).reshape(-1, 3)

    def _coordinates(self) -> Array:
        """q (m,), which a later call overwrites."""
        q = self._seen[0]
        np.multiply(self._e, self._inverse_ω, q)
        if len(self._rigid_displacement):
            q[: len(self._rigid_displacement)] = self._rigid_displacement
        return q

    def set_time_step(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        raise NotImplementedError

    def step(self, u: Array) -> float:
        """Takes a step under u (p,), N, and returns twice the stored energy, J, which may be anything but finite.

        Raises:
            ValueError: u has another shape; no step was taken.
            StepError: no contact forces were found; no step was taken.
        """
        raise NotImplementedError

    def rollback(self) -> None:
        """Takes the last step back."""
        self.state[:] = self._before
        self._rigid_displacement[:] = self._drifted
        self._owed, self.touched = None, self._touched_before

    def flush(self) -> None:
        """Books what the last step supplied and dissipated."""
        owed, self._owed = self._owed, None
        if owed is None or self._ledger is None:
            return
        self._ledger.book(supplied=owed.supplied, dissipated=owed.dissipated)
        for touched, velocities, h in owed.touches:
            self._ledger.book_contact(*touched.account(velocities, h))

    def reset_buffer(self) -> int:
        """Books."""
        self.flush()
        return 0

    def _touched(self, free: Array, quasi_static: bool) -> ContactSolution | None:
        """Contact forces of a step, from its mid-step velocity without contact (m,)."""
        assert self._touch is not None
        contact, _, around = self._touch
        if around.lap is not None:
            around.lap(MOTION)
        self._coordinates()
        self._seen[1], self._seen[2] = self._r, free
        displacement, velocity, free = self._seen.dot(self._Sᵀ).reshape(3, -1, 3)
        touched = contact.resolve(
            displacement, velocity, free, self._W, self.h, around.offsets, around.ahead, quasi_static, around.velocities
        )
        if around.lap is not None:
            around.lap("contact, friction")
        return touched

    def _touches(
        self, v: Array, touched: ContactSolution | None, h: float
    ) -> tuple[tuple[ContactSolution, Array, float], ...]:
        """What Work holds of contact at mid-step velocities v̂ (m,) in h s; nothing where nothing touches."""
        return () if touched is None else ((touched, v.dot(self._Sᵀ).reshape(-1, 3), h),)

    def _keep(self, work: Work) -> None:
        """Notes what is there before a step, and what is to be booked after it."""
        self.flush()
        self._before[:] = self.state
        self._drifted[:] = self._rigid_displacement
        self._owed, self._touched_before = work, self.touched


class ContactMidpoint(ContactStepper):
    """The midpoint step with contact. Arguments and attributes as in ContactStepper."""

    def set_time_step(self, h: float) -> None:
        """As in ContactStepper."""
        self.flush()
        self._a, self._Ra = compliance(self._mode, h)
        W = self._Sᵀ.T @ (self._a[:, None] * self._Sᵀ if self._a.ndim == 1 else self._a @ self._Sᵀ)
        self._W = (W + W.T) / 2
        self._kept = np.stack([-self._ω, np.full(self._mode.order, 2 / h)])
        self._travel = h * self._ω
        self.h = h

    def step(self, u: Array) -> float:
        """As in ContactStepper."""
        pushed = self._mode.inputs.dot(u)
        elastic, inertial = self._kept * self._halves
        right = pushed + elastic + inertial
        v = self._spread(self._a, right)
        touched = self._touched(v, quasi_static=False)
        if touched is not None:
            right += self._Sᵀ.dot(touched.forces.ravel())
            v = self._spread(self._a, right)
        heat = self._spread(self._Ra, right)
        h, supplied, dissipated = self.h, float(pushed.dot(v)), float(heat.dot(heat))
        self._keep(Work(h * supplied, h * dissipated, self._touches(v, touched, h)))
        if len(self._rigid_displacement):
            self._rigid_displacement += h * v[: len(self._rigid_displacement)]
        self._e += self._travel * v
        np.subtract(v + v, self._r, self._r)
        self.touched = touched
        return self.state.dot(self.state)

    @staticmethod
    def _spread(matrix: Array, right: Array) -> Array:
        return matrix * right if matrix.ndim == 1 else matrix.dot(right)


class Equilibrium(ContactStepper):
    """A step of a quasi-static run. Arguments and attributes as in ContactStepper; the velocity stays zero."""

    def set_time_step(self, h: float) -> None:
        """As in ContactStepper."""
        self.flush()
        if self._touch is not None:
            strained = self._inverse_ω[:, None] * self._Sᵀ
            W = strained.T @ strained / h
            self._W = (W + W.T) / 2
        self.h = h

    def step(self, u: Array) -> float:
        """As in ContactStepper."""
        force = self._mode.inputs.dot(u)
        change = force * self._inverse_ω - self._e
        touched = None
        if self._touch is not None:
            touched = self._touched(change * self._inverse_ω / self.h, quasi_static=True)
            if touched is not None:
                change += self._inverse_ω * self._Sᵀ.dot(touched.forces.ravel())
        moved = change * self._inverse_ω
        touches = self._touches(moved / self.h, touched, self.h)
        self._keep(Work(float(force.dot(moved)), float(change.dot(change)) / 2, touches))
        self._e += change
        self.touched = touched
        return self.state.dot(self.state)
