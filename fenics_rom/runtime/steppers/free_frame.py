"""The step of a free body, turned as far as it likes.

State: position and velocity of the centre of mass, attitude R, angular momentum ℓ in world axes, shape q, its rate r.
With the mid-step ω̂ and r̂, ω⁺ = 2 ω̂ - ω, r⁺ = 2 r̂ - r, q̂ = q + h/2 r̂, R⁺ = R cay(h ω̂) and L, s of `frame_kernel`:

    ΔL/h + ω̂ × L̂ = R*ᵀ τ,    i.e.  ℓ⁺ = ℓ + h τ
    Δs/h + ½ Σ_k (ω_k G_k r⁺ + ω⁺_k G_k r) - ½ Σ_kl ω_k ω⁺_l (I1_kl + 2 I2_kl q̂) + γ q̂ + D r̂ = f

Two identities make it exact at any h, for any symmetric I2 and antisymmetric G:

    Δ(½ ω·I ω) = ω̂·Δ(I ω) - ½ ω·(ΔI) ω⁺
    Δ(ω·b r) = ω̂·Δ(b r) + r̂·Δ(bᵀω) + ½ Δqᵀ Σ_k (ω_k G_k r⁺ + ω⁺_k G_k r)

so that energy grows by h (F·p'^ + τ·R ω̂ + f·r̂) - h r̂ᵀ D r̂ and momenta by nothing but F and τ. After the iteration ω⁺ is
what the angular momentum says, which no tolerance is in. Springs and dashpots to the ground are forces, too, but with
v̂ among what they depend on (`ground_ties`).
"""

import math
from collections.abc import Callable
from functools import partial
from struct import Struct
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.frame_contact import touch
from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import ZERO, Quaternion, Vector, added, cross, dot, mean, rotation_of
from fenics_rom.runtime.steppers.frame_kernel import (
    BENT,
    BENT_BY_RATE,
    GIVEN,
    TURNED,
    TURNED_BY_RATE,
    FrameState,
    Shape,
    check_turn,
    in_frame,
)
from fenics_rom.runtime.steppers.frame_points import FramePoints
from fenics_rom.runtime.steppers.free_motion import FreeMotion, turn_of
from fenics_rom.runtime.steppers.ground_ties import TieForces
from fenics_rom.runtime.steppers.inertia import (
    MOST_ITERATIONS,
    Inertia,
    contraction,
    definite_up_to,
    pairs,
    times_inertia,
    turn_of_top,
)
from fenics_rom.runtime.steppers.kept_newton import KeptNewton


