"""What one step of a full-order body in a moving frame balances, by iteration.

With means of a step ^, ω⁺, r⁺ = 2 r̂ - r and q⁺ = q + h r̂ at its end, and the rest as in `nodal_frame`,

    [M(r⁺ - r) + ω⁺×M y⁺ - ω×M y]/h + ½ [ω×M r⁺ + ω⁺×M r] + ½ [ω×(ω⁺×M ŷ) + ω⁺×(ω×M ŷ)] + Σ ω_k ω⁺_l K_kl q̂
        + M 1 [Δv/h + ½ (ω×v⁺ + ω⁺×v)] + K q̂ + K (w + t r̂) + D r̂ = f
    free:     ΔL/h + ω̂ × L̂ = R*ᵀ τ, as the angular momentum R L grows by h τ,   R⁺ = R cay(h ω̂),   R* = R (1 + h/2 ω̂~)
    carried:  v⁺, ω⁺ and R⁺ are given

and f, τ with contact's forces on points, Sᵀ R*ᵀ λ and Σ a × λ; w and t are of the branches of a material that relaxes
(`mechanics/viscoelasticity.py`). The iteration has a factor of A = 2/h M + D + (h/2 + t) K, and three rows that couple
turning and bending (`frame_coupling`). So have the sweeps of contact (`frame_step.py`).
"""

import math
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.fem.frame_coupling import NO_COUPLING, Coupling, Mixing
from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.fem.frame_ties import TiedStep, TieForces
from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion, Rate
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, Vector, cayley, cross_matrix, rotation_matrix
from fenics_rom.mechanics.largest_turn import check_turn
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS

TOLERANCE = 1e-15  # of the velocities: what is left of a step's corrections
NO_PROGRESS = 1e-12  # of them: where corrections that shrink no more are round-off
MOST_ITERATIONS = 100
SLOW, RENEWED = 0.3, 8  # corrections that shrink by less ask for the coupling of now, in every so many iterations


