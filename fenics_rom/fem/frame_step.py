"""One step of a full-order body in a moving frame, by iteration, with what touches it.

With means of a step ^, ω⁺, r⁺ = 2 r̂ - r and q⁺ = q + h r̂ at its end, and the rest as in `nodal_frame`,

    [M(r⁺ - r) + ω⁺×M y⁺ - ω×M y]/h + ½ [ω×M r⁺ + ω⁺×M r] + ½ [ω×(ω⁺×M ŷ) + ω⁺×(ω×M ŷ)] + Σ ω_k ω⁺_l K_kl q̂
        + M 1 [Δv/h + ½ (ω×v⁺ + ω⁺×v)] + K q̂ + D r̂ = f
    free:     ΔL/h + ω̂ × L̂ = R*ᵀ τ, as the angular momentum R L grows by h τ,   R⁺ = R cay(h ω̂),   R* = R (1 + h/2 ω̂~)
    carried:  v⁺, ω⁺ and R⁺ are given

and f, τ with contact's forces on points, Sᵀ R*ᵀ λ and Σ a × λ. The iteration has a factor of A = 2/h M + D + h/2 K, and
of the rotation I alone, so that it takes the longer the more the body turns in a step. So have the sweeps of contact
(`mechanics/frame_contact.py`), which W only guides: S A⁻¹ Sᵀ, turned, and that of a rigid body which is free.
"""

import math
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.fem.full_order_body import FullOrderInterface
from fenics_rom.fem.nodal_frame import Motion, NodalFrame, Rate
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_geometry import (
    Geometry,
    Push,
    arms_of,
    carried_along,
    turned_operator,
    turning_maps,
    vector,
)
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, Vector, cayley, rotation_matrix
from fenics_rom.mechanics.hyperelastic import VOIGT_PAIRS

TOLERANCE = 1e-15  # of the velocities: what is left of a step's corrections
NO_PROGRESS = 1e-12  # of them: where corrections that shrink no more are round-off
MOST_ITERATIONS = 100