class FreeFrame(FreeMotion):
    """Arguments and attributes as in FrameKernel; `frame.turning` is the angular momentum."""

    def __init__(self, *args: Any, **named: Any):
        super().__init__(*args, **named)
        m = self._model.order
        self._sum = self._table[GIVEN:]  # what the balance of a free body is a sum of
        self._gained = self._table[TURNED.start : BENT_BY_RATE.stop]
        self._factors = np.empty(len(self._sum))
        self._set_factors = partial(Struct(f"{len(self._sum)}d").pack_into, self._factors.data, 0)
        self._weights = np.ones(3 + m)  # in which corrections are measured, as energies are
        self._weights[:3] = sum(self._inertia0[:3]) / 3
        frame, ω = self._constants, self._ω
        parts = frame.inertia1 / ω, self._second / ω / ω[:, None], frame.coupling / ω
        self._surely_definite = definite_up_to(frame.inertia0, *parts)
        self.newton = KeptNewton()
        self._lever: Array | None = None  # of ties, per force, as contact was told last
        self._ahead: tuple[Array, Array] | None = None  # of an expected step the slope of f̂, and the inverse Jacobian
        self._modal = np.empty(0)  # forces on the coordinates (m,) in the step
        self._forces = self._loads.at(np.zeros(self._loads.width))  # of the step
        self._passed: tuple[float, Array] | None = None  # the last step: of h s, by ω̂ and r̂
        self.resume(np.empty(0))

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self.newton.inverse = self._ahead = None

    def reset_buffer(self) -> None:
        """As in Kernel."""
        super().reset_buffer()
        self.forget()

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self._now = self._now_before
        self.forget()

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel; the angular velocity is what the angular momentum says."""
        super().resume(auxiliary)
        q, shape, R = self._coordinates().copy(), self.forget(), rotation_of(*self.frame.rotation)
        self._now = self._now_before = self._moving(q, shape, R, self.frame.turning, self._e)
        if self.ties is not None:
            self.ties.place(self.frame.position, R, q)

    def forget(self) -> Shape:
        """Forgets what was kept of steps that led elsewhere; the shape that the body has."""
        self.newton.inverse = self._passed = self._ahead = None
        self._square = self._twice_within()
        return self._shape_at(self._coordinates(), self._r)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        x, contact, push, power = self.begin_step(u), None, None, 0.0
        try:
            x = self.iterate(x)
            if self.found is not None or (self._interface is not None and obstacles is not None):
                x, contact = touch(self, self._interface, x, obstacles, None if self.found is None else self)
            if contact is not None:
                push, power = self._pushed_by(contact, x)
            return self.end_step(x, contact, push, power)
        except StepError:
            self.forget()
            raise

    def begin_step(self, u: Array) -> Array:
        """Expected mid-step velocities ω̂, r̂ (3 + m,) of a step under u."""
        check_turn(self.h, self._now.ω)
        self._forces = self._begin(u)
        h, x = self.h, np.empty(len(self._weights))
        x[:3], x[3:] = self._now.ω, self._r
        if self._passed is not None and h <= 2 * self._passed[0]:  # else it says too little of this step
            x += (h / self._passed[0]) * (x - self._passed[1])
        if self.elastic is None:
            self._give(self._forces.modal)
        else:
            self._expect(x)
        return x

    def _expect(self, x: Array) -> None:
        """Takes a step of Newton's method from the velocities x, where what resists the shape is to be expected."""
        elastic, r̂ = self.elastic, x[3:]
        assert elastic is not None
        if elastic.is_exact:
            r̂[:] = elastic.velocity
        self._take_slope(r̂)
        if not elastic.is_exact:
            return
        self._given(r̂, r̂)
        push = None
        if self.contact is not None:  # what touched in the step before touches
            turn = self.geometry(x)
            push = self.push(self.contact.forces, turn, self.arms(turn, r̂, None))
        ρ = self._residual(x, push)
        if self._ahead is None or self._ahead[0] is not self._matrix:
            try:
                self._ahead = self._matrix, np.linalg.inv(self.jacobian(x))
            except np.linalg.LinAlgError:
                self._ahead = self._matrix, np.zeros((len(x), len(x)))
        x -= self._ahead[1].dot(ρ)
        elastic.expect(r̂)
        self._take_slope(r̂)
        self._given(r̂, r̂.copy())

    def _take_slope(self, v: Array) -> None:
        self._take_matrix(v)
        np.add(self._inert, self._matrix, self._products[9])

    def _given(self, v: Array, at: Array) -> None:
        """Makes what of the balance is there at no rate exact at v, of loads that follow as they do at another."""
        self._modal, self._followed_at = self._forces.modal - self._resists(v, at), at
        self._give(self._modal)

    def act(self, z: Array) -> None:
        """As in FrameBody of mechanics.frame_contact."""
        assert self.found is not None
        self._acting, self._reactions_found = self.found.acting(z), z
        self._forces = self._forces_as_expected()
        if self.elastic is None:
            self._give(self._forces.modal)
        elif self.elastic.is_exact:
            self._given(self._followed_at, self._followed_at)

    def iterate(self, x: Array, push_at: Callable[[Array], Push] | None = None, forces: float = 0.0) -> Array:
        """The mid-step velocities of the step, near x, which is overwritten.

        Args:
            x: ω̂, r̂ (3 + m,).
            push_at: what forces on points do at such velocities; None: there are none.
            forces: the sum of their sizes, N: of what they move, round-off may be.
        """
        alone = self._interface is None and self.found is None and (self.elastic is None or self.elastic.is_exact)
        if alone and self.ties is None and not self._couples and self._forces.at_points is None:
            return self._as_a_top(x)
        left = self.newton.solve(
            x,
            lambda x: self._residual(x, None if push_at is None else push_at(x)),
            lambda x: self.jacobian(x, None if push_at is None or self.ties is None else push_at(x)),
            self.size,
            self._speed if push_at is None else lambda x: self.scale(x) + self.h / 2 * forces / math.sqrt(self._mass),
        )
        if left:
            raise self._unsolved(left)
        return x

    def _as_a_top(self, x: Array) -> Array:
        """The same into x, near it, where shape and rotation leave each other alone."""
        now, given, r̂ = self._now, self._table[GIVEN], x[3:]
        r̂[:] = np.linalg.solve(self._products[-1], -given) if self._is_dense else given / -self._diagonal
        torque = self._torque(r̂)
        x[:3], left = turn_of_top(now.shape.inertia, now.L, torque, now.ω, vector(x[:3]), self.h)
        if left:
            raise self._unsolved(left)
        return x

    def _unsolved(self, left: float) -> StepError:
        rest = f"after {MOST_ITERATIONS} iterations {left:.1e} of the velocities is left"
        return StepError(
            f"no step of {self.h:g} s was found that turns the body by {self.h * math.hypot(*self._now.ω):.2g} rad and "
            f"bends it as it does: {rest if math.isfinite(left) else 'iterations diverge'}; a smaller dt is the cure"
        )

    def _torque(self, r̂: Array) -> Vector:
        """Of forces that turn with the frame."""
        if self._forces.torque_by_shape is None:
            return self._forces.torque
        return added(self._forces.torque, 1.0, vector(self._forces.torque_by_shape.dot(self._now.q + self.h / 2 * r̂)))

    def size(self, change: Array) -> float:
        """Of velocities, as √(2 J)."""
        return math.sqrt(change.dot(self._weights * change))

    def scale(self, x: Array) -> float:
        """As in FrameBody of mechanics.frame_contact."""
        return self._speed(x) + math.sqrt(self._mass) * math.hypot(*self.translation(self.geometry(x), ZERO, x))

    def _speed(self, x: Array) -> float:
        """Of the velocities of the step at its start and at x, but for translation."""
        ω = self._now.ω
        speed = self.size(x) + (self._weights[0] * dot(ω, ω) + float(self._r.dot(self._r))) ** 0.5
        return speed if self.ties is None else speed + self.ties.speed(self._mass)

    def _residual(self, x: Array, push: Push | None) -> Array:
        """What the balances of angular momentum and of the coordinates lack, under contact forces that push."""
        h, now, r̂ = self.h, self._now, x[3:]
        if self.elastic is not None and not self.elastic.is_exact:
            self._given(r̂, r̂)
        a, b, c = ω̂ = vector(x[:3])
        (A, B, C), L = now.ω, now.L
        ω_end = 2 * a - A, 2 * b - B, 2 * c - C
        xx, yy, zz, yz, xz, xy = pairs(now.ω, ω_end)
        self._move(r̂)
        self._set_factors(
            *(1.0, 2 / h * (a - A), 2 / h * (b - B), 2 / h * (c - C)),  # f0, T
            *(-xx, -yy, -zz, -yz, -xz, -xy, 2 * a, 2 * b, 2 * c, 1.0),  # S, G r̂, and what r̂ itself is held by
        )
        ρ = np.empty(len(x))
        along = self._factors.dot(self._sum, ρ[3:])
        _, L_end = self._inertia_and_momentum(r̂, ω_end)
        t = self._torque(r̂)
        if push is not None or self._forces.at_points is not None or self.ties is not None:
            turn = self.turn_at(x)[0]
            tied = self._tied(turn, x, ZERO if push is None else push.force)
            for each in (push, self._prescribed(self._forces, turn, now.q, r̂, h), tied and tied.push()):
                if each is not None:
                    t = added(t, 1.0, each.turning)
                    along -= each.modal
        x_, y_, z_ = cross(ω̂, added(L, 1.0, L_end))
        ρ[0] = (L_end[0] - L[0]) / h + x_ / 2 - t[0]
        ρ[1] = (L_end[1] - L[1]) / h + y_ / 2 - t[1]
        ρ[2] = (L_end[2] - L[2]) / h + z_ / 2 - t[2]
        return ρ

    def _tied(self, turn: Geometry, x: Array, contact: Vector) -> TieForces | None:
        """What springs and dashpots to the ground do at the velocities x, under a contact force."""
        if self.ties is None:
            return None
        return self.ties.of_free(turn, x, self._mass, self.frame.velocity, self._force(turn, contact))

    def _inertia_and_momentum(self, r̂: Array, ω: Vector) -> tuple[Inertia, Vector]:
        """I⁺ and, with ω⁺, L⁺ = I⁺ ω⁺ + b⁺r⁺ at the rate that the table is of."""
        s = 2 * self.h
        (xx, yy, zz, yz, xz, xy), (x, y, z) = self._now.shape.inertia, self._now.shape.moved
        u, v, w, α, β, γ, δ, ε, ζ = self._gained.dot(r̂).tolist()
        inertia = xx + s * α, yy + s * β, zz + s * γ, yz + s * δ, xz + s * ε, xy + s * ζ
        return inertia, added(times_inertia(inertia, ω), 1.0, (2 * u - x, 2 * v - y, 2 * w - z))

    def jacobian(self, x: Array, push: Push | None = None) -> Array:
        """Of the residual, (3 + m, 3 + m), under contact forces that push and stay as they are."""
        h, now, table, r̂, m = self.h, self._now, self._table, x[3:], len(x) - 3
        if self.elastic is not None and not self.elastic.is_exact:
            self.elastic.renew(r̂)
            self._take_slope(r̂)
        (A, B, C), (a, b, c) = now.ω, vector(x[:3])
        ω_end = 2 * a - A, 2 * b - B, 2 * c - C
        self._move(r̂)
        bent, turned = table[BENT_BY_RATE], table[TURNED]
        (xx, yy, zz, yz, xz, xy), L_end = self._inertia_and_momentum(r̂, ω_end)
        u, v, w = mean(now.L, L_end)
        carry = np.array(((1 / h, -c / 2, b / 2), (c / 2, 1 / h, -a / 2), (-b / 2, a / 2, 1 / h)))  # 1/h + ω̂~/2
        J = np.empty((3 + m, 3 + m))
        J[:3, :3] = carry.dot(((2 * xx, 2 * xy, 2 * xz), (2 * xy, 2 * yy, 2 * yz), (2 * xz, 2 * yz, 2 * zz)))
        J[:3, :3] -= ((0.0, -w, v), (w, 0.0, -u), (-v, u, 0.0))
        J[:3, 3:] = 2 * carry.dot(contraction(2 * h, ω_end).dot(bent - table[BENT] / 2) + turned)
        J[3:, :3] = (2 / h * turned + 2 * table[TURNED_BY_RATE] - contraction(2.0, now.ω).dot(bent)).T
        factors = np.array((*(-p for p in pairs(now.ω, ω_end)), 2 * a, 2 * b, 2 * c, 1.0))
        J[3:, 3:] = factors.dot(self._flat_products).reshape(m, m)
        return J if self.ties is None else J - self.slopes_of_ties(x, push)[0]

    def slopes_of_ties(self, x: Array, push: Push | None) -> tuple[Array, Array]:
        """As in GroundTies."""
        tied = self._tied(self.geometry(x), x, ZERO if push is None else push.force)
        assert self.ties is not None
        assert tied is not None
        return self.ties.slopes(tied, self._mass, self._forces.force)

    # What contact asks for; see frame_contact.

    def turn_at(self, x: Array) -> tuple[Geometry, Quaternion]:
        """How the frame turns at the velocities x."""
        a, b, c = (self.h * x[:3]).tolist()
        return turn_of(self._now.R, self.frame.rotation, (a, b, c))

    def corrected(self, x: Array, push: Push | None) -> Array:
        """Velocities nearer to those of the step, under contact forces that push."""
        assert self.newton.inverse is not None
        corrected: Array = x - self.newton.inverse.dot(self._residual(x, push))
        return corrected

    def renew(self, x: Array) -> None:
        """As in FrameBody of mechanics.frame_contact: contact may have put x far from where it was without."""
        self.newton.keep(self.jacobian(x))

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""
        assert self.newton.inverse is not None
        pushed = np.concatenate([change.turning, change.modal])
        if self._lever is not None:  # the force moves the origin, against which ties push
            pushed -= np.array(change.force).dot(self._lever)
        spread: Array = self.newton.inverse.dot(pushed)
        return spread

    def maps(self, turn: Geometry, arms: Array) -> Array:
        """As in FrameKernel."""
        return np.hstack(self.points.maps(turn, arms))

    def _spread_columns(self, columns: Array) -> Array:
        """As in FrameKernel."""
        assert self.newton.inverse is not None
        spread: Array = self.newton.inverse[:, 3:].dot(columns)
        return spread

    def _delassus_of(self, points: FramePoints, turn: Geometry, arms: Array) -> Array:
        """As in FrameKernel."""
        assert self.newton.inverse is not None
        maps = np.hstack(points.maps(turn, arms))
        if self.ties is not None:
            self._lever = self.translates * self.ties.lever(turn, self._r)
            maps -= np.tile(self._lever, (len(arms), 1))
        W = maps.dot(self.newton.inverse).dot(maps.T)
        blocks = W.reshape(len(arms), 3, len(arms), 3)
        for k in range(3):
            blocks[:, k, :, k] += self.translates
        return W

    @property
    def translates(self) -> float:
        """v̂ per force, m/s/N, with ω̂ and r̂ as they are."""
        return self.h / 2 / self._mass if self.ties is None else self.ties.compliance(self._mass)

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (m,)."""
        return x[:3], x[3:]

    def translation(self, turn: Geometry, contact: Vector, x: Array) -> Array:
        """As in FrameBody of mechanics.frame_contact."""
        if (tied := self._tied(turn, x, contact)) is not None:
            return tied.velocity
        return np.array(added(self.frame.velocity, self.h / 2 / self._mass, self._force(turn, contact)))

    def _force(self, turn: Geometry, contact: Vector) -> Vector:
        """All forces but those of ties, in world axes."""
        force = added(contact, self._mass, self._forces.acceleration)
        if self._forces.at_points is not None:
            force = added(force, 1.0, vector(self._forces.at_points.sum(axis=0)))
        return added(force, 1.0, turn.mean(self._forces.force))

    def _pushed_by(self, contact: ContactSolution, x: Array) -> tuple[Push, float]:
        """What contact forces do at the velocities x, and their power, W."""
        turn = self.geometry(x)
        yielding = self.yielding(turn, contact)
        arms = self.arms(turn, x[3:], yielding)
        push = self.push(contact.forces, turn, arms)
        self._touched = self.velocities(turn, arms, x, yielding) + self.translation(turn, push.force, x)
        return push, float(contact.forces.ravel().dot(self._touched.ravel()))

    def end_step(self, x: Array, contact: ContactSolution | None, push: Push | None, power: float) -> float:
        """Takes the step with these velocities; twice the stored energy, J."""
        h, forces, r̂, before = self.h, self._forces, x[3:], self.frame
        a, b, c = x[:3].tolist()
        turn, rotation = self.turn_at(x)
        torque = self._torque(r̂)
        supplied, rubbed = dot(torque, (a, b, c)) + float(forces.modal.dot(r̂)), self._rubbed(r̂)
        supplied += self._followed_power(r̂) - rubbed
        τ, pushed = turn.mean(torque), ZERO
        prescribed = self._prescribed(forces, turn, self._now.q, r̂, h)
        if prescribed is not None:
            τ = added(τ, 1.0, prescribed.torque)
            supplied += dot(prescribed.turning, (a, b, c)) + float(prescribed.modal.dot(r̂))
        if push is not None:
            τ, pushed = added(τ, 1.0, push.torque), push.force
        force, heat = self._force(turn, pushed), 0.0
        v = added(before.velocity, h / self._mass, force)
        v̂ = added(before.velocity, h / 2 / self._mass, force)
        tied = self._tied(turn, x, pushed)
        if self.ties is not None and tied is not None:
            v̂ = vector(tied.velocity)
            v, τ = added(added(v̂, 1.0, v̂), -1.0, before.velocity), added(τ, 1.0, tied.push().torque)
            heat = self.ties.dissipated(tied)
        supplied += dot(added(force, -1.0, pushed), v̂)
        frame = FrameState(added(before.position, h, v̂), rotation, v, added(before.turning, h, τ))
        e, r = self._e + self._travel * r̂, r̂ + r̂ - self._r
        q = e * self._inverse_ω
        heat = self._heat(r̂, q) - h * rubbed
        motion = self._moving(q, self._shape_at(q, r), turn.after, frame.turning, e)
        if self.ties is not None:
            self.ties.place(frame.position, turn.after, q)
        heat += self._step_residual(in_frame(turn, contact))[1]
        self._finish(contact, power, h * supplied, heat)
        self._passed = h, x
        self.frame, self._now_before, self._now = frame, self._now, motion
        return self._arrive(e, r)
