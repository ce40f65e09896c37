"""The step of a body that a rigid base carries, whose motion is given.

Twist (v, ω) of the base in the frame's axes at both ends of the step; V is clamped at the base. With I, b of
`frame_kernel`, x̄ and c of `rom.moving_frame`,

    P = mass v + ω × (x̄ + c q) + c r,    L = I ω + b r + (x̄ + c q) × v
    A = 2/h + D + h/2 γ + 2 Σ ω̂_k G_k - h/2 Σ ω_k ω⁺_l I2_kl
    A r̂ = 2/h r - bᵀΔω/h - ½ Σ Δω_k G_k r - cᵀ[Δv/h + ½ (ω × v⁺ + ω⁺ × v)] + ½ Σ ω_k ω⁺_l (I1_kl + 2 I2_kl q) - γ q + f
    F_b = ΔP/h + ω̂ × P̂ - R*ᵀ Σ f,    τ_b = ΔL/h + ω̂ × L̂ + v̂ × P̂ - R*ᵀ Σ a × f

is one linear system. (F_b, τ_b) is what the base puts on the body; in world axes (R + R⁺)/2 turns it. With

    E = ½ mass |v|² + ½ ω·I ω + ω·b r + v·(ω × (x̄ + c q)) + v·c r + ½ |r|² + ½ qᵀγq

E⁺ - E = h (F_b·v̂ + τ_b·ω̂) + h Σ f·ŝ - h r̂ᵀ D r̂ whatever twists are given. What the base supplies in a step, and f·r̂
and the rest of Σ f·ŝ but for contact, is ΔP·v̂ + ΔL·ω̂ + h f·r̂ less the work that contact forces do with the base.
"""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.base_fit import misfit, misfit_message
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.frame_contact import touch
from fenics_rom.mechanics.frame_geometry import Geometry, turned_operator, vector
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
)
from fenics_rom.mechanics.largest_turn import check_turn
from fenics_rom.runtime.steppers.carried_balance import CarriedBalance, Wrench
from fenics_rom.runtime.steppers.carried_base import Begun, Motion, frame_state, motion_of
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape, in_frame

if TYPE_CHECKING:
    from fenics_rom.runtime.steppers.compiled_frame import FrameStep


