"""Slopes of what a step of a body in a moving frame balances, part by part.

A place changes by (δp, δφ, δq): the origin in world axes, a rotation about the frame's axes, R exp(δφ~), and the shape.
A step has velocities (v, ω, r) at its ends, v in world axes, ω in the frame's. It solves for their means
x = (v̂, ω̂, r̂).
It leads to p + h v̂, R cay(h ω̂) and q + h r̂. With t = h ω̂ and n = 1 + |t|²/4 its end changes by

    δφ⁺ = cay(t)ᵀ δφ + (1 - t~/2)/n δt,    δR* = R (δφ~ (1 + t~/2) + δt~/2).

Slopes are matrices with k = 6 + m columns: of the place and of the velocities at the start, and of x. What a part
depends on at the end of a step is told by its tangents there, which `StepTurn` brings back to these.

Of a body that a base carries v is in the frame's axes, too, and where the base ends is given, whatever its twists say:
there are slopes with that besides.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import Geometry, crossed, vector
from fenics_rom.mechanics.frame_motion import cross_matrix
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.inertia import contraction, pairs
from fenics_rom.runtime.steppers.slopes import Slopes

SPIN = slice(3, 6)  # columns of δφ, ω and ω̂


class StepTurn(NamedTuple):
    """How the frame turns in a step of h s with ω̂ (3,)."""

    turn: Geometry
    h: float
    spin: Array
    is_given: bool = False  # by a base: where the frame ends

    @property
    def half(self) -> Array:
        """t~/2 (3, 3)."""
        return self.h / 2 * cross_matrix(self.spin)

    @property
    def along(self) -> Array:
        """δφ⁺ per δφ (3, 3)."""
        along: Array = self.turn.end.T.dot(self.turn.start)
        return along

    @property
    def by_spin(self) -> Array:
        """δφ⁺ per δω̂ (3, 3)."""
        t = self.h * self.spin
        by_spin: Array = self.h / (1 + t.dot(t) / 4) * (np.eye(3) - self.half)
        return by_spin

    def slopes(self, start: Array, end: Array, by_turn: Array | None = None) -> Slopes:
        """Of what has these tangents with the place at the start and at the end, (n, k), and with t (n, 3)."""
        place, x, given = start + end, self.h * end, NONE
        if self.is_given:
            place[:, :6], x[:, :6], given = start[:, :6], 0.0, end[:, :6]
        else:
            place[:, SPIN] = start[:, SPIN] + end[:, SPIN].dot(self.along)
            x[:, SPIN] = end[:, SPIN].dot(self.by_spin)
        if by_turn is not None:
            x[:, SPIN] += self.h * by_turn
        return Slopes(place, np.zeros_like(place), x, given)

    def back(self, place_: Array, velocity_: Array) -> tuple[Array, Array, Array]:
        """Derivatives (k,) with place and velocities at the start, and with x, from those with both at the end."""
        x_, start_ = self.h * place_ + 2 * velocity_, place_.copy()
        if self.is_given:
            x_[:6], start_[:6] = 2 * velocity_[:6], 0.0
            return start_, -velocity_, x_
        x_[SPIN] = self.by_spin.T.dot(place_[SPIN]) + 2 * velocity_[SPIN]
        start_[SPIN] = self.along.T.dot(place_[SPIN])
        return start_, -velocity_, x_


class Moving(NamedTuple):
    """A body at one end of a step."""

    position: Array  # p (3,)
    v: Array  # of the origin, in world axes; of a base in the frame's
    ω: Array
    q: Array
    r: Array


class InertiaSlopes(NamedTuple):
    """What a body's inertia has to do with a balance, of the frame of a contact mode."""

    frame: MovingFrame
    second: Array  # I2 (6, m, m), what stiffens included

    def _at(self, at: Moving) -> tuple[Array, Array, Array, Array, Array]:
        """I (3, 3), b (3, m), and ∂L/∂q, ∂s/∂q; L."""
        frame, second = self.frame, self.second
        grown = second @ at.q
        inertia = (frame.inertia0 + (frame.inertia1 + grown) @ at.q)[VOIGT_INDEX]
        b = frame.coupling0 + frame.coupling @ at.q
        by_shape = contraction(1.0, vector(at.ω)) @ (frame.inertia1 + 2 * grown) - frame.coupling @ at.r
        return inertia, b, by_shape, np.tensordot(at.ω, frame.coupling, 1), inertia @ at.ω + b @ at.r

    def balance(self, before: Moving, after: Moving, step: StepTurn) -> Slopes:
        """Slopes of the rates of momentum, ΔL/h + ω̂ × L̂ and what the coordinates balance, but for elasticity."""
        frame, second, h, mass, c = self.frame, self.second, step.h, self.frame.mass, self.frame.moment_modes
        G, ω, ω_end = frame.coupling, before.ω, after.ω
        k = 6 + len(before.q)
        places, rates = np.zeros((2, k, k)), np.zeros((2, k, k))
        spun = np.tensordot(pairs(vector(ω), vector(ω_end)), second, 1) / 2
        bent = frame.inertia1 + second @ (before.q + after.q)
        ends = ((before, after, -1.0), (after, before, 1.0))
        momenta = [self._at(at) for at, _, _ in ends]
        twist = -cross_matrix((momenta[0][4] + momenta[1][4]) / 4)
        for place, rate, (_, other, sign), (inertia, b, by_shape, spin, _) in zip(
            places, rates, ends, momenta, strict=True
        ):
            carry = sign / h * np.eye(3) + step.half / h
            place[SPIN, 6:] = carry @ by_shape
            place[6:, 6:] = sign / h * spin - spun
            rate[:3, :3] = sign / h * mass * np.eye(3)
            rate[SPIN, SPIN], rate[SPIN, 6:] = carry @ inertia + twist, carry @ b
            rate[6:, :3] = c.T @ (sign / h * np.eye(3) + cross_matrix(other.ω) / 2)
            rate[6:, SPIN] = (sign / h * b + (G @ other.r - contraction(1.0, vector(other.ω)) @ bent) / 2).T
            rate[6:, SPIN] -= c.T @ cross_matrix(other.v) / 2
            rate[6:, 6:] = sign / h * np.eye(k - 6) + np.tensordot(other.ω, G, 1) / 2
        slopes = step.slopes(*places)
        return slopes._replace(velocity=rates[0] - rates[1], x=slopes.x + 2 * rates[1])

    def stored(self, at: Moving) -> tuple[Array, Array]:
        """Slopes of the kinetic energy with place and velocities, (k,) each."""
        frame, (_, b, by_shape, _, L) = self.frame, self._at(at)
        place, half = (
            np.zeros(6 + len(at.q)),
            contraction(0.5, vector(at.ω)) @ (frame.inertia1 + 2 * self.second @ at.q),
        )
        c, moment = frame.moment_modes, frame.first_moment + frame.moment_modes @ at.q
        place[6:] = at.ω @ (by_shape - half) + np.cross(at.v, at.ω) @ c
        P, L = frame.mass * at.v + np.cross(at.ω, moment) + c @ at.r, L + np.cross(moment, at.v)
        return place, np.concatenate([P, L, at.r + at.ω @ b + at.v @ c])


