"""Steps of one contact mode without inertia.

Contact points have the displacement S x, S their rows of the basis. A step leads to the equilibrium

    e⁺ = ω⁻¹ (G u + Sᵀ f),

which for contact is a step of passive midpoint integration with A = h K and b = G u - K x. On the way there all forces
change linearly, as the shape does then: the loads supply ½ (F + F⁺)·(q⁺ - q), which is all stored where nothing touches
or rubs. F = ω e - Sᵀ f are those that held the body before, f of the step before.

Actuators by stroke, and tendons that rub, have forces z that are found with those of contact: G u + B z is in place of
G u, with their columns B.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.runtime.steppers.adjoint import check_is_differentiated, contact_adjoint
from fenics_rom.runtime.steppers.kernel import BookedKernel, StepWork, symmetric

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint


class QuasiStatic(BookedKernel):
    """A step to the next equilibrium. Arguments and attributes as in BookedKernel; the velocity stays zero."""

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        if self._interface is not None:
            strained = self._inverse_ω[:, None] * self._Sᵀ
            self._delassus = self._with_residual(symmetric(strained.T @ strained / h))
        if self._actuators is not None:
            self._columns = self._model.inputs[:, self._actuators.columns]
            self._spread = self._inverse_ω[:, None] ** 2 / h * self._columns

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        u, given = (u, None) if self._actuators is None else self._actuators.split(u)
        force = self._model.inputs.dot(u)
        change = force * self._inverse_ω - self._e
        free = change * self._inverse_ω / self.h
        motion, found = (self._coordinates(), self._r, free, self.h, obstacles, True), self.reactions
        held = self._ω * self._e  # the body so far, but for contact and guides
        if self._interface is not None and self.contact is not None:
            held -= self._pushed(self.contact)
        if given is None or self._actuators is None:
            contact = self._solve_contact(*motion)
        else:
            targets = self._actuators.resting_rates(given, self._coordinates().dot(self._columns), self.h)
            found, contact = self._solve_actuators(u, self._columns, self._spread, targets, *motion)
            by_strokes, rubbed = self._actuators.parts(self._columns, found)
            force = force + by_strokes
            change += (by_strokes + rubbed) * self._inverse_ω
        if contact is not None:
            change += self._inverse_ω * self._pushed(contact)
        moved, dissipated, numerical = change * self._inverse_ω, 0.0, 0.0
        if given is not None and self._actuators is not None:
            _, rubbed_before = self._actuators.parts(self._columns, self.reactions)
            held -= rubbed_before
            dissipated, numerical = -float(rubbed.dot(moved)), float((rubbed - rubbed_before).dot(moved)) / 2
        supplied = float((held + force).dot(moved)) / 2
        residual, of_residual = self._step_residual_at_rest(contact)
        contacts = self._contacts_at_rest(moved, contact, obstacles, residual)
        self._leave(StepWork(supplied + of_residual, dissipated, contacts, numerical))
        self._e += change
        self.contact, self.reactions = contact, found
        return 2 * self.energy

    def check_differentiable(self) -> None:
        """As in Kernel."""
        check_is_differentiated(self._actuators, self.branches)

    def adjoint(self, u: Array) -> "BalanceAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.balance_adjoint import BalanceAdjoint, BalancedPart, HeldStrokes, StrokesGiven

        h, γ, m = self.h, self._model.eigenvalues, self._model.order
        B, places, held = np.empty((m, 0)), np.empty(0, dtype=int), np.empty(0, dtype=int)
        if self._actuators is not None:
            B, places, held = self._columns, self._actuators.columns + len(u), self._actuators.held(self.reactions)
        columns = B[:, held]
        strokes = HeldStrokes(columns, h * columns.T, columns.T, 0 * columns.T, -1.0)  # strokes are what is given
        contact, is_kink = contact_adjoint(self._interface)
        residual, rows = None, None
        if self.residual is not None:
            residual, rows = self.residual.maps, self.residual.state.reshape(4, -1).copy()
        part = BalancedPart(
            h, 0.0, np.diag(h * γ), np.diag(γ), self._model.inputs, strokes, self._Sᵀ, contact, residual
        )
        q, q_after = self._state_before[:m] * self._inverse_ω, self._e * self._inverse_ω
        of_stored = self._ω * self._e
        given = StrokesGiven(places, B)
        return BalanceAdjoint([part], [held], given, self._ω, of_stored, q, q_after, 0 * q, rows, is_kink, True)
