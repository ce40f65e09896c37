"""A step of a held body, or a part of one, to be gone back through; see parted_adjoint.py."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.mechanics.frame_geometry import turned_operator
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
    turns: tuple[Array, Array] | None = None  # R and R⁺ (3, 3) of a base that carries it; None: nothing turns it

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
        """As in StepPart: points are at p + R (X + S q), and go by ŝ = (p⁺ - p + (R⁺ - R) (X + S q))/h + R⁺ S v̂.

        Forces on them act as Sᵀ R⁺ᵀ f. Of a body that no base carries R is 1.
        """
        if self.contact is None:
            return None
        S, (R, R_end) = self.Sᵀ.T, self.turns or (UNIT, UNIT)
        by_base, nothing, still = (R_end - R) / self.h, np.zeros(S.shape), np.zeros((3, 3))
        there, ends = _turned(R, S), _turned(R_end, S)
        motions = Slopes(_turned(by_base, S), nothing, ends), Slopes(nothing, there, nothing)
        yields = np.zeros((len(S), len(S)))
        by_û = yields if self.residual is None else turned_operator(R_end, self.residual.delassus, R_end)
        of_points = [np.broadcast_to(each, (len(S) // 3, 3, 3)) for each in (by_base, R_end, still, still, still, R)]
        blocks = (of_points[0], of_points[1], of_points[2]), (of_points[3], of_points[4], of_points[5])
        return Touch(self.contact, self.residual, R_end, R, there, ends.T, motions, (by_û, yields), blocks)

    def stored(self) -> tuple[Array, Array]:
        """As in StepPart."""
        return np.zeros_like(self.rate_after), self.rate_after


def _turned(R: Array, of_points: Array) -> Array:
    """R (3, 3) times what is of points, (3P,) or (3P, k)."""
    of_each: Array = (R @ of_points.reshape(-1, 3, of_points.size // len(of_points))).reshape(of_points.shape)
    return of_each
