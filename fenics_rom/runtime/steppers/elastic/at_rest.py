"""What resists the shape of a body without inertia: forces Φ'(q) of a potential, and how to go back through them.

A body that deforms largely has them itself (`ReducedDeformation`). Springs to the ground add ½ qᵀK_s q - s·q + c to Φ:
of a held body K_s is in its stiffness, and what they pull the unbent body with, s, changes with the base of another.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.elastic.law import LawOwed


class Potential(Protocol):
    """Φ of a shape q (m,)."""

    def energy(self, q: Array) -> float:
        """Φ, J."""

    def force(self, q: Array) -> Array:
        """Φ' (m,)."""

    def tangent(self, q: Array) -> Array:
        """Φ'' (m, m)."""


class SmallStrains(NamedTuple):
    """½ Σ γ q² of a contact model."""

    eigenvalues: Array  # γ (m,)

    def energy(self, q: Array) -> float:
        """As in Potential."""
        return float(q.dot(self.eigenvalues * q)) / 2

    def force(self, q: Array) -> Array:
        """As in Potential."""
        return self.eigenvalues * q

    def tangent(self, q: Array) -> Array:
        """As in Potential."""
        return np.diag(self.eigenvalues)

    def solve(self, forces: Array) -> Array:
        """Displacements that follow forces (m,), or columns of these."""
        return forces / self.eigenvalues if forces.ndim == 1 else forces / self.eigenvalues[:, None]


class Tied(NamedTuple):
    """A potential with that of springs to the ground."""

    body: Potential
    springs: Array  # K_s (m, m)
    pull: Array  # s (m,)
    unbent: float  # c, J

    def of_springs(self, q: Array) -> float:
        """What springs store, J."""
        return float(q.dot(self.springs).dot(q)) / 2 - float(self.pull.dot(q)) + self.unbent

    def energy(self, q: Array) -> float:
        """As in Potential."""
        return self.body.energy(q) + self.of_springs(q)

    def force(self, q: Array) -> Array:
        """As in Potential."""
        return self.body.force(q) + self.springs.dot(q) - self.pull

    def tangent(self, q: Array) -> Array:
        """As in Potential."""
        return self.body.tangent(q) + self.springs


class RestingAdjoint(NamedTuple):
    """An equilibrium of forces Φ'(q⁺), q⁺ = q + h v̂, to go back through; see LawAdjoint."""

    tangent: Array  # at q⁺ (m, m)
    h: float  # s
    slope: Array  # Φ' there (m,)
    q_after: Array
    model: ContactModel | None  # of small strains

    @property
    def by_velocity(self) -> Array:
        """As in LawAdjoint."""
        return self.h * self.tangent

    @property
    def by_shape(self) -> Array:
        """As in LawAdjoint."""
        return self.tangent

    def after(self, carried: Array, energy: float) -> LawOwed:
        """As in LawAdjoint."""
        nothing = np.zeros(len(self.slope))
        return LawOwed(energy * self.slope, nothing, nothing, energy)

    def before(self, y: Array, owed: LawOwed) -> tuple[Array, Array, Array]:
        """As in LawAdjoint."""
        return NONE, np.zeros(len(y)), NONE

    def with_velocity(self, carried: Array, v_: Array) -> Array:
        """As in LawAdjoint: it is not carried."""
        return carried

    def by_model(self, y: Array, owed: LawOwed) -> tuple[Array, Array]:
        """As in LawAdjoint: D plays no part."""
        if self.model is None:
            return NONE, NONE
        ω, q = np.sqrt(self.model.eigenvalues), self.q_after
        return ω * q * (owed.kept * q - 2 * y), np.zeros_like(self.model.damping)
