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

    def touch(self) -> "HeldTouch | None":
        """As in StepPart."""
        return None if self.contact is None else HeldTouch.of(self)

    def stored(self) -> tuple[Array, Array]:
        """As in StepPart."""
        return np.zeros_like(self.rate_after), self.rate_after


class HeldTouch(NamedTuple):
    """As in Touch, of points that go with the shape, in the axes of a base if one carries it.

    They are at p + R (X + S q), and go by ŝ = (p⁺ - p + (R⁺ - R) (X + S q))/h + R⁺ S v̂; forces on them act as Sᵀ R⁺ᵀ f.
    """

    contact: ContactAdjoint
    S: Array  # (3P, m)
    residual: ResidualMaps | None
    turns: tuple[Array, Array] | None  # R and R⁺
    h: float
    push: None = None

    @staticmethod
    def of(part: HeldPart) -> "HeldTouch":
        """Of the points of a part that were touched."""
        assert part.contact is not None
        return HeldTouch(part.contact, part.Sᵀ.T, part.residual, part.turns, part.h)

    @property
    def place(self) -> Array:
        """As in Touch."""
        return self.S if self.turns is None else turned(self.turns[0], self.S)

    @property
    def by_forces(self) -> Array:
        """As in Touch."""
        return self.S.T if self.turns is None else turned(self.turns[1], self.S).T

    @property
    def motions(self) -> tuple[Slopes, Slopes]:
        """As in Touch."""
        S, nothing = self.S, np.zeros(self.S.shape)
        if self.turns is None:
            return Slopes(nothing, nothing, S), Slopes(nothing, S, nothing)
        R, R_end = self.turns
        return Slopes(turned((R_end - R) / self.h, S), nothing, turned(R_end, S)), Slopes(nothing, nothing, nothing)

    @property
    def by_yielding(self) -> tuple[Array, Array]:
        """As in Touch."""
        nothing = np.zeros((len(self.S),) * 2)
        if self.residual is None:
            return nothing, nothing
        C = self.residual.delassus
        return C if self.turns is None else turned_operator(self.turns[1], C, self.turns[1]), nothing

    def seen_back(self, seen_: Array) -> tuple[Array, Array, Array]:
        """As in Touch."""
        nothing = np.zeros(self.S.shape[1])
        return nothing, nothing, seen_ if self.turns is None else turned(self.turns[1], seen_)

    def rows_back(self, d_: Array, ŝ_: Array, κ_: Array) -> Array:
        """As in Touch."""
        assert self.residual is not None
        if self.turns is not None:
            R, R_end = self.turns
            d_, ŝ_, κ_ = turned(R.T, d_) + turned((R_end - R).T / self.h, ŝ_), turned(R_end.T, ŝ_), 0 * κ_
        return self.residual.of_points(np.array([d_, κ_, ŝ_]))

    def rows_of_push(self, y: Array) -> Array:
        """As in Touch: nothing."""
        return np.zeros((1, len(self.S)))


def turned(R: Array, of_points: Array) -> Array:
    """R (3, 3) times what is of points, (3P,) or (3P, k)."""
    of_each: Array = (R @ of_points.reshape(-1, 3, of_points.size // len(of_points))).reshape(of_points.shape)
    return of_each
