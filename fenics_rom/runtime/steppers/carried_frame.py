"""The step of a body that a rigid base carries, whose motion is given.

Twist (v, ω) of the base in the frame's axes at both ends of the step; V is clamped at the base. With I, b of
`frame_kernel`, x̄ and c of `rom.moving_frame`,

    P = mass v + ω × (x̄ + c q) + c r,    L = I ω + b r + (x̄ + c q) × v
    A = 2/h + D + h/2 γ + 2 Σ ω̂_k G_k - h/2 Σ ω_k ω⁺_l I2_kl
    A r̂ = 2/h r - bᵀΔω/h - ½ Σ Δω_k G_k r - cᵀ[Δv/h + ½ (ω × v⁺ + ω⁺ × v)] + ½ Σ ω_k ω⁺_l (I1_kl + 2 I2_kl q) - γ q + f
    F_b = ΔP/h + ω̂ × P̂ - R*ᵀ Σ f,    τ_b = ΔL/h + ω̂ × L̂ + v̂ × P̂ - R*ᵀ Σ a × f

is one linear system. (F_b, τ_b) is what the base puts on the body; in world axes (R + R⁺)/2 turns it. With

    E = ½ mass |v|² + ½ ω·I ω + ω·b r + v·(ω × (x̄ + c q)) + v·c r + ½ |r|² + ½ qᵀγq

E⁺ - E = h (F_b·v̂ + τ_b·ω̂) + h Σ f·ŝ - h r̂ᵀ D r̂ whatever twists are given.
"""

import math
import operator
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.frame_motion import ZERO, Quaternion, Vector, added, cross, dot, rotation_matrix, turned
from fenics_rom.runtime.steppers.frame_contact import touch
from fenics_rom.runtime.steppers.frame_kernel import FrameKernel, FrameState, Shape, check_turn, pairs, times_inertia
from fenics_rom.runtime.steppers.frame_loads import FrameForces
from fenics_rom.runtime.steppers.frame_points import FramePoints, Geometry, Push, arms_of, vector

MISFIT = 0.1  # of what the base moves by in a step: so far off may be what its twists say
NEGLIGIBLE = 1e-6  # rad, and of the size of the body: what is no motion


class _Motion(NamedTuple):
    """The body between two steps."""

    shape: Shape
    R: Array
    v: Vector  # of the base, in the frame's axes
    ω: Vector

    P: Vector  # and its momenta, linear and about the frame's origin
    L: Vector


def _motion(shape: Shape, R: Array, v: Vector, ω: Vector, mass: float) -> _Motion:
    """The same with its momenta."""
    P = added(added(cross(ω, shape.moment), mass, v), 1.0, shape.drift)
    L = added(added(times_inertia(shape.inertia, ω), 1.0, shape.moved), 1.0, cross(shape.moment, v))
    return _Motion(shape, R, v, ω, P, L)


class _Step(NamedTuple):
    """What does not change within a step."""

    A: Array  # (m,) where it is diagonal, else (m, m)
    right: Array  # (m,)
    turn: Geometry
    rotation: Quaternion  # at the end
    v̂: Vector
    ω̂: Vector


