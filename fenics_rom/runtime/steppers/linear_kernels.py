"""Steps of one contact mode among obstacles, and steps without inertia.

Contact points have the displacement S x, S their rows of the basis. In a step of passive midpoint integration

    v̂ = A⁻¹ (G u + 2/h r - ω e + Sᵀ f),

with forces f that contact needs for the free velocity S v̂ without them and the Delassus operator W = S A⁻¹ Sᵀ. Without
inertia a step leads to the equilibrium e⁺ = ω⁻¹ (G u + Sᵀ f): that is the same with A = h K and b = G u - K x. On its
way there the body dissipates ½ |e⁺ - e|², as a damped motion would under this load.
"""

import numpy as np

from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.runtime.steppers.kernel import BookedKernel, StepWork, symmetric
from fenics_rom.runtime.steppers.midpoint import compliance

Array = np.ndarray


class ContactMidpoint(BookedKernel):
    """The midpoint step with contact. Arguments and attributes as in BookedKernel."""

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._a, self._Ra = compliance(self._model, h)
        self._delassus = symmetric(
            self._Sᵀ.T @ (self._a[:, None] * self._Sᵀ if self._a.ndim == 1 else self._a @ self._Sᵀ)
        )
        self._elastic_and_inertial = np.stack([-self._ω, np.full(self._model.order, 2 / h)])
        self._travel = h * self._ω

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        pushed = self._model.inputs.dot(u)
        elastic, inertial = self._elastic_and_inertial * self._halves
        right = pushed + elastic + inertial
        v = _applied(self._a, right)
        contact = self._solve_contact(self._coordinates(), self._r, v, self.h, obstacles)
        if contact is not None:
            right += self._pushed(contact)
            v = _applied(self._a, right)
        heat = _applied(self._Ra, right)
        h, supplied, dissipated = self.h, float(pushed.dot(v)), float(heat.dot(heat))
        self._leave(StepWork(h * supplied, h * dissipated, self._contacts(v, contact, h)))
        if len(self._rigid_displacement):
            self._rigid_displacement += h * v[: len(self._rigid_displacement)]
        self._e += self._travel * v
        np.subtract(v + v, self._r, self._r)
        self.contact = contact
        return self.state.dot(self.state)


class QuasiStatic(BookedKernel):
    """A step to the next equilibrium. Arguments and attributes as in BookedKernel; the velocity stays zero."""

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        if self._interface is not None:
            strained = self._inverse_ω[:, None] * self._Sᵀ
            self._delassus = symmetric(strained.T @ strained / h)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        force = self._model.inputs.dot(u)
        change = force * self._inverse_ω - self._e
        free = change * self._inverse_ω / self.h
        contact = self._solve_contact(self._coordinates(), self._r, free, self.h, obstacles, quasi_static=True)
        if contact is not None:
            change += self._inverse_ω * self._pushed(contact)
        moved = change * self._inverse_ω
        contacts = self._contacts(moved / self.h, contact, self.h)
        self._leave(StepWork(float(force.dot(moved)), float(change.dot(change)) / 2, contacts))
        self._e += change
        self.contact = contact
        return self.state.dot(self.state)


def _applied(matrix: Array, vector: Array) -> Array:
    """The product with a diagonal (m,) or a whole matrix (m, m)."""
    return matrix * vector if matrix.ndim == 1 else matrix.dot(vector)