class FrameBalance:
    """A step of h s from a motion; its velocities x are ω̂ (3,) of a free body, and r̂ of the nodes here.

    Args:
        body: what is moved.
        now: from where.
        h: s.
        loads: but for contact.
        base: that carries the body, at the end of the step; None of a free body.
    """

    def __init__(self, body: NodalFrame, now: Motion, h: float, loads: FrameLoads, base: BaseState | None):
        self.h, self._body, self._now, self._loads = h, body, now, loads
        body.set_time_step(h)
        self._free, self._base = 3 * (base is None), None  # how many of x turn the frame
        self._ties = None if body.ties is None else TiedStep(body.ties, now, h, body.mass)
        if base is not None:
            R = rotation_matrix(base.rotation)
            self._end, self._v_end, self._ω_end = np.array(base.position), base.velocity @ R, base.angular_velocity @ R
            self._base = Geometry(_rows(now.R), _rows(R), vector(h / 2 * (now.ω + self._ω_end)))

    def solve(self) -> Array:
        """The velocities of the step without contact.

        Raises:
            StepError: it turns too far, or none were found.
        """
        for ω in (self._now.ω, *([] if self._base is None else [self._ω_end])):
            check_turn(self.h, vector(ω))
        x = np.concatenate([self._now.ω[: self._free], self._now.r.ravel()])
        given, size, mixing = self._given_speed(x), np.inf, Mixing(self._inner)
        scale = self._speed(x) + given
        for iteration in range(MOST_ITERATIONS):
            change, before = self.corrected(x, None) - x, size
            size = self.size(change)
            if not np.isfinite(size):
                break
            scale = max(scale, self._speed(x + change) + given)
            if size <= TOLERANCE * scale or (size <= NO_PROGRESS * scale and size > before / 2):
                return x + change
            if self._free and size > SLOW * before and iteration % RENEWED == RENEWED - 1:
                self.renew(x)
                mixing = Mixing(self._inner)
                continue
            x = mixing.next(x, change)
        raise StepError(
            f"no step of {self.h:g} s was found that turns the body by {self.h * np.linalg.norm(self._now.ω):.2g} rad "
            f"and bends it as it does: after {MOST_ITERATIONS} iterations {size / scale:.1e} of the velocities is "
            "left; a smaller dt is the cure"
        )

    def rate(self, x: Array) -> Rate:
        """The mid-step rate of the displacement."""
        return self._body.rate(x[self._free :].reshape(-1, 3))

    def after(self, x: Array, rate: Rate, push: Push | None = None) -> Motion:
        """The body at the end, to the round-off of its momenta whatever x lacks, under contact forces that push."""
        now, h, body = self._now, self.h, self._body
        turn = self.geometry(x)
        after = self._moved(x, rate, turn)
        if self._base is not None:
            return after
        force, torque = self._loads.resultant(body, turn), self._loads.torque(body, turn, now, after)
        if (tied := self.tied(x, turn, ZERO if push is None else push.force)) is not None:
            push = tied.push.beside(push)
        if push is not None:
            force, torque = force + push.force, torque + push.torque
        L = (now.R @ body.momenta(now)[1] + h * torque) @ turn.end
        ω = np.linalg.solve(body.inertia(after), L - body.turned(after))
        v_now = now.R @ now.v
        v = v_now + h / body.mass * force if tied is None else 2 * tied.velocity - v_now
        return after._replace(ω=ω, v=v @ turn.end, position=now.position + h / 2 * (v_now + v))

    def tied(self, x: Array, turn: Geometry, contact: Vector) -> TieForces | None:
        """What springs and dashpots to the ground do at velocities x, under a contact force."""
        r̂ = x[self._free :].reshape(-1, 3)
        if self._ties is None or self._base is not None:
            return None if self._ties is None else self._ties.of_carried(turn, r̂, self._end)
        return self._ties.of_free(turn, x[:3], r̂, self._loads.resultant(self._body, turn) + contact)

    def _lack(self, after: Motion, rate: Rate, turn: Geometry, push: Push | None) -> Array:
        """What the balance of the displacements lacks, (n, 3), N."""
        now, h, body = self._now, self.h, self._body
        ω, ω_end = now.ω, after.ω
        My, My_end = body.mass_times_arms + now.Mq, body.mass_times_arms + after.Mq
        My_mean, Kq = (My + My_end) / 2, (now.Kq + after.Kq) / 2
        ρ = (after.Mr - now.Mr + np.cross(ω_end, My_end) - np.cross(ω, My)) / h + Kq[0] + rate.Dr + body.relaxing(rate)
        ρ += (np.cross(ω, after.Mr) + np.cross(ω_end, now.Mr)) / 2
        ρ += (np.cross(ω, np.cross(ω_end, My_mean)) + np.cross(ω_end, np.cross(ω, My_mean))) / 2
        if len(Kq) > 1:
            pairs = np.outer(ω, ω_end) + np.outer(ω_end, ω)
            i, j = VOIGT_PAIRS.T
            ρ += np.tensordot(np.where(i == j, pairs[i, j] / 2, pairs[i, j]), Kq[1:], 1)
        if self._base is not None:
            Δv = (after.v - now.v) / h + (np.cross(ω, after.v) + np.cross(ω_end, now.v)) / 2
            ρ += body.mass_of_nodes * Δv
        ρ -= self._loads.on_nodes(body, turn)
        return ρ if push is None else ρ - push.modal

    def balances(
        self, turn: Geometry, after: Motion, rate: Rate, push: Push | None, tied: TieForces | None
    ) -> tuple[float, Array | None]:
        """Power supplied, but for contact, W, and the wrench (2, 3) of the base in world axes; None of a free body."""
        now, h, body = self._now, self.h, self._body
        power, v̂, ω̂ = body.dot(self._loads.on_nodes(body, turn), rate.r), (now.v + after.v) / 2, (now.ω + after.ω) / 2
        force, torque = self._loads.resultant(body, turn), self._loads.torque(body, turn, now, after)
        if self._base is None:
            return power + float(force @ (now.R @ now.v + after.R @ after.v) / 2 + torque @ turn.middle @ ω̂), None
        (P, L), (P_end, L_end) = body.momenta(now), body.momenta(after)
        inertial = (P_end - P) / h + np.cross(ω̂, P + P_end) / 2
        turning = (L_end - L) / h + np.cross(ω̂, L + L_end) / 2 + np.cross(v̂, P + P_end) / 2
        power += float(inertial @ v̂ + turning @ ω̂)
        if push is not None:
            force, torque = force + push.force, torque + push.torque
            power -= float(push.force @ turn.middle @ v̂ + push.turning @ ω̂)
        if tied is not None:  # the base does the work that ties do not do on the shape
            force, torque = force + tied.push.force, torque + tied.push.torque
            power += body.dot(tied.push.modal, rate.r) - tied.power
        seen = np.array([inertial - force @ turn.middle, turning - torque @ turn.middle])
        return power, seen @ (turn.start + turn.end).T / 2

    def geometry(self, x: Array) -> Geometry:
        """How the frame turns."""
        if self._base is not None:
            return self._base
        t = self.h * x[:3]
        return Geometry(_rows(self._now.R), _rows(self._now.R @ cayley(t)), vector(t))

    def corrected(self, x: Array, push: Push | None) -> Array:
        """Velocities nearer to those of the step, under contact forces that push."""
        turning, lacks = self._lacks(x, push)
        return x - self._coupling(x).solve(turning, self._body.inverted(lacks.reshape(-1, 1), self.h)[:, 0])

    def _lacks(self, x: Array, push: Push | None) -> tuple[Array, Array]:
        """What the balances of angular momentum, (3,) of a free body, and of the displacements, (n, 3), lack."""
        now, h, body, rate, turn = self._now, self.h, self._body, self.rate(x), self.geometry(x)
        after, tied = self._moved(x, rate, turn), self.tied(x, turn, ZERO if push is None else push.force)
        if tied is not None:
            push = tied.push.beside(push)
        if self._base is not None:
            return np.zeros(0), self._lack(after, rate, turn, push)
        L, L_end = body.turning_momentum(now), body.turning_momentum(after)
        torque = turn.middle.T @ self._loads.torque(body, turn, now, after)
        if push is not None:
            torque = torque + push.turning
        return (L_end - L) / h + np.cross(x[:3], L + L_end) / 2 - torque, self._lack(after, rate, turn, push)

    def _moved(self, x: Array, rate: Rate, turn: Geometry) -> Motion:
        """The body at the end by x alone; of a free one without what the origin does."""
        now, h = self._now, self.h
        fields = (
            2 * rate.r - now.r,
            2 * rate.Mr - now.Mr,
            now.q + h * rate.r,
            now.Mq + h * rate.Mr,
            now.Kq + h * rate.Kr,
        )
        if self._base is not None:
            return Motion(*fields, turn.end, self._end, self._v_end, self._ω_end)
        return Motion(*fields, turn.end, now.position, now.v, 2 * x[:3] - now.ω)

    def renew(self, x: Array) -> None:
        """As in FrameBody of mechanics.frame_contact: how turning and bending drive each other."""
        if self._free:
            self._body.coupling = self._coupled_at(x)

    def _coupling(self, x: Array) -> Coupling:
        """That which is kept, or one that was found at x."""
        if not self._free:
            return NO_COUPLING
        kept = self._body.coupling
        if kept is None or kept.h != self.h:
            self.renew(x)
            kept = self._body.coupling
            assert kept is not None
        return kept

    def _coupled_at(self, x: Array) -> Coupling:
        now, h, body, rate, turn = self._now, self.h, self._body, self.rate(x), self.geometry(x)
        after = self._moved(x, rate, turn)
        ω, ω̂, ω_end = now.ω, x[:3], after.ω
        My, My_end = body.mass_times_arms + now.Mq, body.mass_times_arms + after.Mq
        My_mean = (My + My_end) / 2
        momentum = (body.turning_momentum(now) + body.turning_momentum(after)) / 2
        by_bending, by_turning = np.empty((2, 3, len(My), 3))  # L⁺ by r̂, and the lack of the displacements by ω̂
        for k, e in enumerate(np.identity(3)):
            by_bending[k] = 2 * np.cross(e, My_end) - h * np.cross(e, after.Mr)
            by_bending[k] += h * (np.cross(np.cross(e, My_end), ω_end) + np.cross(np.cross(ω_end, My_end), e))
            by_turning[k] = 2 / h * np.cross(e, My_end) + np.cross(e, now.Mr)
            by_turning[k] += np.cross(ω, np.cross(e, My_mean)) + np.cross(e, np.cross(ω, My_mean))
            if len(now.Kq) > 1:
                rows = 1 + VOIGT_INDEX[k]
                by_bending[k] -= 2 * h * np.tensordot(ω_end, after.Kq[rows], 1)
                by_turning[k] += np.tensordot(ω, now.Kq[rows] + after.Kq[rows], 1)
        carry = np.identity(3) / h + cross_matrix(ω̂) / 2
        J = 2 * carry @ body.inertia(after) - cross_matrix(momentum)
        B, C = (carry @ by_bending.reshape(3, -1)).T, by_turning.reshape(3, -1).T
        if (tied := self.tied(x, turn, ZERO)) is not None and self._ties is not None:
            J, B, C = self._ties.coupled(tied, turn, rate.r, (J, B, C))
        return Coupling.of(body, h, J, B, C)

    def _inner(self, a: Array, b: Array) -> float:
        """Of two velocities, as `size` measures them."""
        turning, r = a[: self._free], a[self._free :].reshape(-1, 3)
        inner = self._body.dot(self._body.inert(r), b[self._free :].reshape(-1, 3))
        return inner + float(turning @ self._inertia @ b[:3]) if len(turning) else inner

    def size(self, change: Array) -> float:
        """Of velocities, as √(2 J)."""
        turning, r = change[: self._free], change[self._free :].reshape(-1, 3)
        squares = self._body.dot(r, self._body.inert(r))
        if len(turning):
            squares += float(turning @ self._inertia @ turning)
        return math.sqrt(abs(squares))

    def _speed(self, x: Array) -> float:
        """Of the velocities of the step at its start and at x, but for translation."""
        return self.size(x) + self._body.speed(self._now)

    def _given_speed(self, x: Array) -> float:
        """Of what enters the balance of a step and may leave nothing of turning and bending but round-off, as √(2 J).

        That is what all forces would do to the body as one mass, each with its size, as weight and loads that balance
        one another cancel; and the base at both ends, as an acceleration is a difference of velocities.
        """
        body, loads, now = self._body, self._loads, self._now
        forces = np.linalg.norm(loads.on_nodes(body, self.geometry(x)), axis=1)
        given = self.h / 2 / math.sqrt(body.mass) * float(body.sum(forces[:, None])[0])
        given += 0.0 if self._ties is None else self._ties.speed
        if self._base is not None:
            given += math.sqrt(body.mass) * float(np.linalg.norm(now.v) + np.linalg.norm(self._v_end))
        return given

    @cached_property
    def _inertia(self) -> Array:
        return self._body.inertia(self._now)


def _rows(R: Array) -> Rotation:
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    return (xx, xy, xz), (yx, yy, yz), (zx, zy, zz)