class CarriedFrame(FrameKernel):
    """Arguments and attributes as in FrameKernel; `frame.turning` is the angular velocity of the base.

    Attributes:
        base: where the base is to be at the end of the next step; None: it stands still.
        wrench: force (N) and torque about the frame's origin (N m) of the base on the body in the last step, in world
            axes.
    """

    def __init__(self, *args: Any, **named: Any):
        super().__init__(*args, **named)
        self.notes |= {"misfit": 0.0, "misfit of turn": 0.0}
        self.base: BaseState | None = None
        self.wrench = self._wrench_before = (ZERO, ZERO)
        self._inverse: Array | None = None
        self._taken: _Step | None = None
        self._size = (sum(self._inertia0[:3]) / 2 / self._mass) ** 0.5
        self.resume(np.empty(0))

    @property
    def energy(self) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        now = self._now
        carried = dot(now.P, now.v) + dot(now.L, now.ω) + dot(now.shape.drift, now.v) + dot(now.shape.moved, now.ω)
        return self._with_residual_energy((carried + float(self.state.dot(self.state))) / 2)

    @property
    def angular_velocity(self) -> Vector:
        """As in FrameKernel."""
        return self._now.ω

    @property
    def momenta(self) -> tuple[Vector, Vector]:
        """Linear and, about the frame's origin, angular, in world axes."""
        return vector(self._now.R.dot(self._now.P)), vector(self._now.R.dot(self._now.L))

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        away, turned = self.notes["misfit"], self.notes["misfit of turn"]
        if not (away or turned):
            return super().messages
        return (
            *super().messages,
            f"base: in a step it went {away:.2g} m and turned {turned:.2g} rad otherwise than its velocities at both "
            "ends say: it jumps, or twists and poses do not fit; the account closes, but the forces are of the twists",
        )

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self._now, self.wrench = self._now_before, self._wrench_before

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        super().resume(auxiliary)
        shape = self._shape_at(self._coordinates(), self._r)
        R = rotation_matrix(self.frame.rotation)
        self._now = self._now_before = _motion(shape, R, *_twist(self.frame, R), self._mass)

    def place(self, frame: FrameState) -> None:
        """Puts the base where it is to be; `turning` is its angular velocity in world axes, rad/s."""
        self.frame = frame
        self.resume(self.auxiliary)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; to `base`."""
        h, now, start = self.h, self._now, self.frame
        forces = self._loads.at(u)
        end = start._replace(velocity=ZERO, turning=ZERO) if self.base is None else frame_state(self.base)
        R = rotation_matrix(end.rotation)
        v_end, ω_end = _twist(end, R)
        check_turn(h, now.ω)
        check_turn(h, ω_end)
        v̂, ω̂ = _mean(now.v, v_end), _mean(now.ω, ω_end)
        turn = Geometry(now.R, R, (h * ω̂[0], h * ω̂[1], h * ω̂[2]))
        q, modal = self._coordinates().copy(), self._modal(forces, turn)
        A, right = self._equations(modal, ω̂, v_end, ω_end)
        r̂ = np.linalg.solve(A, right) if A.ndim == 2 else right / A
        if not np.isfinite(r̂).all():
            raise StepError("the inputs lead out of the finite numbers; the state was left as it was")
        step = _Step(A, right, turn, end.rotation, v̂, ω̂)
        contact, touched, push = None, None, None
        self._taken, self._inverse = step, None
        if self._interface is not None and obstacles is not None:
            r̂, contact = touch(self, self._interface, step, r̂, obstacles)
        if contact is not None:
            yielding = self.yielding(turn, contact)
            arms = self.arms(turn, r̂, yielding)
            push = self.points.push(contact.forces, turn, arms)
            touched = self.velocities(turn, arms, r̂, yielding) + self.translation(step, turn, push.force)
        e, r = self._e + h * self._ω * r̂, r̂ + r̂ - self._r
        after = _motion(self._shape_at(e * self._inverse_ω, r), R, v_end, ω_end, self._mass)
        inertial = self._inertial(after, v̂, ω̂)
        # Of what is supplied, work of contact forces is booked as theirs.
        force, torque = self._external(forces, turn, q, r̂, after.shape)
        base = added(inertial[0], -1.0, force), added(inertial[1], -1.0, torque)
        if push is not None:
            base = (
                added(base[0], -1.0, vector(np.array(push.force).dot(turn.middle))),
                added(base[1], -1.0, push.turning),
            )
        supplied = dot(added(base[0], 1.0, force), v̂) + dot(added(base[1], 1.0, torque), ω̂) + float(modal.dot(r̂))
        self._finish(contact, turn, touched, h * supplied, h * float(r̂.dot(self._damped(r̂))))
        self._wrench_before, self._now_before = self.wrench, now
        wrench = np.array(base).dot((turn.start + turn.end).T) / 2
        self.wrench, self._now, self.frame = (vector(wrench[0]), vector(wrench[1])), after, end
        self._look_at_base(start, end, turn, v̂)
        self._e[:], self._r[:] = e, r
        return 2 * self.energy

    def _equations(self, modal: Array, ω̂: Vector, v_end: Vector, ω_end: Vector) -> tuple[Array, Array]:
        """A and the right-hand side, without contact."""
        h, now, m = self.h, self._now, len(modal)
        products, Δω, Δv = pairs(now.ω, ω_end), added(ω_end, -1.0, now.ω), added(v_end, -1.0, now.v)
        across = added(cross(now.ω, v_end), 1.0, cross(ω_end, now.v))
        table, terms = np.empty((12, m)), now.shape.terms
        np.multiply(self._rest_terms[:6], -0.5, table[:6])
        table[:6] += terms[:6]
        np.multiply(terms[6:9], -1 / h, table[6:9])
        table[6:9] -= self._turn_by_rate(self._r).reshape(3, m) / 2
        np.negative(terms[9:], table[9:])
        factors = (*products, *Δω, *(Δv[k] / h + across[k] / 2 for k in range(3)))
        right = np.array(factors).dot(table)
        right += (2 / h) * self._r
        right -= self._ω * self._e
        right += modal
        if any(now.ω) or any(ω_end):
            coefficients = [-h / 2 * p for p in products]
            coefficients += (2 * ω̂[0], 2 * ω̂[1], 2 * ω̂[2])
            A = np.array(coefficients).dot(self._products.reshape(9, m * m)).reshape(m, m)
            A.ravel()[:: m + 1] += self._diagonal
            return A + self._model.damping if self._dense_damping else A, right
        return np.diag(self._diagonal) + self._model.damping if self._dense_damping else self._diagonal, right

    def _modal(self, forces: FrameForces, turn: Geometry) -> Array:
        """Forces (m,) on the coordinates, but for contact."""
        modal = forces.modal
        if any(forces.acceleration):
            modal = modal + np.array(forces.acceleration).dot(turn.middle).dot(self._constants.moment_modes)
        if forces.at_points is not None:
            modal = modal + self._loads.points.rows.dot(forces.at_points.dot(turn.middle).ravel())
        return modal

    def _external(self, forces: FrameForces, turn: Geometry, q: Array, r̂: Array, after: Shape) -> tuple[Vector, Vector]:
        """Force and torque about the origin in the frame's axes, but for base and contact."""
        force, torque = forces.force, forces.torque
        if forces.torque_by_shape is not None:
            torque = added(torque, 1.0, vector(forces.torque_by_shape.dot(q + self.h / 2 * r̂)))
        if any(forces.acceleration):
            weight = self._mass * np.array(forces.acceleration)
            force = added(force, 1.0, vector(weight.dot(turn.middle)))
            moments = (np.array((self._now.shape.moment,)), np.array((after.moment,)))
            arm = vector(arms_of(turn, *moments)[0])
            torque = added(torque, 1.0, vector(np.array(cross(arm, forces.acceleration)).dot(turn.middle)))
        prescribed = self._prescribed(forces, turn, q, r̂)
        if prescribed is not None:
            force = added(force, 1.0, vector(np.array(prescribed.force).dot(turn.middle)))
            torque = added(torque, 1.0, prescribed.turning)
        return force, torque

    def _inertial(self, after: _Motion, v̂: Vector, ω̂: Vector) -> tuple[Vector, Vector]:
        """ΔP/h + ω̂ × P̂ and ΔL/h + ω̂ × L̂ + v̂ × P̂."""
        h, P, L, P_end, L_end = self.h, self._now.P, self._now.L, after.P, after.L
        P_sum, L_sum = added(P, 1.0, P_end), added(L, 1.0, L_end)
        force, torque = cross(ω̂, P_sum), added(cross(ω̂, L_sum), 1.0, cross(v̂, P_sum))
        return (
            (
                (P_end[0] - P[0]) / h + force[0] / 2,
                (P_end[1] - P[1]) / h + force[1] / 2,
                (P_end[2] - P[2]) / h + force[2] / 2,
            ),
            (
                (L_end[0] - L[0]) / h + torque[0] / 2,
                (L_end[1] - L[1]) / h + torque[1] / 2,
                (L_end[2] - L[2]) / h + torque[2] / 2,
            ),
        )

    def _look_at_base(self, start: FrameState, end: FrameState, turn: Geometry, v̂: Vector) -> None:
        """Notes how far the base went otherwise than its twists say."""
        h, moved = self.h, added(end.position, -1.0, start.position)
        said = vector(turn.start.dot(added(v̂, 0.5, cross(turn.turn, v̂))))
        off = added(moved, -h, said)
        away, way = dot(off, off) ** 0.5, max(dot(moved, moved) ** 0.5, h * dot(said, said) ** 0.5)
        if away > MISFIT * way and away > NEGLIGIBLE * self._size:
            self.notes["misfit"] = max(self.notes["misfit"], away)
        by_twists = turned(start.rotation, turn.turn)
        turned_by = 2 * _apart(by_twists, end.rotation)
        if turned_by > max(NEGLIGIBLE, MISFIT * max(2 * _apart(start.rotation, end.rotation), math.hypot(*turn.turn))):
            self.notes["misfit of turn"] = max(self.notes["misfit of turn"], turned_by)

    # What contact asks for; see frame_contact.

    def turn_at(self, x: Array) -> tuple[Geometry, Quaternion]:
        """How the frame turns, whatever x is."""
        assert self._taken is not None
        return self._taken.turn, self._taken.rotation

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (m,)."""
        assert self._taken is not None
        return np.array(self._taken.ω̂), x

    def corrected(self, step: _Step, x: Array, push: Push | None) -> Array:
        """Velocities of the step under contact forces that push."""
        corrected: Array = self._inverted(step).dot(step.right if push is None else step.right + push.modal)
        return corrected

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""
        assert self._taken is not None
        spread: Array = self._inverted(self._taken).dot(change.modal)
        return spread

    def delassus(self, points: FramePoints, turn: Geometry, arms: Array) -> Array:
        """Mid-step velocities (3 s, 3 s) of points per force, m/s/N."""
        assert self._taken is not None
        maps = points.modal_maps(turn)
        W: Array = maps.dot(self._inverted(self._taken)).dot(maps.T)
        return W

    def translation(self, step: _Step, turn: Geometry, contact: Vector) -> Array:
        """Mid-step velocity (3,) of the origin."""
        translation: Array = turn.middle.dot(step.v̂)
        return translation

    def size(self, change: Array) -> float:
        """Of velocities, as √(2 J)."""
        return float(change.dot(change)) ** 0.5

    def scale(self, x: Array) -> float:
        """Of the velocities of the step at its start and at x, those of the base included."""
        v, ω = self._now.v, self._now.ω
        rigid = self._mass * (dot(v, v) + self._size**2 * dot(ω, ω))
        return self.size(x) + (float(self._r.dot(self._r)) + rigid) ** 0.5

    def _inverted(self, step: _Step) -> Array:
        if self._inverse is None:
            self._inverse = np.linalg.inv(step.A) if step.A.ndim == 2 else np.diag(1 / step.A)
        return self._inverse


def frame_state(base: BaseState) -> FrameState:
    """A base as numbers, its rotation a unit quaternion to round-off."""
    w, x, y, z = base.rotation.tolist()
    size = (w * w + x * x + y * y + z * z) ** 0.5
    rotation = w / size, x / size, y / size, z / size
    return FrameState(vector(base.position), rotation, vector(base.velocity), vector(base.angular_velocity))


def _twist(base: FrameState, R: Array) -> tuple[Vector, Vector]:
    """Its velocities in the frame's axes."""
    v, ω = np.array((base.velocity, base.turning)).dot(R).tolist()
    return tuple(v), tuple(ω)


def _mean(a: Vector, b: Vector) -> Vector:
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, (a[2] + b[2]) / 2


def _apart(a: Quaternion, b: Quaternion) -> float:
    """Sine of half of the angle, rad, between two rotations."""
    return math.dist(a, b) if sum(map(operator.mul, a, b)) > 0 else math.dist(a, tuple(-part for part in b))
