"""Steps of one contact mode among obstacles, and steps without inertia.

Contact points have the displacement S x, S their rows of the basis. In a step of passive midpoint integration

    v̂ = A⁻¹ (G u + 2/h r - ω e + Sᵀ f),

with forces f that contact needs for the free velocity S v̂ without them and the Delassus operator W = S A⁻¹ Sᵀ. Without
inertia a step leads to the equilibrium e⁺ = ω⁻¹ (G u + Sᵀ f): that is the same with A = h K and b = G u - K x. On the
way there all forces change linearly, as the shape does then: the loads supply ½ (F + F⁺)·(q⁺ - q), which is all stored
where nothing touches or rubs. F = ω e - Sᵀ f are those that held the body before, f of the step before.

Actuators by stroke, and tendons that rub, have forces z that are found with those of contact: G u + B z is in place of
G u, with their columns B.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.runtime.steppers.kernel import BookedKernel, StepWork, symmetric


class ContactMidpoint(BookedKernel):
    """The midpoint step with contact. Arguments and attributes as in BookedKernel."""

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._a, self._Ra = compliance(self._model, h)
        if self._interface is not None:
            self._delassus = self._with_residual(symmetric(self._Sᵀ.T @ _applied(self._a, self._Sᵀ)))
        if self._actuators is not None:
            self._columns = self._model.inputs[:, self._actuators.columns]
            self._spread = _applied(self._a, self._columns)
        self._elastic_and_inertial = np.stack([-self._ω, np.full(self._model.order, 2 / h)])
        self._travel = h * self._ω

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        u, given = (u, None) if self._actuators is None else self._actuators.split(u)
        pushed = self._model.inputs.dot(u)
        elastic, inertial = self._elastic_and_inertial * self._halves
        right = pushed + elastic + inertial
        v = _applied(self._a, right)
        q, found = self._coordinates(), self.reactions
        if given is None or self._actuators is None:
            contact = self._solve_contact(q, self._r, v, self.h, obstacles)
        else:
            strokes, rates = np.stack([q, self._r]).dot(self._columns)
            targets = self._actuators.rates(given, strokes, rates, self.h)
            motion = q, self._r, v, self.h, obstacles
            found, contact = self._solve_actuators(u, self._columns, self._spread, targets, *motion)
            by_strokes, rubbed = self._actuators.parts(self._columns, found)
            pushed, right = pushed + by_strokes, right + by_strokes + rubbed
        if contact is not None:
            right += self._pushed(contact)
        if contact is not None or given is not None:
            v = _applied(self._a, right)
        heat = _applied(self._Ra, right)
        h, supplied, dissipated = self.h, float(pushed.dot(v)), float(heat.dot(heat))
        if given is not None:
            dissipated -= float(rubbed.dot(v))
        residual, heat_of_residual = self._step_residual(contact)
        contacts = self._contacts(v, contact, h, residual)
        self._leave(StepWork(h * supplied, h * dissipated + heat_of_residual, contacts))
        if len(self._rigid_displacement):
            self._rigid_displacement += h * v[: len(self._rigid_displacement)]
        self._e += self._travel * v
        np.subtract(v + v, self._r, self._r)
        self.contact, self.reactions = contact, found
        return 2 * self.energy


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


def _applied(matrix: Array, columns: Array) -> Array:
    """The product with a diagonal (m,) or a whole matrix (m, m), of a vector or columns."""
    if matrix.ndim == 2:
        return matrix.dot(columns)
    return matrix * columns if columns.ndim == 1 else matrix[:, None] * columns
