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
from fenics_rom.runtime.steppers.adjoint import contact_adjoint
from fenics_rom.runtime.steppers.kernel import BookedKernel, StepWork, symmetric
from fenics_rom.runtime.steppers.taken_step import residual_taken

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.parted_adjoint import PartedAdjoint


class QuasiStatic(BookedKernel):
    """A step to the next equilibrium. Arguments and attributes as in BookedKernel; the velocity stays zero."""

    _dead_loads: Array | None = None  # forces of inputs of 1 (m, p), where they are not those of the model
    _standing: Array = np.zeros(1)  # force without inputs, (m,)

    def act_by(self, dead: Array, standing: Array) -> None:
        """See OnBase."""
        self._dead_loads, self._standing = dead, standing

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
        force = self._columns_of_loads.dot(u) + self._standing
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

    @property
    def _columns_of_loads(self) -> Array:
        return self._model.inputs if self._dead_loads is None else self._dead_loads

    def check_differentiable(self) -> None:
        """As in Kernel."""

    def adjoint(self, u: Array) -> "PartedAdjoint":
        """As in Kernel."""
        from fenics_rom.runtime.steppers.acts.found_forces import FoundForces
        from fenics_rom.runtime.steppers.acts.found_slopes import FoundIn
        from fenics_rom.runtime.steppers.elastic.linear import LinearAdjoint
        from fenics_rom.runtime.steppers.held_part import HeldPart
        from fenics_rom.runtime.steppers.parted_adjoint import Ends, PartedAdjoint

        h, q, q_after, given = (
            self.h,
            self._state_before[: len(self._e)] * self._inverse_ω,
            self._e * self._inverse_ω,
            None,
        )
        v, r, found, columns = (q_after - q) / h, 0 * q, None, self._columns_of_loads
        contact, is_kink = contact_adjoint(self._interface)
        if self._actuators is not None:
            of = FoundForces(None, self._model, self._actuators)
            forces, given = self._actuators.split(u)[0], of.stroke_slopes(q).T
            found = FoundIn(of, forces, self.reactions, h, q, r, v, q_after).resting_slopes()
        residual, rows = residual_taken(self.residual)
        law = LinearAdjoint(self._model, np.zeros(len(q)), h, q, q_after, v, None)
        part = HeldPart(h, 0.0, law, columns, None, 0.0, found, self._Sᵀ, contact, residual, r)
        ends = Ends(self._model.safe_frequencies, 0, q, q_after, rows)
        return PartedAdjoint((part,), ends, is_kink, given, rows_first=True)