class FrameStep:
    """A step of h s from a motion; its velocities x are ω̂ (3,) of a free body, and r̂ of the nodes here.

    Args:
        body: what is moved.
        now: from where.
        h: s.
        loads: but for contact.
        base: that carries the body, at the end of the step; None of a free body.
        interface: the contact points; None where nothing can touch.

    Attributes:
        tells_apart: see mechanics.frame_contact.FrameBody.
    """

    tells_apart, no_progress = True, NO_PROGRESS

    def __init__(
        self,
        body: NodalFrame,
        now: Motion,
        h: float,
        loads: FrameLoads,
        base: BaseState | None,
        interface: FullOrderInterface | None = None,
    ):
        self.h, self._body, self._now, self._loads, self._interface = h, body, now, loads, interface
        self._free, self._base = 3 * (base is None), None  # how many of x turn the frame
        if base is not None:
            R = rotation_matrix(base.rotation)
            self._end, self._v_end, self._ω_end = np.array(base.position), base.velocity @ R, base.angular_velocity @ R
            self._base = Geometry(_rows(now.R), _rows(R), vector(h / 2 * (now.ω + self._ω_end)))

    def solve(self) -> Array:
        """The velocities of the step without contact.

        Raises:
            StepError: none were found.
        """
        x, size = np.concatenate([self._now.ω[: self._free], self._now.r.ravel()]), np.inf
        given = self._given_speed(x)
        scale = self._speed(x) + given
        for _ in range(MOST_ITERATIONS):
            change = self.corrected(x, None) - x
            x, before, size = x + change, size, self.size(change)
            if not np.isfinite(size):
                break
            scale = max(scale, self._speed(x) + given)
            if size <= TOLERANCE * scale or (size <= NO_PROGRESS * scale and size > before / 2):
                return x
        raise StepError(
            f"no step of {self.h:g} s was found that turns the body by {self.h * np.linalg.norm(self._now.ω):.2g} rad "
            "and bends it as it does; a smaller dt is the cure"
        )

    def rate(self, x: Array) -> Rate:
        """The mid-step rate of the displacement."""
        return self._body.rate(x[self._free :].reshape(-1, 3))

    def after(self, x: Array, rate: Rate, push: Push | None = None) -> Motion:
        """The body at the end, to the round-off of its momenta whatever x lacks, under contact forces that push."""
        now, h, body = self._now, self.h, self._body
        turn = self.geometry(x)
        fields = (
            2 * rate.r - now.r,
            2 * rate.Mr - now.Mr,
            now.q + h * rate.r,
            now.Mq + h * rate.Mr,
            now.Kq + h * rate.Kr,
        )
        if self._base is not None:
            return Motion(*fields, turn.end, self._end, self._v_end, self._ω_end)
        after = Motion(*fields, turn.end, now.position, now.v, now.ω)
        force, torque = self._loads.resultant(body, turn), self._loads.torque(body, turn, now, after)
        if push is not None:
            force, torque = force + push.force, torque + push.torque
        L = (now.R @ body.momenta(now)[1] + h * torque) @ turn.end
        ω = np.linalg.solve(body.inertia(after), L - body.turned(after))
        v_now = now.R @ now.v
        v = v_now + h / body.mass * force
        return after._replace(ω=ω, v=v @ turn.end, position=now.position + h / 2 * (v_now + v))

    def _lack(self, after: Motion, rate: Rate, turn: Geometry, push: Push | None) -> Array:
        """What the balance of the displacements lacks, (n, 3), N."""
        now, h, body = self._now, self.h, self._body
        ω, ω_end = now.ω, after.ω
        My, My_end = body.mass_times_arms + now.Mq, body.mass_times_arms + after.Mq
        My_mean, Kq = (My + My_end) / 2, (now.Kq + after.Kq) / 2
        ρ = (after.Mr - now.Mr + np.cross(ω_end, My_end) - np.cross(ω, My)) / h + Kq[0] + rate.Dr
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

    def balances(self, turn: Geometry, after: Motion, rate: Rate, push: Push | None) -> tuple[float, Array | None]:
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
        seen = np.array([inertial - force @ turn.middle, turning - torque @ turn.middle])
        return power, seen @ (turn.start + turn.end).T / 2

    # What contact asks for; see mechanics.frame_contact.

    def geometry(self, x: Array) -> Geometry:
        """How the frame turns."""
        if self._base is not None:
            return self._base
        t = self.h * x[:3]
        return Geometry(_rows(self._now.R), _rows(self._now.R @ cayley(t)), vector(t))

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (rows here,)."""
        if self._base is not None:
            return np.array(self._base.turn) / self.h, x
        return x[:3], x[3:]

    def corrected(self, x: Array, push: Push | None) -> Array:
        """Velocities nearer to those of the step, under contact forces that push."""
        rate = self.rate(x)
        after = self.after(x, rate, push)
        lacks = self._lack(after, rate, self.geometry(x), push).reshape(-1, 1)
        δ = self._body.inverted(lacks, self.h)[:, 0]
        turning = (self._now.ω + after.ω)[: self._free] / 2
        return np.concatenate([turning, x[self._free :] - δ])

    def renew(self, x: Array) -> None:
        """As in FrameBody of mechanics.frame_contact: there is one factor, that of the body at rest."""

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""
        turning = np.zeros(0) if self._base is not None else self._top @ np.array(change.turning)
        return np.concatenate([turning, self._body.inverted(change.modal.reshape(-1, 1), self.h)[:, 0]])

    def size(self, change: Array) -> float:
        """Of velocities, as √(2 J)."""
        turning, r = change[: self._free], change[self._free :].reshape(-1, 3)
        squares = self._body.dot(r, self._body.inert(r))
        if len(turning):
            squares += float(turning @ self._inertia @ turning)
        return math.sqrt(abs(squares))

    def scale(self, x: Array) -> float:
        """As in FrameBody of mechanics.frame_contact."""
        return self._speed(x) + math.sqrt(self._body.mass) * math.hypot(*self.translation(self.geometry(x), ZERO, x))

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
        if self._base is not None:
            given += math.sqrt(body.mass) * float(np.linalg.norm(now.v) + np.linalg.norm(self._v_end))
        return given

    def push(self, forces: Array, turn: Geometry, arms: Array) -> Push:
        """What forces (P, 3) on the contact points do, N in world axes."""
        interface = self._touched
        return Push.of(forces, turn, arms, lambda inside: (interface.Sᵀ @ inside.ravel()).reshape(-1, 3))

    def yielding(self, turn: Geometry, contact: ContactSolution | None) -> None:
        """Nothing: points go with their nodes."""

    def arms(self, turn: Geometry, rate: Array, yielding: Array | None = None) -> Array:
        """Of the contact points from the origin in the middle of a step, (P, 3), m."""
        moved = self._touched.at_points(rate.reshape(-1, 1))
        return arms_of(turn, self._places, self._places + self.h * moved)

    def velocities(self, turn: Geometry, arms: Array, x: Array, yielding: Array | None = None) -> Array:
        """Mid-step velocities (P, 3) of the contact points in world axes, less that of the origin, m/s."""
        ω̂, r̂ = self.rates(x)
        return carried_along(turn, arms, ω̂, self._touched.at_points(r̂.reshape(-1, 1)))

    def kept_velocities(self, turn: Geometry, arms: Array) -> Array:
        """Velocities (P, 3) of the contact points in world axes, m/s, by those of the body at the start of the step."""
        now = self._now
        inside = self._touched.at_points(now.r.reshape(-1, 1))
        along = (turn.start if self._base is None else turn.middle) @ now.v
        velocities: Array = carried_along(turn, arms, now.ω, inside) + along
        return velocities

    def translation(self, turn: Geometry, contact: Vector, x: Array) -> Array:
        """As in FrameBody of mechanics.frame_contact."""
        now, body = self._now, self._body
        if self._base is not None:
            along: Array = turn.middle @ (now.v + self._v_end) / 2
            return along
        force: Array = self._loads.resultant(body, turn) + contact
        return turn.start @ now.v + self.h / 2 / body.mass * force

    def delassus(self, near: Array, turn: Geometry, arms: Array) -> Array:
        """Mid-step velocities (3 s, 3 s) of those points (s,), at arms (s, 3), per force, m/s/N."""
        rows = (3 * near[:, None] + np.arange(3)).ravel()
        W = turned_operator(turn.middle, self._inside[rows[:, None], rows], turn.middle)
        if self._base is None:
            maps = turning_maps(turn, arms)
            W += maps @ self._top @ maps.T
            for k in range(3):
                W[k::3, k::3] += self.h / 2 / self._body.mass
        return W

    def point_displacement(self) -> Array:
        """Of the contact points, (P, 3), m."""
        return self._now.position + self._places @ self._now.R.T - self._touched.points.coordinates

    @cached_property
    def _inertia(self) -> Array:
        return self._body.inertia(self._now)

    @cached_property
    def _top(self) -> Array:
        """ω̂ (3, 3) per torque as the frame sees it, of a body that does not bend."""
        top: Array = np.linalg.inv(2 / self.h * self._inertia)
        return top

    @cached_property
    def _places(self) -> Array:
        """Of the contact points in the frame, (P, 3), m."""
        rest = self._touched.points.coordinates - self._body.frame.origin
        places: Array = rest + self._touched.at_points(self._now.q.reshape(-1, 1))
        return places

    @property
    def _inside(self) -> Array:
        """S A⁻¹ Sᵀ (3 P, 3 P)."""
        return self._body.compliance(self.h, self._touched)

    @property
    def _touched(self) -> FullOrderInterface:
        assert self._interface is not None
        return self._interface


def _rows(R: Array) -> Rotation:
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    return (xx, xy, xz), (yx, yy, yz), (zx, zy, zz)
