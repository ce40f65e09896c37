"""Steps of one contact mode among obstacles, and steps without inertia.

Contact points have the displacement S x, S their rows of the basis. In a step of passive midpoint integration

    v̂ = A⁻¹ (G u + 2/h r - ω e + Sᵀ f),

with forces f that `fenics_rom.contact` finds from the velocities S v̂ without them and W = S A⁻¹ Sᵀ. Without inertia a
step leads to the equilibrium e⁺ = ω⁻¹ (G u + Sᵀ f): that is the same with A = h K and b = G u - K x. On its way there
the body dissipates ½ |e⁺ - e|², as a damped motion would under this load.
"""

from typing import NamedTuple

import numpy as np

from fenics_rom.contact import Contact, Resolution
from fenics_rom.ledger import Ledger
from fenics_rom.rom import Mode
from fenics_rom.runtime.midpoint import compliance
from fenics_rom.surroundings import Surroundings

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
    surroundings: Surroundings


class _Work(NamedTuple):
    """What a step is to be booked for, J, and the contact in it."""

    supplied: float
    dissipated: float
    touched: Resolution | None
    velocities: Array


class _Surrounded:
    """What the forms here share: the state, the one before it, and the account of the step between them.

    Args:
        mode: the reduced model.
        ledger: the account to book in, if one is kept.
        drift: displacement along the rigid motions (ρ,), which energy coordinates do not hold; steps add to it.
        touch: the obstacles, if there are any.

    Attributes:
        h: time step, s; 0 before the first `retime`.
        state: [e, r] (2m,), ½|state|² is the stored energy.
        touched: contact in the last step; None where nothing touched.
    """

    def __init__(self, mode: Mode, ledger: Ledger | None, drift: Array, touch: Touch | None):
        self._mode, self._ledger, self._drift, self._touch = mode, ledger, drift, touch
        self.h = 0.0
        self.touched: Resolution | None = None
        self._ω, self._before, self._drifted = np.sqrt(mode.eigenvalues), np.zeros(2 * mode.order), drift.copy()
        self.state = np.zeros(2 * mode.order)
        self._owed: _Work | None = None
        if touch is not None:
            self._S = touch.rows @ mode.coordinates
            self._S_e, self._S_rigid = self._S / mode.divisors, self._S[:, : len(drift)]

    def displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""
        moved = self._S_e @ self.state[: len(self._ω)]
        if len(self._drift):
            moved += self._S_rigid @ self._drift
        return moved.reshape(-1, 3)

    def undo(self) -> None:
        """Takes the last step back."""
        self.state[:] = self._before
        self._drift[:] = self._drifted
        self._owed = None

    def settle(self) -> None:
        """Books what the last step supplied and dissipated."""
        owed, self._owed = self._owed, None
        if owed is None or self._ledger is None:
            return
        self._ledger.book(supplied=owed.supplied, dissipated=owed.dissipated)
        if owed.touched is not None:
            self._ledger.book_contact(*owed.touched.account(owed.velocities, self.h))

    def rewind(self) -> int:
        """Books."""
        self.settle()
        return 0

    def _touched(self, velocity: Array, free: Array, W: Array, quasi_static: bool) -> Resolution | None:
        """Contact forces of a step, from the velocities (m,) of now and of its middle without contact."""
        assert self._touch is not None
        contact, _, around = self._touch
        if around.lap is not None:
            around.lap(MOTION)
        touched = contact.resolve(
            self.displacement(),
            (self._S @ velocity).reshape(-1, 3),
            (self._S @ free).reshape(-1, 3),
            W,
            self.h,
            around.offsets,
            around.ahead,
            quasi_static,
        )
        if around.lap is not None:
            around.lap("contact, friction")
        return touched

    def _keep(self, work: _Work) -> None:
        """Notes what is there before a step, and what is to be booked after it."""
        self.settle()
        self._before[:] = self.state
        self._drifted[:] = self._drift
        self._owed = work


class MidpointAmongObstacles(_Surrounded):
    """The midpoint step with contact. Arguments and attributes as in _Surrounded."""

    def retime(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        self.settle()
        self._a, self._Ra = compliance(self._mode, h)
        spread = self._a[:, None] * self._S.T if self._a.ndim == 1 else self._a @ self._S.T
        W = self._S @ spread
        self._W = (W + W.T) / 2
        self.h = h

    def advance(self, u: Array) -> float:
        """Takes a step under u (p,), N, and returns twice the stored energy, J, which may be anything but finite.

        Raises:
            ValueError: u has another shape; no step was taken.
            StepError: no contact forces were found; no step was taken.
        """
        h, m = self.h, len(self._ω)
        e, r = self.state[:m], self.state[m:]
        right = self._mode.inputs @ u + 2 / h * r - self._ω * e
        v = self._spread(self._a, right)
        touched = self._touched(r, v, self._W, quasi_static=False)
        if touched is not None:
            right += self._S.T @ touched.forces.ravel()
            v = self._spread(self._a, right)
        heat = self._spread(self._Ra, right)
        velocities = (self._S @ v).reshape(-1, 3)
        self._keep(_Work(h * float((self._mode.inputs.T @ v) @ u), h * float(heat @ heat), touched, velocities))
        self._drift += h * v[: len(self._drift)]
        e += h * self._ω * v
        r *= -1
        r += 2 * v
        self.touched = touched
        return float(self.state @ self.state)

    @staticmethod
    def _spread(matrix: Array, right: Array) -> Array:
        return matrix * right if matrix.ndim == 1 else matrix @ right


class Equilibrium(_Surrounded):
    """A step of a quasi-static run. Arguments and attributes as in _Surrounded; the velocity stays zero."""

    def retime(self, h: float) -> None:
        """Makes the coefficients for another time step, s."""
        self.settle()
        if self._touch is not None:
            W = self._S_e @ self._S_e.T / h
            self._W = (W + W.T) / 2
        self.h = h

    def advance(self, u: Array) -> float:
        """As in MidpointAmongObstacles."""
        h, m, ω = self.h, len(self._ω), self._mode.divisors
        e = self.state[:m]
        force = self._mode.inputs @ u
        change = force / ω - e
        touched = None
        if self._touch is not None:
            touched = self._touched(np.zeros(m), change / ω / h, self._W, quasi_static=True)
            if touched is not None:
                change = change + self._S_e.T @ touched.forces.ravel()
        moved = change / ω
        velocities = np.empty((0, 3)) if touched is None else (self._S @ moved / h).reshape(-1, 3)
        self._keep(_Work(float(force @ moved), float(change @ change) / 2, touched, velocities))
        e += change
        self.touched = touched
        return float(self.state @ self.state)
