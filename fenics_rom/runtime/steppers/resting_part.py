"""An equilibrium on a base that carries the body, to be gone back through; see parted_adjoint.py and on_base.py.

It is that of a held body in the axes of the base, and depends on where that is as the step begins and ends: loads and
springs on the end, contact on both. Twists play no part.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, crossed, turned_operator
from fenics_rom.mechanics.frame_motion import ZERO
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.steppers.acts.found_slopes import FoundSlopes
from fenics_rom.runtime.steppers.elastic.law import LawAdjoint
from fenics_rom.runtime.steppers.frame_loads import FrameForces, FrameLoads
from fenics_rom.runtime.steppers.frame_slopes import SPIN, Moving, StepTurn
from fenics_rom.runtime.steppers.ground_ties import GroundTies
from fenics_rom.runtime.steppers.held_part import HeldPart
from fenics_rom.runtime.steppers.residual_maps import ResidualMaps
from fenics_rom.runtime.steppers.slopes import Slopes
from fenics_rom.runtime.steppers.touch_adjoint import Touch


class RestingPoints(NamedTuple):
    """The contact points (P, 3), in the axes of the base."""

    start: Array  # y as the step begins
    inside: Array  # û
    forces: Array  # R⁺ᵀ f


class RestingPart(NamedTuple):
    """As in StepPart, with the base's place before the shape."""

    held: HeldPart
    turn: Geometry  # R and R⁺
    end: Moving
    frame: MovingFrame
    loads: FrameLoads
    forces: FrameForces
    ties: GroundTies | None
    points: RestingPoints | None

    @property
    def own(self) -> slice:
        """As in StepPart."""
        return slice(6, None)

    @property
    def shape(self) -> slice:
        """As in StepPart."""
        return slice(6, None)

    @property
    def law(self) -> LawAdjoint:
        """As in StepPart."""
        return self.held.law

    @property
    def found(self) -> FoundSlopes | None:
        """As in StepPart."""
        return self.held.found

    @property
    def residual(self) -> ResidualMaps | None:
        """As in StepPart."""
        return self.held.residual

    @property
    def turned(self) -> Array | None:
        """As in StepPart."""
        return self.held.turned

    @property
    def half(self) -> float:
        """As in StepPart."""
        return self.held.half

    @property
    def by_velocity_before(self) -> None:
        """As in StepPart: nothing."""

    @property
    def by_forces(self) -> Array:
        """As in StepPart: of no forces."""
        return np.zeros((6 + len(self.end.q), 0))

    def back(self, place_: Array, velocity_: Array) -> tuple[Array, Array, Array]:
        """As in StepPart."""
        start_, x_ = place_.copy(), self.held.h * place_
        start_[:6] = x_[:6] = 0.0
        return start_, velocity_, x_

    def balance(self) -> tuple[Slopes, Array]:
        """As in StepPart."""
        slopes, columns = self.held.balance()
        end, there = self.end, StepTurn(Geometry(self.turn.after, self.turn.after, ZERO), self.held.h, np.zeros(3))
        by_base = self.loads.slopes(self.forces, there, self.frame, (end.q, end.q))[0].place[:, :6]
        if self.ties is not None:
            by_base = by_base + self.ties.push_slopes(end, end, there).place[:, :6]
        place, velocity, x = (np.pad(each, ((6, 0), (6, 0))) for each in slopes[:3])
        return Slopes(place, velocity, x, -by_base), np.pad(columns, ((6, 0), (0, 0)))

    def touch(self) -> Touch | None:
        """As in StepPart: points are at p + R y, y = X + S q, and go by ŝ = (p⁺ - p + (R⁺ - R) y)/h + R⁺ û.

        Forces on them act as Sᵀ R⁺ᵀ f.
        """
        if self.held.contact is None or self.points is None:
            return None
        (y, û, f), h, residual = self.points, self.held.h, self.residual
        S, R, R_end, P, k = self.held.Sᵀ.T, self.turn.start, self.turn.end, len(y), 6 + len(self.end.q)
        by_base, units = (R_end - R) / h, np.tile(np.eye(3), (P, 1))
        place, kept, mean = np.zeros((3, 3 * P, k))
        end, seen, of_push = np.zeros((3 * P, 6)), np.zeros((3 * P, 6)), np.zeros((k, 6))
        place[:, :3], place[:, SPIN], place[:, 6:] = units, (R @ crossed(y)).reshape(-1, 3), turned(R, S)
        kept[:, 6:], mean[:, 6:], nothing = place[:, 6:], turned(R_end, S), 0 * mean
        seen[:, SPIN] = -crossed(f).reshape(-1, 3)
        end[:, :3], end[:, SPIN] = units / h, (R_end @ crossed(y / h + û)).reshape(-1, 3)
        of_push[6:] = S.T @ seen
        start = -place / h
        start[:, 6:] = turned(by_base, S)
        yields = by_û = np.zeros((3 * P, 3 * P))
        if residual is not None:
            by_û = turned_operator(R_end, residual.delassus, R_end)
            end += turned(R_end, residual.delassus @ seen)
        still = np.zeros((k, k))
        blocks = [np.broadcast_to(each, (P, 3, 3)) for each in (by_base, R_end, np.zeros((3, 3)), R)]
        return Touch(
            self.held.contact,
            residual,
            R_end,
            R,
            place,
            mean.T,
            (Slopes(start, nothing, mean, end), Slopes(nothing, kept, nothing, 0 * end)),
            (by_û, yields),
            ((blocks[0], blocks[1], blocks[2]), (blocks[2], blocks[2], blocks[3])),
            Slopes(still, still, still, of_push),
            None,
            Slopes(nothing, nothing, nothing, seen),
        )

    def stored(self) -> tuple[Array, Array]:
        """As in StepPart: of springs to the ground, by where the base is."""
        place = np.zeros(6 + len(self.end.q))
        if self.ties is not None:
            place[:6] = self.ties.stored_slopes(self.end, self.turn.end)[:6]
        return place, np.zeros(len(place))


def turned(R: Array, of_points: Array) -> Array:
    """R (3, 3) times what is of points, (3P, k)."""
    of_each: Array = (R @ of_points.reshape(-1, 3, of_points.shape[1])).reshape(of_points.shape)
    return of_each
