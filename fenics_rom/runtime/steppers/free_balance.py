"""What a step of a free body balances, and the velocities that do."""

import math
from collections.abc import Callable
from functools import partial
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import (
    ZERO,
    Quaternion,
    Rotation,
    Vector,
    added,
    cross,
    cross_matrix,
    dot,
    mean,
    rotated,
    rotated_back,
    rotation_of,
    turned,
)
from fenics_rom.runtime.steppers.differentiable_frame import DifferentiableFrame
from fenics_rom.runtime.steppers.expected_step import Expected
from fenics_rom.runtime.steppers.frame_slopes import SPIN, Moving, StepTurn
from fenics_rom.runtime.steppers.frame_state import Shape
from fenics_rom.runtime.steppers.frame_table import BENT, BENT_BY_RATE, COUPLED, GIVEN, TURNED, TURNED_BY_RATE
from fenics_rom.runtime.steppers.ground_ties import TieForces
from fenics_rom.runtime.steppers.inertia import (
    MOST_ITERATIONS,
    Inertia,
    check_definite,
    contraction,
    definite_up_to,
    pairs,
    solved_inertia,
    times_inertia,
    turn_of_top,
)


class Motion(NamedTuple):
    """The body between two steps."""

    q: Array
    shape: Shape
    ω: Vector  # in the frame's axes, rad/s
    R: Rotation
    L: Vector  # angular momentum in the frame's axes
    spin: float  # ω·I ω + 2 ω·b r, J


class FreeBalance(DifferentiableFrame):
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
        self._passed: tuple[float, Array] | None = None  # the last step: of h s, by ω̂ and r̂
        self.resume(np.empty(0))

    @property
    def energy(self) -> float:
        """Stored, J."""
        if self._motion is None:
            return self._twice / 2
        v = self.frame.velocity
        return self._with_carried_energy((self._mass * dot(v, v) + self._now.spin + self._square) / 2)

    @property
    def angular_velocity(self) -> Vector:
        """As in FrameKernel."""
        return self._now.ω

    @property
    def momenta(self) -> tuple[Vector, Vector]:
        """Linear and, about the centre of mass, angular, in world axes."""
        x, y, z = self.frame.velocity
        return (self._mass * x, self._mass * y, self._mass * z), self.frame.turning

    @property
    def world_angular_velocity(self) -> Array:
        """In world axes, (3,), rad/s."""
        return np.array(rotated(self._now.R, self._now.ω))

    def _moving_with(self, q: Array, shape: Shape, R: Rotation, momentum: Vector, e: Array) -> Motion:
        """The body at q, e = √γ q, with an angular momentum in world axes."""
        if not e.dot(e) <= self._surely_definite:
            check_definite(shape.inertia, self._table[COUPLED])
        L = rotated_back(R, momentum)
        ω = solved_inertia(shape.inertia, added(L, -1.0, shape.moved))
        return Motion(q, shape, ω, R, L, dot(ω, added(L, 1.0, shape.moved)))

    def _motion_told(self, q: Array, R: Rotation, shape: Shape, moving: list[float]) -> Motion:
        """As in FrameKernel."""
        a, b, c, x, y, z, *_ = moving
        ω, L = (a, b, c), (x, y, z)
        return Motion(q, shape, ω, R, L, dot(ω, added(L, 1.0, shape.moved)))

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
                whole = np.linalg.inv(self.slopes(x))[3:, 3:]
                self._ahead = self._matrix, whole, np.linalg.inv(self._products[9])
            except np.linalg.LinAlgError:
                self._ahead = self._matrix, np.zeros((len(x), len(x))), np.zeros((len(r̂), len(r̂)))
        whole = r̂ - self._ahead[2].dot(ρ[3:])  # of the shape alone: next to nothing of it comes of how the frame turns
        pressed = None if self.contact is None else self.contact.forces
        v̂ = None if self.ties is None else self.translation(self.geometry(x), ZERO if push is None else push.force, x)
        of_shape = ρ[3:], self._ahead[2], whole
        self.expectation = Expected(self._acting, self._forces, pressed, *of_shape, x.copy(), v̂, self._passed)
        x -= self._ahead[1].dot(ρ)
        expected = elastic.expect(whole)
        self._take_slope(expected)
        self._given(r̂, expected)

    def _take_slope(self, v: Array) -> None:
        self._take_matrix(v)
        np.add(self._inert, self._matrix, self._products[9])

    def _given(self, v: Array, at: Array) -> None:
        """Makes what of the balance is there at no rate exact at v, of loads that follow as they do at another."""
        self._followed_at = at
        self._give(self._forces.modal - self._resists(v, at))

    def act(self, z: Array) -> None:
        """As in FrameBody of mechanics.frame_contact."""
        assert self.found is not None
        self._acting, self.reactions_found = self.found.acting(z), z
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
            lambda x: self.slopes(x, None if push_at is None or self.ties is None else push_at(x)),
            self.size,
            self._speed if push_at is None else lambda x: self.scale(x) + self.h / 2 * forces / math.sqrt(self._mass),
            self.round_off,
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
            f"bends it as it does: {rest if math.isfinite(left) else 'iterations diverge'}; a smaller dt, or less "
            "force, is the cure"
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

    def slopes(self, x: Array, push: Push | None = None) -> Array:
        """Of what force, torque and coordinates balance, with v̂, ω̂ and r̂ (6 + m, 6 + m); contact forces stay.

        Where v̂ is what the forces say, the inverse of those of the residual is part of the inverse of these.
        """
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
        slopes = np.zeros((6 + m, 6 + m))
        slopes.ravel()[: 3 * (7 + m) : 7 + m] = 2 / h * self._mass
        slopes[SPIN, SPIN] = carry.dot(((2 * xx, 2 * xy, 2 * xz), (2 * xy, 2 * yy, 2 * yz), (2 * xz, 2 * yz, 2 * zz)))
        slopes[SPIN, SPIN] -= ((0.0, -w, v), (w, 0.0, -u), (-v, u, 0.0))
        slopes[SPIN, 6:] = 2 * carry.dot(contraction(2 * h, ω_end).dot(bent - table[BENT] / 2) + turned)
        slopes[6:, SPIN] = (2 / h * turned + 2 * table[TURNED_BY_RATE] - contraction(2.0, now.ω).dot(bent)).T
        factors = np.array((*(-p for p in pairs(now.ω, ω_end)), 2 * a, 2 * b, 2 * c, 1.0))
        slopes[6:, 6:] = factors.dot(self._flat_products).reshape(m, m)
        if self._forces.force == ZERO and self.ties is None:
            return slopes
        turn = self.geometry(x)
        step = StepTurn(turn, h, x[:3])
        slopes[:3, SPIN] += turn.end @ cross_matrix(self._forces.force) @ step.by_spin / 2
        if self.ties is not None:
            v̂ = self.translation(turn, ZERO if push is None else push.force, x)
            p, v_start, q = np.array(self.frame.position), np.array(self.frame.velocity), now.q
            start = Moving(p, v_start, np.array(now.ω), q, self._r)
            end = Moving(p + h * v̂, 2 * v̂ - v_start, np.array(ω_end), q + h * r̂, 2 * r̂ - self._r)
            slopes -= self.ties.push_slopes(start, end, step).x
        return slopes

    def turn_at(self, x: Array) -> tuple[Geometry, Quaternion]:
        """How the frame turns at the velocities x."""
        t = vector(self.h * x[:3])
        end = turned(self.frame.rotation, t)
        return Geometry(self._now.R, rotation_of(*end), t), end

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