class CarriedFrame(CarriedBalance):
    """Arguments and attributes as in FrameKernel; `frame.turning` is the angular velocity of the base."""

    _stands: Array | None = None  # the base (13,) at the end of the last step, if it stood still and that was compiled

    @property
    def answers_linearly(self) -> bool:  # type: ignore[override]
        """As in Kernel."""
        return self._found is None and (self.elastic is None or self.elastic.is_exact)

    @property
    def energy(self) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        if self._motion is None:
            return self._twice / 2
        now = self._now
        carried = dot(now.P, now.v) + dot(now.L, now.ω) + dot(now.shape.drift, now.v) + dot(now.shape.moved, now.ω)
        return self._with_carried_energy((carried + self._square) / 2)

    @property
    def angular_velocity(self) -> Vector:
        """As in FrameKernel."""
        return self._now.ω

    @property
    def momenta(self) -> tuple[Vector, Vector]:
        """Linear and, about the frame's origin, angular, in world axes."""
        return rotated(self._now.R, self._now.P), rotated(self._now.R, self._now.L)

    @property
    def wrench(self) -> Wrench:
        """Force (N) and torque about the frame's origin (N m) of the base on the body in the last step, world axes."""
        if callable(self._wrench):
            self._wrench = self._wrench()
        return self._wrench

    @wrench.setter
    def wrench(self, wrench: Wrench) -> None:
        self._wrench = wrench

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        return *super().messages, *misfit_message(self.notes["misfit"], self.notes["misfit of turn"])

    def set_time_step(self, h: float) -> None:
        """As in Kernel."""
        super().set_time_step(h)
        self._A = None
        if self.elastic is not None:
            self._products[9] = self._inert

    def forget(self) -> Shape:
        """As in FrameKernel."""
        self._A = None
        return super().forget()

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self._wrench = self._wrench_before

    def _motion_from(self, q: Array, shape: Shape, R: Rotation) -> Motion:
        """As in FrameKernel."""
        twist = rotated_back(R, self.frame.velocity), rotated_back(R, self.frame.turning)
        return motion_of(q, shape, R, *twist, self._mass)

    def place(self, frame: FrameState) -> None:
        """Puts the base where it is to be; `turning` is its angular velocity in world axes, rad/s."""
        self.frame = frame
        self.resume(self.auxiliary)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; to `base`."""
        if taken := self._taken_compiled(u, self._base_row(), obstacles):
            return self._end_compiled(u, taken)
        r̂, contact = self._begin_step(u), None
        if self.found is not None or (self._interface is not None and obstacles is not None):
            if not math.isfinite(r̂.dot(r̂)):
                raise StepError("the inputs are so large that the step overflows; the state was left as it was")
            r̂, contact = touch(self, self._interface, r̂, obstacles, None if self.found is None else self)
        return self._end_step(r̂, contact)

    def _base_row(self) -> Array:
        """The base at the end of the step, (13,)."""
        if self.base is not None:
            self._stands = None
            return np.concatenate(self.base)
        if self._stands is None or self._frame_known is not None:
            position, rotation, _, _ = self.frame
            self._stands = np.array((*position, *rotation, *np.zeros(6)))
        return self._stands

    def _base_at_end(self) -> FrameState:
        """The same; it stands still where nothing says how it moves."""
        return self.frame._replace(velocity=ZERO, turning=ZERO) if self.base is None else frame_state(self.base)

    def end_in_world(self, u: Array, square: float, within: float) -> None:
        """As in CompilableFrame."""
        assert self._compiled is not None
        super().end_in_world(u, square, within)
        self._stands = None
        self._wrench = self._compiled.wrench()

    def _end_compiled(self, u: Array, taken: "FrameStep", *, owed: bool = True) -> float:
        """As in FrameKernel."""
        assert self._compiled is not None
        self._wrench_before, self._wrench = self._wrench, self._compiled.wrench()
        return super()._end_compiled(u, taken, owed=owed)

    def open(self, u: Array) -> Array:
        """As in Kernel."""
        self._free = self._begin_step(u)
        assert self._taken is not None
        return self._moved_points(self._taken, self._free, self.yielding(self._taken.turn, None))[1]

    def answer(self, some: Array) -> Array:
        """As in Kernel."""
        step = self._taken
        assert step is not None
        key = some.tobytes()
        if self._inside_of is None or self._inside_of[0] is not step.A or self._inside_of[1] != key:
            V = self.points.of(some).rows
            inside = V.T.dot(self._solved(step.A, V))
            if self.residual is not None:
                inside += self.residual.delassus_of(some)
            self._inside_of, self._answered = (step.A, key, inside), None
        turn = step.turn
        turns = turn.before, turn.after, turn.turn
        if self._answered is None or self._answered[0] != turns:  # R*ᵀ f is what the frame sees of a force
            outward = turn.middle + cross_matrix(turn.middle.dot(step.ω̂)).dot(self.h / 2 * turn.end)
            self._answered = turns, turned_operator(outward, self._inside_of[2], turn.middle)
        return self._answered[1]

    def close(self, contact: ContactSolution | None) -> float:
        """As in Kernel."""
        step, r̂ = self._taken, self._free
        assert step is not None
        if contact is not None:
            pushed = self.points.rows.dot(contact.forces.dot(step.turn.middle).ravel())
            r̂ = self._solved(step.A, step.right + pushed)
        return self._end_step(r̂, contact)

    def _begin_step(self, u: Array) -> Array:
        """r̂ (m,) of a step without contact."""
        h, now = self.h, self._now
        self._forces = forces = self._begun(u)
        end = self._base_at_end()
        R = rotation_of(*end.rotation)
        v_end, ω_end = rotated_back(R, end.velocity), rotated_back(R, end.turning)
        check_turn(h, now.ω)
        check_turn(h, ω_end)
        v̂, ω̂ = mean(now.v, v_end), mean(now.ω, ω_end)
        turn = Geometry(now.R, R, (h * ω̂[0], h * ω̂[1], h * ω̂[2]))
        modal = self._loads.modal(forces, turn, self._constants)
        (A, right), tied = self._equations(modal, ω̂, v_end, ω_end), None
        if self.ties is not None:
            A, right, tied = self.ties.of_carried(A, right, turn, end.position)
        before, self._taken = self._taken, Begun(A, right, turn, end, v̂, ω̂, v_end, ω_end, forces, modal, tied)
        if self.elastic is not None:
            return self._strained(self._taken)
        if A.ndim == 2 and before is not None and A is before.A:  # of a base that turns steadily
            r̂: Array = self._inverse_slopes.dot(right)
            return r̂
        self._inverse = None
        return self._solved(A, right)

    def _end_step(self, r̂: Array, contact: ContactSolution | None) -> float:
        """Takes the step that has begun, to the velocities that it was found to have."""
        h, now, start, step = self.h, self._now, self.frame, self._taken
        assert step is not None
        turn, power, pushed, heat = step.turn, 0.0, None, 0.0
        if self._interface is not None:
            self.places()  # where the step begins, as the residual part now goes on
            yielding, heat = self._step_residual(in_frame(turn, contact))
        if contact is not None:
            arms, self._touched = self._moved_points(step, r̂, yielding)
            push = self.push(contact.forces, turn, arms)
            pushed, power = (
                (turn.seen(push.force), push.turning),
                float(contact.forces.ravel().dot(self._touched.ravel())),
            )
        e, r = self._e + self._travel * r̂, r̂ + r̂ - self._r
        q, v̂, ω̂ = e * self._inverse_ω, step.v̂, step.ω̂
        after = motion_of(q, self._shape_at(q, r), turn.after, step.v_end, step.ω_end, self._mass)
        of_base = dot(added(after.P, -1.0, now.P), v̂) + dot(added(after.L, -1.0, now.L), ω̂)
        rubbed = self._rubbed(r̂)
        supplied = of_base + h * (float(step.modal.dot(r̂)) + self._followed_power(r̂) - rubbed)
        if pushed is not None:  # the work of contact forces is booked as theirs
            supplied -= h * (dot(pushed[0], v̂) + dot(pushed[1], ω̂))
        if self.ties is not None and step.tied is not None:  # the base does the work that ties do not do on the shape
            tied = self.ties.with_rate(step.tied, r̂)
            self._taken = step = step._replace(tied=tied)
            supplied += h * (float(tied.push().modal.dot(r̂)) - tied.power)
            heat += self.ties.dissipated(tied)
            self.ties.place(step.end.position, turn.after, q)
        self._finish(contact, power, supplied, self._heat(r̂, q) - h * rubbed + heat)
        self._look_at_base(start, step.end, turn, v̂)
        self._wrench_before, self._now_before = self._wrench, now
        self._wrench = partial(self._wrench_of, h, step, r̂, now, after, pushed)
        self._now, self.frame = after, step.end
        return self._arrive(e, r)

    @property
    def _motion_felt(self) -> tuple[Vector | None, Vector | None, Vector]:
        """As in PartedKernel."""
        before, now, step = self._now_before, self._now, self._taken
        assert step is not None
        a = added(cross(step.ω̂, step.v̂), 1 / self.h, added(now.v, -1.0, before.v))
        a = added(a, -1.0, step.turn.seen(step.forces.acceleration))
        α = added(ZERO, 1 / self.h, added(now.ω, -1.0, before.ω))
        return a, α, step.ω̂

    def follow(self, other: "CarriedFrame", P: Array, u: Array) -> Array:
        """As in FreeFrame."""
        self.frame, self.base = other._frame_before, other.base
        self._go_to_start_of(other, P)
        self._begin_step(u)
        if self.found is not None:
            self.act(other.reactions)
        step, r̂ = self._taken, P @ other.passed_rate
        assert step is not None
        lack: Array = (step.A * r̂ if step.A.ndim == 1 else step.A @ r̂) - step.right
        if other.contact is not None:
            lack = lack - self.points.rows.dot(other.contact.forces.dot(step.turn.middle).ravel())
        self._end_step(r̂, other.contact)
        return lack

    def _moved_points(self, step: Begun, r̂: Array, yielding: Array | None) -> tuple[Array, Array]:
        """Arms of the contact points from the origin in the middle of the step, m, and velocities, m/s, (P, 3)."""
        arms = self.arms(step.turn, r̂, yielding)
        return arms, self.velocities(step.turn, arms, r̂, yielding) + step.origin

    def _wrench_of(self, h: float, step: Begun, r̂: Array, now: Motion, after: Motion, pushed: Wrench | None) -> Wrench:
        """Of the base on the body in a step of h s that led from one motion to another; in world axes.

        `pushed`: of contact, as the frame sees it.
        """
        v̂, ω̂, turn = step.v̂, step.ω̂, step.turn
        P̂, L̂ = mean(now.P, after.P), mean(now.L, after.L)
        # ΔP/h + ω̂ × P̂ and ΔL/h + ω̂ × L̂ + v̂ × P̂, of which the base has not what else acts
        force = added(cross(ω̂, P̂), 1 / h, added(after.P, -1.0, now.P))
        torque = added(added(cross(ω̂, L̂), 1.0, cross(v̂, P̂)), 1 / h, added(after.L, -1.0, now.L))
        others = [self._external(h, step, r̂, now, after)]
        if pushed is not None:
            others.append(pushed)
        for other in others:
            force, torque = added(force, -1.0, other[0]), added(torque, -1.0, other[1])
        return turn.mean(force), turn.mean(torque)

    def _external(self, h: float, step: Begun, r̂: Array, now: Motion, after: Motion) -> Wrench:
        """Force and torque about the origin in the frame's axes, but for base and contact."""
        forces, turn = step.forces, step.turn
        force, torque = forces.force, forces.torque
        if forces.torque_by_shape is not None:
            torque = added(torque, 1.0, vector(forces.torque_by_shape.dot(now.q + h / 2 * r̂)))
        if forces.acceleration != ZERO:
            force = added(force, self._mass, turn.seen(forces.acceleration))
            arm = mean(rotated(turn.before, now.shape.moment), rotated(turn.after, after.shape.moment))
            torque = added(torque, 1.0, turn.seen(cross(arm, forces.acceleration)))
        for each in (self._prescribed(forces, turn, now.q, r̂, h), step.tied and step.tied.push()):
            if each is not None:
                force = added(force, 1.0, turn.seen(each.force))
                torque = added(torque, 1.0, each.turning)
        return force, torque

    def _look_at_base(self, start: FrameState, end: FrameState, turn: Geometry, v̂: Vector) -> None:
        """Notes how far the base went otherwise than its twists say."""
        away, turned_by = misfit(start, end, turn, v̂, self.h, self._size)
        self.notes["misfit"] = max(self.notes["misfit"], away)
        self.notes["misfit of turn"] = max(self.notes["misfit of turn"], turned_by)

    # What contact asks for; see frame_contact.

    def turn_at(self, x: Array) -> tuple[Geometry, Quaternion]:
        """How the frame turns, whatever x is."""
        assert self._taken is not None
        return self._taken.turn, self._taken.end.rotation

    def rates(self, x: Array) -> tuple[Array, Array]:
        """ω̂ (3,) in the frame's axes and r̂ (m,)."""
        assert self._taken is not None
        return np.array(self._taken.ω̂), x

    def translation(self, turn: Geometry, contact: Vector, x: Array) -> Array:
        """As in FrameBody of mechanics.frame_contact."""
        assert self._taken is not None
        return self._taken.origin

    def kept_translation(self, turn: Geometry) -> Vector:
        """As in FrameKernel."""
        return vector(turn.middle.dot(self._now.v))