class PointsMoved(NamedTuple):
    """Points at y in the frame as a step begins, which go by h û in it, and what forces on them do."""

    step: StepTurn
    rows: Array  # Vᵀ (m, 3P)
    start: Array  # y (P, 3)
    inside: Array  # û (P, 3)

    @property
    def _arms(self) -> Array:
        turn, end = self.step.turn, self.start + self.step.h * self.inside
        arms: Array = (self.start.dot(turn.start.T) + end.dot(turn.end.T)) / 2
        return arms

    def _of_arms(self) -> tuple[Array, Array, Array]:
        """∂a (P, 3, 3) with δφ, δφ⁺ and (3, 3) with y; with û it is h/2 R⁺."""
        turn, h = self.step.turn, self.step.h
        by_start, by_end = turn.start @ crossed(self.start) / 2, turn.end @ crossed(self.start + h * self.inside) / 2
        return by_start, by_end, (turn.start + turn.end) / 2

    def velocity(self, spin: Array, inside: Array) -> tuple[Array, ...]:
        """Of (R* ω) × a + R* u with ω (3,) and u (P, 3): ∂ with δφ, δφ⁺, t, y, û, ω and u, (P, 3, 3) each."""
        turn, whole = self.step.turn, np.eye(3) + self.step.half
        R, middle, twisted = turn.start, turn.middle, -crossed(self._arms)
        by_start, by_end, by_place = self._of_arms()
        Ω = cross_matrix(middle @ spin)
        every = np.broadcast_to
        return (
            twisted @ R @ cross_matrix(whole @ spin) + Ω @ by_start + R @ crossed(inside @ whole.T),
            Ω @ by_end,
            (twisted @ R @ cross_matrix(spin) + R @ crossed(inside)) / 2,
            every(Ω @ by_place, twisted.shape),
            every(self.step.h / 2 * Ω @ turn.end, twisted.shape),
            -twisted @ middle,
            every(middle, twisted.shape),
        )

    def joined(self, blocks: tuple[Array, ...], v: Array, *, is_mean: bool) -> "PointSlopes":
        """Slopes (3P, k) of velocities from `velocity`, and v (3,) of the origin, which a base has in the frame's axes.

        `is_mean`: of v̂, ω̂ and û, else of those at the start.
        """
        by_start, by_end, by_turn, by_y, by_û, by_ω, by_u = blocks
        along = np.eye(3)
        if self.step.is_given:  # R* v
            along, R = self.step.turn.middle, self.step.turn.start
            by_start = by_start - R @ cross_matrix(v + self.step.half @ v)
            by_turn = by_turn - R @ cross_matrix(v) / 2
        start, end = self._columns(by_start, by_y), self._columns(by_end)
        slopes = self.step.slopes(start, end, by_turn.reshape(-1, 3))
        own = slopes.x if is_mean else slopes.velocity
        slopes.x[:, 6:] += self._shaped(by_û)
        own[:, :3] += np.tile(along, (len(self.start), 1))
        own[:, SPIN] += by_ω.reshape(-1, 3)
        own[:, 6:] += self._shaped(by_u)
        return PointSlopes(slopes, by_y, by_û + by_u, 0 * by_u) if is_mean else PointSlopes(slopes, by_y, by_û, by_u)

    def middle(self) -> "PointSlopes":
        """Slopes (3P, k) of where the points are in the middle of the step, from the origin."""
        by_start, by_end, by_y = self._of_arms()
        by_û = self.step.h / 2 * self.step.turn.end
        start, end = self._columns(by_start, np.broadcast_to(by_y, by_start.shape)), self._columns(by_end)
        slopes = self.step.slopes(start, end, np.zeros((len(start), 3)))
        slopes.x[:, 6:] += self._shaped(np.broadcast_to(by_û, by_start.shape))
        every = [np.broadcast_to(each, by_start.shape) for each in (by_y, by_û, np.zeros((3, 3)))]
        return PointSlopes(slopes, *every)

    def displacement(self) -> Array:
        """Slopes (3P, k) of the points' displacement at the start with the place."""
        R, P = self.step.turn.start, len(self.start)
        by_place = self._columns(R @ crossed(self.start), np.broadcast_to(R, (P, 3, 3)))
        by_place[:, :3] = np.tile(np.eye(3), (P, 1))
        return by_place

    def seen(self, forces: Array) -> Slopes:
        """Slopes (3P, k) of R*ᵀ f of forces (P, 3) that stay."""
        turn, half = self.step.turn, self.step.half
        there = -crossed(forces.dot(turn.start))
        nothing = np.zeros((3 * len(forces), 6 + len(self.rows)))
        start = self._columns((np.eye(3) - half) @ there)
        return self.step.slopes(start, nothing, there.reshape(-1, 3) / 2)

    def push(self, forces: Array) -> "PushSlopes":
        """Slopes of force, R*ᵀ torque and modal forces (k,) of forces (P, 3) that stay."""
        turn, half, k = self.step.turn, self.step.half, 6 + len(self.rows)
        back, arms, twisted = turn.middle.T, self._arms, crossed(forces)
        by_start, by_end, by_place = self._of_arms()
        there = cross_matrix(np.cross(arms, forces).sum(axis=0).dot(turn.start))
        start, end, by_turn = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, 3))
        start[SPIN, SPIN] = (np.eye(3) - half) @ there + back @ (twisted @ by_start).sum(axis=0)
        end[SPIN, SPIN] = back @ (twisted @ by_end).sum(axis=0)
        by_turn[SPIN] = there / 2
        turned, through = back @ twisted @ by_place, self.step.h / 2 * back @ twisted @ turn.end
        start[SPIN, 6:] = _summed(turned).dot(self.rows.T)
        seen = self.seen(forces)
        slopes = self.step.slopes(start, end, by_turn)
        slopes.x[SPIN, 6:] = _summed(through).dot(self.rows.T)
        slopes.place[6:] += self.rows.dot(seen.place)
        slopes.x[6:] += self.rows.dot(seen.x)
        return PushSlopes(slopes, self.by_forces(), _padded(_summed(turned), k), _padded(_summed(through), k))

    def by_forces(self) -> Array:
        """(k, 3P): the same per force."""
        turn, P, k = self.step.turn, len(self.start), 6 + len(self.rows)
        by_forces = np.empty((k, 3 * P))
        by_forces[:3] = np.tile(np.eye(3), P)
        by_forces[SPIN] = _summed(-turn.middle.T @ crossed(self._arms))
        by_forces[6:] = self.rows.reshape(-1, P, 3).dot(turn.middle.T).reshape(-1, 3 * P)
        return by_forces

    def _columns(self, by_spin: Array, by_y: Array | None = None) -> Array:
        """(3P, k) of slopes (P, 3, 3) with a rotation, and with y by the shape."""
        columns = np.zeros((3 * len(self.start), 6 + len(self.rows)))
        columns[:, SPIN] = by_spin.reshape(-1, 3)
        if by_y is not None:
            columns[:, 6:] = self._shaped(by_y)
        return columns

    def _shaped(self, by_y: Array) -> Array:
        """(3P, m) of slopes (P, 3, 3) with y."""
        shaped: Array = (by_y @ self.rows.T.reshape(len(self.start), 3, -1)).reshape(-1, len(self.rows))
        return shaped


class PointSlopes(NamedTuple):
    """Of velocities of points (P, 3), and what they change by with what points do beyond the basis, (P, 3, 3) each."""

    slopes: Slopes
    by_place: Array  # y
    by_mean: Array  # û
    by_start: Array  # u at the start


class PushSlopes(NamedTuple):
    """Of what forces on points do (k,)."""

    slopes: Slopes
    by_forces: Array  # (k, 3P)
    by_place: Array  # y, (k, 3P)
    by_mean: Array  # û, (k, 3P)


def _summed(blocks: Array) -> Array:
    """(3, 3P) of (P, 3, 3): what all points do together."""
    summed: Array = np.ascontiguousarray(blocks.transpose(1, 0, 2)).reshape(3, -1)
    return summed


def _padded(turning: Array, k: int) -> Array:
    """(k, n) of what turns the frame alone, (3, n)."""
    padded = np.zeros((k, turning.shape[1]))
    padded[SPIN] = turning
    return padded
