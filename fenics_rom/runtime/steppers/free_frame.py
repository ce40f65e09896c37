"""The step of a free body, turned as far as it likes.

State: position and velocity of the centre of mass, attitude R, angular momentum ℓ in world axes, shape q, its rate r.
With the mid-step ω̂ and r̂, ω⁺ = 2 ω̂ - ω, r⁺ = 2 r̂ - r, q̂ = q + h/2 r̂, R⁺ = R cay(h ω̂) and L, s of `frame_kernel`:

    ΔL/h + ω̂ × L̂ = R*ᵀ τ,    i.e.  ℓ⁺ = ℓ + h τ
    Δs/h + ½ Σ_k (ω_k G_k r⁺ + ω⁺_k G_k r) - ½ Σ_kl ω_k ω⁺_l (I1_kl + 2 I2_kl q̂) + γ q̂ + D r̂ = f

Two identities make it exact at any h, for any symmetric I2 and antisymmetric G:

    Δ(½ ω·I ω) = ω̂·Δ(I ω) - ½ ω·(ΔI) ω⁺
    Δ(ω·b r) = ω̂·Δ(b r) + r̂·Δ(bᵀω) + ½ Δqᵀ Σ_k (ω_k G_k r⁺ + ω⁺_k G_k r)

so that energy grows by h (F·p'^ + τ·R ω̂ + f·r̂) - h r̂ᵀ D r̂ and momenta by nothing but F and τ. After the iteration ω⁺ is
what the angular momentum says, which no tolerance is in.

The iteration is Newton's with a kept Jacobian, found anew where it no longer converges fast.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.frame_motion import ZERO, Quaternion, Vector, added, cross, cross_matrix, dot, rotation_matrix
from fenics_rom.mechanics.hyperelastic import VOIGT_INDEX
from fenics_rom.runtime.steppers.frame_contact import touch
from fenics_rom.runtime.steppers.frame_kernel import (
    FrameKernel,
    FrameState,
    Shape,
    check_turn,
    pairs,
    solved_inertia,
    times_inertia,
    turn_of,
)
from fenics_rom.runtime.steppers.frame_loads import FrameForces
from fenics_rom.runtime.steppers.frame_points import FramePoints, Geometry, Push, vector

TOLERANCE = 1e-15  # of the velocities: what the next correction may be
ROUND_OFF = 4e-15  # of them: a correction that is none
MOST_ITERATIONS = 60
SLOW = 0.2  # of one correction to the next, from which on the Jacobian is found anew
MANY_ITERATIONS = 6  # from which on it is found anew for the next step


class _Motion(NamedTuple):
    """The body between two steps."""

    shape: Shape
    ω: Vector  # in the frame's axes, rad/s
    R: Array


class _Step(NamedTuple):
    """What does not change within a step."""

    q: Array
    L: Vector  # at the start
    forces: FrameForces


class FreeFrame(FrameKernel):
    """Arguments and attributes as in FrameKernel; `frame.turning` is the angular momentum."""

    def __init__(self, *args: Any, **named: Any):
        super().__init__(*args, **named)
        m = self._model.order
        self._table = np.empty((19, m))  # I2 r̂, G r̂; -(½ I1 + I2 q), b/h + ½ G r; f: what the balance is a sum of
        self._by_rate = self._table[:9].reshape(-1)
        self._weights = np.ones(3 + m)  # in which corrections are measured, as energies are
        self._weights[:3] = sum(self._inertia0[:3]) / 3
        self._inverse: Array | None = None
        self._is_worn = False  # so that it is to be found anew
        self._acceleration: tuple[float, Vector] | None = None  # of the last step of h s
        self.resume(np.empty(0))

    @property
    def energy(self) -> float:
        """Stored, J."""
        shape, ω, v = self._now.shape, self._now.ω, self.frame.velocity
        rigid = self._mass * dot(v, v) + dot(ω, times_inertia(shape.inertia, ω)) + 2 * dot(ω, shape.moved)
        return self._with_residual_energy((rigid + float(self.state.dot(self.state))) / 2)

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
        turning: Array = self._now.R.dot(self._now.ω)
        return turning

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._inverse = None

    def reset_buffer(self) -> None:
        """As in Kernel."""
        super().reset_buffer()
        self._inverse = self._acceleration = None

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self._now, self._inverse, self._acceleration = self._now_before, None, None

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel; the angular velocity is what the angular momentum says."""
        super().resume(auxiliary)
        shape = self._shape_at(self._coordinates(), self._r)
        self._now = self._now_before = _moving(shape, rotation_matrix(self.frame.rotation), self.frame.turning)
        self._inverse = self._acceleration = None

    def place(self, frame: FrameState) -> None:
        """Puts the frame where it is to be; `turning` is here the angular velocity in world axes, rad/s."""
        R, shape = rotation_matrix(frame.rotation), self._shape_at(self._coordinates(), self._r)
        L = added(times_inertia(shape.inertia, vector(np.array(frame.turning).dot(R))), 1.0, shape.moved)
        self.frame = frame._replace(turning=vector(R.dot(L)))
        self.resume(self.auxiliary)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        check_turn(self.h, self._now.ω)
        step = self._begin(self._loads.at(u))
        try:
            x = self._iterate(step)
            contact = None
            if self._interface is not None and obstacles is not None:
                x, contact = touch(self, self._interface, step, x, obstacles)
            return self._end(step, x, contact)
        except StepError:
            self._inverse = self._acceleration = None
            raise

    def _begin(self, forces: FrameForces) -> _Step:
        h, shape, table = self.h, self._now.shape, self._table
        q = self._coordinates().copy()
        np.multiply(self._rest_terms[:6], 0.5, table[9:15])
        table[9:15] -= shape.terms[:6]
        np.multiply(shape.terms[6:9], 1 / h, table[15:18])
        table[15:18] += self._turn_by_rate(self._r).reshape(3, -1) / 2
        given = table[18]
        np.multiply(self._ω, self._e, given)
        given -= self._r * (2 / h)
        given -= forces.modal
        L = added(times_inertia(shape.inertia, self._now.ω), 1.0, shape.moved)
        return _Step(q, L, forces)

    def _iterate(self, step: _Step) -> Array:
        """The mid-step velocities ω̂, r̂ (3 + m,) without contact."""
        h, ω = self.h, self._now.ω
        if self._acceleration is not None and h <= 2 * self._acceleration[0]:  # else it says too little of this step
            ω = added(ω, h / 2, self._acceleration[1])
        x = np.empty(len(self._weights))
        x[:3], x[3:] = ω, self._r
        scale, before, last = 0.0, np.inf, x
        for iteration in range(MOST_ITERATIONS):
            if self._inverse is None or self._is_worn:
                self._inverse, self._is_worn = self._jacobian_inverse(step, x), False
            change = self._inverse.dot(self._residual(step, x, None))
            x -= change
            size = self.size(change)
            if not np.isfinite(size):
                raise StepError("the inputs lead out of the finite numbers; the state was left as it was")
            if not scale:
                scale = self.scale(x)
            ratio = size / before
            if (0 < ratio < 1 and size * ratio <= TOLERANCE * scale) or size <= ROUND_OFF * scale:
                self._is_worn = iteration >= MANY_ITERATIONS
                return x
            if ratio > SLOW and before < np.inf:
                self._inverse, before = None, np.inf
                continue
            if iteration == 1:  # Broyden: what the kept Jacobian lacks changes slowly
                along = self._weights * last
                self._inverse += np.multiply.outer(change, along.dot(self._inverse) / along.dot(last - change))
            before, last = size, change
        raise StepError(
            f"no step of {h:g} s was found that turns the body by {h * dot(ω, ω) ** 0.5:.2g} rad and bends it as it "
            f"does: after {MOST_ITERATIONS} iterations {size / scale:.1e} of the velocities is left; a smaller dt is "
            "the cure"
        )

    def size(self, change: Array) -> float:
        """Of velocities, as √(2 J)."""
        return float(change.dot(self._weights * change)) ** 0.5

    def scale(self, x: Array) -> float:
        """Of the velocities of the step at its start and at x."""
        ω = self._now.ω
        return self.size(x) + (self._weights[0] * dot(ω, ω) + float(self._r.dot(self._r))) ** 0.5

    def _residual(self, step: _Step, x: Array, push: Push | None) -> Array:
        """What the balances of angular momentum and of the coordinates lack, under contact forces that push."""
        h, ω, r̂, table = self.h, self._now.ω, x[3:], self._table
        a, b, c = x[:3].tolist()
        ω̂ = a, b, c
        ω_end = 2 * a - ω[0], 2 * b - ω[1], 2 * c - ω[2]
        self._multiply(r̂, self._by_rate)
        xx, yy, zz, yz, xz, xy = pairs(ω, ω_end)
        s = -h / 2
        by_rate = s * xx, s * yy, s * zz, s * yz, s * xz, s * xy, 2 * a, 2 * b, 2 * c
        at_start = xx, yy, zz, yz, xz, xy, ω_end[0] - ω[0], ω_end[1] - ω[1], ω_end[2] - ω[2], 1.0
        ρ = np.empty(len(x))
        along = ρ[3:]
        np.multiply(self._diagonal, r̂, along)
        along += np.array((*by_rate, *at_start)).dot(table)
        if self._dense_damping:
            along += self._model.damping.dot(r̂)
        L, L_end = step.L, self._end_momentum(table.dot(r̂).tolist(), ω_end)
        t = step.forces.torque
        if step.forces.torque_by_shape is not None:
            t = added(t, 1.0, vector(step.forces.torque_by_shape.dot(step.q + h / 2 * r̂)))
        pushes = [push] if push is not None else []
        if step.forces.at_points is not None:
            prescribed = self._prescribed(step.forces, self.turn_at(x)[0], step.q, r̂)
            pushes += [prescribed] if prescribed is not None else []
        for each in pushes:
            t = added(t, 1.0, each.turning)
            along -= each.modal
        x_, y_, z_ = cross(ω̂, added(L, 1.0, L_end))
        ρ[0] = (L_end[0] - L[0]) / h + x_ / 2 - t[0]
        ρ[1] = (L_end[1] - L[1]) / h + y_ / 2 - t[1]
        ρ[2] = (L_end[2] - L[2]) / h + z_ / 2 - t[2]
        return ρ

    def _end_momentum(self, along: list[float], ω: Vector) -> Vector:
        """L⁺ from the products of the table with r̂: I⁺ = I + h (I1 + 2 I2 q)·r̂ + h² r̂·I2 r̂; b⁺r⁺ is linear in r̂."""
        h, shape = self.h, self._now.shape
        xx, yy, zz, yz, xz, xy, _, _, _, l_xx, l_yy, l_zz, l_yz, l_xz, l_xy, b_x, b_y, b_z, _ = along
        I_xx, I_yy, I_zz, I_yz, I_xz, I_xy = shape.inertia
        inertia = (
            I_xx + h * (h * xx - 2 * l_xx),
            I_yy + h * (h * yy - 2 * l_yy),
            I_zz + h * (h * zz - 2 * l_zz),
            I_yz + h * (h * yz - 2 * l_yz),
            I_xz + h * (h * xz - 2 * l_xz),
            I_xy + h * (h * xy - 2 * l_xy),
        )
        x, y, z = shape.moved
        return added(times_inertia(inertia, ω), 1.0, (2 * h * b_x - x, 2 * h * b_y - y, 2 * h * b_z - z))

    def _jacobian_inverse(self, step: _Step, x: Array) -> Array:
        h, ω, ω̂, r̂ = self.h, np.array(self._now.ω), x[:3], x[3:]
        m, start, ω_end = len(r̂), self._now.shape.terms, 2 * ω̂ - ω
        q_end, r_end = step.q + h * r̂, 2 * r̂ - self._r
        by_rate = self._multiply(r̂).reshape(9, m)
        at_rest = 2 * start[:6] - self._rest_terms[:6]
        bent = (at_rest + h * by_rate[:6])[VOIGT_INDEX].reshape(3, 3 * m)  # I1 + 2 I2 q at q̂
        bent_end = (at_rest + 2 * h * by_rate[:6])[VOIGT_INDEX].reshape(3, 3 * m)  # and at q⁺
        terms = start[:9] + h * by_rate
        inertia = (np.array(self._inertia0) + terms[:6].dot(q_end))[VOIGT_INDEX]
        L_end = inertia.dot(ω_end) + terms[6:].dot(r_end)
        carry = np.eye(3) / h + cross_matrix(ω̂) / 2
        J = np.empty((3 + m, 3 + m))
        J[:3, :3] = carry.dot(2 * inertia) - cross_matrix(np.array(step.L) + L_end) / 2
        r_turned = self._turn_by_rate(r_end).reshape(3, m)
        J[:3, 3:] = carry.dot(h * ω_end.dot(bent_end).reshape(3, m) - h * r_turned + 2 * terms[6:])
        J[3:, :3] = (2 * self._table[15:18] + 2 * by_rate[6:] - ω.dot(bent).reshape(3, m)).T
        factors = [-h / 2 * p for p in pairs(vector(ω), vector(ω_end))]
        A = np.array((*factors, *(2 * ω̂))).dot(self._products.reshape(9, m * m)).reshape(m, m)
        A.ravel()[:: m + 1] += self._diagonal
        J[3:, 3:] = A + self._model.damping if self._dense_damping else A
        try:
            inverse: Array = np.linalg.inv(J)
        except np.linalg.LinAlgError as error:
            raise StepError(f"no step of {h:g} s was found: its equations are singular; a smaller dt helps") from error
        return inverse

    # What contact asks for; see frame_contact.

    def turn_at(self, x: Array) -> tuple[Geometry, Quaternion]:
        """How the frame turns at the velocities x."""
        a, b, c = (self.h * x[:3]).tolist()
        return turn_of(self._now.R, self.frame.rotation, (a, b, c))

    def corrected(self, step: _Step, x: Array, push: Push | None) -> Array:
        """Velocities nearer to those of the step, under contact forces that push."""
        assert self._inverse is not None
        corrected: Array = x - self._inverse.dot(self._residual(step, x, push))
        return corrected

    def spread(self, change: Push) -> Array:
        """What x changes by, where contact forces change by so much."""
        assert self._inverse is not None
        spread: Array = self._inverse.dot(np.concatenate([change.turning, change.modal]))
        return spread

    def delassus(self, points: FramePoints, turn: Geometry, arms: Array) -> Array:
        """Mid-step velocities (3 s, 3 s) of points per force, m/s/N."""
        assert self._inverse is not None
        maps = np.hstack(points.maps(turn, arms))
        W = maps.dot(self._inverse).dot(maps.T)
        blocks = W.reshape(len(arms), 3, len(arms), 3)
        for k in range(3):
            blocks[:, k, :, k] += self.h / 2 / self._mass
        return W

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (m,)."""
        return x[:3], x[3:]

    def translation(self, step: _Step, turn: Geometry, contact: Vector) -> Array:
        """Mid-step velocity (3,) of the origin under a contact force."""
        return np.array(added(self.frame.velocity, self.h / 2 / self._mass, self._force(step, turn, contact)))

    def _force(self, step: _Step, turn: Geometry, contact: Vector) -> Vector:
        """All forces, in world axes."""
        force = added(contact, self._mass, step.forces.acceleration)
        if step.forces.at_points is not None:
            force = added(force, 1.0, vector(step.forces.at_points.sum(axis=0)))
        return added(force, 1.0, _in_world(turn, step.forces.force))

    def _end(self, step: _Step, x: Array, contact: ContactSolution | None) -> float:
        """Takes the step with these velocities; twice the stored energy, J."""
        h, forces, r̂, before = self.h, step.forces, x[3:], self.frame
        a, b, c = x[:3].tolist()
        turn, rotation = self.turn_at(x)
        torque = forces.torque
        if forces.torque_by_shape is not None:
            torque = added(torque, 1.0, vector(forces.torque_by_shape.dot(step.q + h / 2 * r̂)))
        supplied = dot(torque, (a, b, c)) + float(forces.modal.dot(r̂))
        τ, pushed = _in_world(turn, torque), ZERO
        prescribed = self._prescribed(forces, turn, step.q, r̂)
        if prescribed is not None:
            τ = added(τ, 1.0, prescribed.torque)
            supplied += dot(prescribed.turning, (a, b, c)) + float(prescribed.modal.dot(r̂))
        touched = None
        if contact is not None:
            yielding = self.yielding(turn, contact)
            arms = self.arms(turn, r̂, yielding)
            push = self.points.push(contact.forces, turn, arms)
            τ, pushed = added(τ, 1.0, push.torque), push.force
            touched = self.velocities(turn, arms, x, yielding) + self.translation(step, turn, pushed)
        force = self._force(step, turn, pushed)
        v = added(before.velocity, h / self._mass, force)
        v̂ = added(before.velocity, h / 2 / self._mass, force)
        supplied += dot(added(force, -1.0, pushed), v̂)
        frame = FrameState(added(before.position, h, v̂), rotation, v, added(before.turning, h, τ))
        e, r = self._e + h * self._ω * r̂, r̂ + r̂ - self._r
        motion = _moving(self._shape_at(e * self._inverse_ω, r), turn.end, frame.turning)
        self._finish(contact, turn, touched, h * supplied, h * float(r̂.dot(self._damped(r̂))))
        was = self._now
        self._acceleration = (
            h,
            ((motion.ω[0] - was.ω[0]) / h, (motion.ω[1] - was.ω[1]) / h, (motion.ω[2] - was.ω[2]) / h),
        )
        self.frame, self._now_before, self._now = frame, was, motion
        self._e[:], self._r[:] = e, r
        return 2 * self.energy


def _moving(shape: Shape, R: Array, momentum: Vector) -> _Motion:
    """The body with an angular momentum in world axes."""
    return _Motion(shape, solved_inertia(shape, added(vector(R.T.dot(momentum)), -1.0, shape.moved)), R)


def _in_world(turn: Geometry, force: Vector) -> Vector:
    """A force, or a torque, that turns with the frame, as it acts in a step."""
    return ZERO if force == ZERO else vector((turn.start + turn.end).dot(force) / 2)
