"""A step of a held body, or a part of one, to be gone back through; see parted_adjoint.py."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.runtime.steppers.acts.found_slopes import FoundSlopes
from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps
from fenics_rom.runtime.steppers.slopes import Slopes
from fenics_rom.runtime.steppers.touch_adjoint import Touch

UNIT = np.eye(3)


class HeldPart(NamedTuple):
    """As in StepPart: inertia (v̂ - r) + f̂ = loads + B z + Sᵀ f, q⁺ = q + h v̂, and r⁺ = 2 v̂ - r or 0."""

    h: float  # s
    inertia: float  # 2/h; 0 of equilibria, where r stays 0
    law: LawAdjoint
    columns: Array  # of the inputs where they act (m, p)
    turned: Array | None  # ∂(loads, and what is found)/∂q there (m, m), at q + reach v̂; None: they stay
    reach: float  # s
    found: FoundSlopes | None
    Sᵀ: Array  # (m, 3P)
    contact: ContactAdjoint | None
    residual: ResidualMaps | None
    rate_after: Array  # r (m,) at its end

    @property
    def own(self) -> slice:
        """As in StepPart."""
        return slice(0, None)

    @property
    def shape(self) -> slice:
        """As in StepPart."""
        return slice(0, None)

    @property
    def by_velocity_before(self) -> None:
        """As in StepPart: nothing."""

    @property
    def by_forces(self) -> Array:
        """Sᵀ, of forces that are known."""
        return self.Sᵀ

    @property
    def half(self) -> float:
        """As in StepPart."""
        return self.h / 2

    def back(self, place_: Array, velocity_: Array) -> tuple[Array, Array, Array]:
        """As in StepPart."""
        if not self.inertia:
            return place_, velocity_, self.h * place_
        return place_, -velocity_, self.h * place_ + 2 * velocity_

    def balance(self) -> tuple[Slopes, Array]:
        """As in StepPart."""
        turned = np.zeros((len(self.columns),) * 2) if self.turned is None else self.turned
        inertia = self.inertia * np.eye(len(turned))
        return Slopes(-turned, -inertia, inertia - self.reach * turned), self.columns

    def touch(self) -> Touch | None:
        """As in StepPart."""
        if self.contact is None:
            return None
        S, P, residual = self.Sᵀ.T, self.Sᵀ.shape[1] // 3, self.residual
        nothing, yields = np.zeros(S.shape), np.zeros((len(S), len(S)))
        motions = Slopes(nothing, nothing, S), Slopes(nothing, S, nothing)
        by_û = yields if residual is None else residual.delassus
        still, along = np.zeros((P, 3, 3)), np.broadcast_to(UNIT, (P, 3, 3))
        blocks = (still, along, still), (still, still, along)
        return Touch(self.contact, residual, UNIT, UNIT, S, S.T, motions, (by_û, yields), blocks)

    def stored(self) -> tuple[Array, Array]:
        """As in StepPart."""
        return np.zeros_like(self.rate_after), self.rate_after
