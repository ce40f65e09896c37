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

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.frame_contact import touch
from fenics_rom.mechanics.frame_geometry import Push, vector
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, added, dot, rotated, rotated_back, rotation_of
from fenics_rom.mechanics.largest_turn import check_turn
from fenics_rom.runtime.steppers.frame_state import FrameState, Shape, in_frame
from fenics_rom.runtime.steppers.free_balance import FreeBalance, Motion
from fenics_rom.runtime.steppers.inertia import times_inertia

NO_BASE = np.empty(0)


class FreeFrame(FreeBalance):
    """Arguments and attributes as in FrameKernel; `frame.turning` is the angular momentum."""

    wrench = ZERO, ZERO  # of a base, which there is none of

    def place(self, frame: FrameState) -> None:
        """Puts the frame where it is to be; `turning` is here the angular velocity in world axes, rad/s."""
        R, shape = rotation_of(*frame.rotation), self.forget()
        L = added(times_inertia(shape.inertia, rotated_back(R, frame.turning)), 1.0, shape.moved)
        self.frame = frame._replace(turning=rotated(R, L))
        self.resume(self.auxiliary)

    def forget(self) -> Shape:
        """As in FrameKernel."""
        self._passed = None
        return super().forget()

    def end_in_world(self, u: Array, square: float, within: float) -> None:
        """As in CompilableFrame."""
        super().end_in_world(u, square, within)
        assert self._compiled is not None
        self._passed = self._compiled.passed()

    def tell_loops(self) -> None:
        """As in CompilableFrame; steps begin by the one before, where a law is expected from, too."""
        super().tell_loops()
        assert self._compiled is not None
        self._compiled.pass_on(self._passed)

    def _motion_from(self, q: Array, shape: Shape, R: Rotation) -> Motion:
        """As in FrameKernel; the angular velocity is what the angular momentum says."""
        return self._moving_with(q, shape, R, self.frame.turning, self._e)

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel."""
        if taken := self._taken_compiled(u, NO_BASE, obstacles):
            return self._end_compiled(u, taken)
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
        self._forces = self._begun(u)
        h, x = self.h, np.empty(len(self._weights))
        x[:3], x[3:] = self._now.ω, self._r
        if self._passed is not None and h <= 2 * self._passed[0]:  # else it says too little of this step
            x += (h / self._passed[0]) * (x - self._passed[1])
        if self.elastic is None:
            self._give(self._forces.modal)
        else:
            self._expect(x)
        return x

    def follow(self, other: "FreeFrame", P: Array, u: Array) -> Array:
        """Takes the last step of another body, of shapes P (m, any) among those of this one, under u (p,).

        What the balance of the coordinates lacks (m,).
        """
        self.frame = other._frame_before
        self._go_to_start_of(other, P)
        self.begin_step(u)
        if self.found is not None:
            self.act(other.reactions)
        spin = (np.array(other._now.ω) + np.array(other._now_before.ω)) / 2
        x, contact, push, power = np.concatenate([spin, P @ other.passed_rate]), other.contact, None, 0.0
        if contact is not None:
            push, power = self._pushed_by(contact, x)
        lack = self._residual(x, push)[3:]
        self.end_step(x, contact, push, power)
        return lack

    # What contact asks for; see frame_contact.

    def corrected(self, x: Array, push: Push | None) -> Array:
        """Velocities nearer to those of the step, under contact forces that push."""
        assert self.newton.inverse is not None
        corrected: Array = x - self.newton.inverse.dot(self._residual(x, push))
        return corrected

    def renew(self, x: Array) -> None:
        """As in FrameBody of mechanics.frame_contact: contact may have put x far from where it was without."""
        self.newton.keep(self.slopes(x))

    @property
    def _inverse_slopes(self) -> Array:
        """As in FrameKernel."""
        return self.newton.whole

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
        heat += self._heat(r̂, q) - h * rubbed
        motion = self._moving_with(q, self._shape_at(q, r), turn.after, frame.turning, e)
        if self.ties is not None:
            self.ties.place(frame.position, turn.after, q)
        heat += self._step_residual(in_frame(turn, contact))[1]
        self._finish(contact, power, h * supplied, heat)
        self._passed = h, x
        self.frame, self._now_before, self._now = frame, self._now, motion
        return self._arrive(e, r)
