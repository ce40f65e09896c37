"""Full-order steps of a body whose frame moves with it, free or carried by a rigid base whose motion is given.

Every node has a displacement q and its rate r in the frame; y = X + q, "a ×" is node by node, M commutes with it. Of a
free body q is M-orthogonal to rigid motions. With the velocity v of the origin and ω in the frame's axes, means of a
step ^, ω⁺, r⁺ = 2r̂ - r, q⁺ = q + h r̂ at its end, and K_kl the geometric stiffness of turning,

    [M(r⁺ - r) + ω⁺×M y⁺ - ω×M y]/h + ½ [ω×M r⁺ + ω⁺×M r] + ½ [ω×(ω⁺×M ŷ) + ω⁺×(ω×M ŷ)] + Σ ω_k ω⁺_l K_kl q̂
        + M 1 [Δv/h + ½ (ω×v⁺ + ω⁺×v)] + K q̂ + D r̂ = f
    P = Σ m (v + ω×y) + M r,  L = I ω + Σ M y × r + Σ M y × v
    free:     ΔL/h + ω̂×L̂ = R*ᵀ τ, as the angular momentum R L grows by h τ,   R⁺ = R cay(h ω̂),   R* = R (1 + h/2 ω̂~)
    carried:  F = ΔP/h + ω̂×P̂ - R*ᵀ Σ f,   τ = ΔL/h + ω̂×L̂ + v̂×P̂ - R*ᵀ Σ a×f     is what the base puts on the body

The energy grows by the work of forces and base less h r̂ᵀD r̂, at any h. The same equations as reduced, without a basis
(nodal floating frame: Zwölfer & Gerstmayr, 2021). They are solved by iteration with a factor of 2/h M + D + h/2 K,
which takes the longer the more the body turns in a step.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StepError
from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.full_order_body import FullOrderBody
from fenics_rom.fem.moving_frame import centrifugal_stiffness
from fenics_rom.fem.petsc_matrix import ExtendedMatrix, combination
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_motion import (
    cayley,
    cross_matrix,
    quaternion_of,
    rotation_matrix,
    world_displacement,
    world_velocity,
)
from fenics_rom.mechanics.hyperelastic import VOIGT_INDEX, VOIGT_PAIRS
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput, StepResult
from fenics_rom.system.system import System

TOLERANCE = 1e-15  # of the velocities: what is left of a step's corrections
NO_PROGRESS = 1e-12  # of them: where corrections that shrink no more are round-off
MOST_ITERATIONS = 100
GRAVITY = "gravity"
KINDS = ("turning", "internal", "world")  # of forces: with the frame, from one part of the body to another, prescribed


class _Motion(NamedTuple):
    """The body between two steps, or in the middle of one; fields are those of the nodes here, (n, 3)."""

    r: Array
    Mr: Array
    q: Array
    Mq: Array
    Kq: Array  # (7, n, 3) with the stiffness, and with the six matrices of geometric stiffness
    R: Array  # (3, 3) attitude
    position: Array  # of the origin, m
    v: Array  # of the origin, in the frame's axes, m/s
    ω: Array  # in the frame's axes, rad/s


class _Rate(NamedTuple):
    """Mid-step rate of the displacement, (n, 3), and products with it."""

    r: Array
    Mr: Array
    Kr: Array  # (7, n, 3)
    Dr: Array


class _Forces(NamedTuple):
    """Of one step, on the nodes here, (n, 3), N."""

    turning: Array  # with the frame
    internal: Array  # the part of them whose torque is that of the shape at rest
    world: Array  # in world axes
    on_held: Array  # (H, 3) with the frame, on nodes that the base holds
    world_on_held: Array  # (H, 3) in world axes, on these
    acceleration: Array  # (3,) of gravity, m/s²


class MovingFrameStepper(FullOrderBody):
    """Arguments and attributes as in FullOrderBody; x and v are displacement and its rate in the frame.

    Attributes:
        wrench: force (N) and torque about the origin (N m) of the base on the body in the last step, in world axes;
            None of a free body.

    Raises:
        SceneError: contact, which is solved in reduced models alone.
    """

    def __init__(self, system: System, dt: float, environment: ActiveEnvironment, *, ledger: bool = True):
        acting = environment.environment
        if acting.contact_law is not None:
            raise SceneError(
                f"{acting.source}: effects.contact: is not solved at full order in a moving frame; reduce the scene"
            )
        super().__init__(system, dt, environment, ledger)
        assert system.moving_frame is not None
        self._frame, self._environment = system.moving_frame, environment
        self.kind = MOVING_FRAME
        self.reason = "a rigid base carries the body" if self._frame.carried else "nothing holds the body"
        self._resisting = (ExtendedMatrix(system.stiffness.mat), *centrifugal_stiffness(system))  # type: ignore[attr-defined]
        self._MR = system.mass @ system.rigid
        self._factored: tuple[float, PetscFactor, Array] | None = None
        self._mass, self._first = float(self._frame.moments[0, 0]), self._frame.moments[0, 1:]
        still = np.zeros_like(self._frame.arms)
        self.wrench = np.zeros((2, 3)) if self._frame.carried else None
        resting = np.stack([still] * len(self._resisting))
        self._now = _Motion(
            still, still, still, still, resting, np.eye(3), self._frame.origin, np.zeros(3), np.zeros(3)
        )
        self._before: tuple[Any, ...] = ()
        if self._frame.carried and (base := environment.base_at(0.0)) is not None:
            self.place(base)

    @property
    def energy(self) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        now, (P, L) = self._now, self._momenta(self._now)
        moved = P @ now.v + L @ now.ω + self._sum(now.r, self._frame.mass_times[:, :1]) @ now.v
        return float(moved + self._turned(now) @ now.ω + self._dot(now.r, now.Mr) + self._dot(now.q, now.Kq[0])) / 2

    @property
    def pose(self) -> BaseState:
        """Where the frame is and how it moves, in world axes."""
        now = self._now
        return BaseState(now.position, quaternion_of(now.R), now.R @ now.v, now.R @ now.ω)

    @property
    def momentum(self) -> tuple[Array, Array]:
        """Linear, N s, and angular about the frame's origin, N m s, in world axes."""
        P, L = self._momenta(self._now)
        return self._now.R @ P, self._now.R @ L

    def place(self, pose: BaseState) -> None:
        """Puts the frame, with the shape that the body has."""
        R = rotation_matrix(pose.rotation)
        v, ω = np.array(pose.velocity) @ R, np.array(pose.angular_velocity) @ R
        self._now = self._now._replace(R=R, position=np.array(pose.position), v=v, ω=ω)

    def set_state(self, x: Array, v: Array) -> None:
        """Local rows of displacement (m) and its rate (m/s) in the frame, (rows here,) each."""
        q, r = (self._strained(column.reshape(-1, 3)) for column in (x, v))
        M = self.system.mass
        now = self._now._replace(r=r, Mr=_times(M, r), q=q, Mq=_times(M, q), Kq=self._resisted(q))
        self._take(now)

    def step(self, inputs: StepInput) -> StepResult:
        """See Stepper.

        Raises:
            StepError: no step was found; none was taken.
        """
        now, h = self._now, self.dt
        forces = self._forces_of(inputs.u)
        base = self._base_at_end() if self._frame.carried else None
        after, rate = self._solve(forces, base)
        middle = _middle(now, after, h)
        force, torque, modal = self._external(forces, after, middle)
        supplied, wrench = self._dot(modal, rate.r), None
        if base is None:
            supplied += float(force @ (now.R @ now.v + after.R @ after.v) / 2 + torque @ middle @ (now.ω + after.ω) / 2)
        else:
            v̂, ω̂ = (now.v + after.v) / 2, (now.ω + after.ω) / 2
            (P, L), (P_end, L_end) = self._momenta(now), self._momenta(after)
            inertial = (P_end - P) / h + np.cross(ω̂, P + P_end) / 2
            turning = (L_end - L) / h + np.cross(ω̂, L + L_end) / 2 + np.cross(v̂, P + P_end) / 2
            supplied += float(inertial @ v̂ + turning @ ω̂)
            wrench = np.array([inertial - middle.T @ force, turning - middle.T @ torque]) @ (now.R + after.R).T / 2
        self._before = now, self.wrench, None if self.ledger is None else self.ledger.sums
        self.wrench, self.time = wrench, self.time + h
        self._take(after)
        if self.ledger is not None:
            self.ledger.book(supplied=h * supplied, dissipated=h * self._dot(rate.r, rate.Dr))
        return StepResult(self.energy)

    def rollback(self) -> None:
        """See Stepper."""
        before, self.wrench, sums = self._before
        self._take(before)
        self.time -= self.dt
        if self.ledger is not None:
            self.ledger.sums = sums

    def displacement(self, output: str | None = None) -> Array:
        """As in FullOrderBody, in world axes."""
        rest = self._rest(output)
        return world_displacement(self.pose, self._frame.origin, rest, super().displacement(output))

    def velocity(self, output: str | None = None) -> Array:
        """As in FullOrderBody, in world axes."""
        fields = super().displacement(output), super().velocity(output)
        return world_velocity(self.pose, self._frame.origin, self._rest(output), *fields)

    def close(self) -> None:
        """Gives the factor's memory back."""
        if self._factored is not None:
            self._factored[1].close()
            self._factored = None

    def _rest(self, output: str | None) -> Array:
        return self.system.body.nodes if output is None else self._frame.output_points[output]

    def _take(self, motion: _Motion) -> None:
        self._now, self.x, self.v = motion, motion.q.reshape(-1, 1), motion.r.reshape(-1, 1)

    def _forces_of(self, u: Array) -> _Forces:
        """What acts in a step, of the inputs in the order of their columns."""
        B, system, kinds = self.input_matrix, self.system, list[str]()
        if u.shape != (B.shape[1],):
            raise ValueError
        kinds += ["turning"] * system.contacts[self.contact_mode].shape[1]
        for name, columns in system.actuators.items():
            kinds += ["internal" if name in system.units else "turning"] * columns.shape[1]
        for name, columns in system.loads.items():
            kinds += [name if name == GRAVITY else "world"] * columns.shape[1]
        of = {kind: (B * u * (np.array(kinds) == kind)).sum(axis=1).reshape(-1, 3) for kind in KINDS}
        acceleration = np.zeros(3)
        if GRAVITY in kinds:
            given = self._environment.environment.details("effects.gravity")["acceleration"]
            acceleration = u[kinds.index(GRAVITY)] * np.array(given)
        held = self._frame.forces_on_held(self.contact_mode, len(u)) * u
        of |= {f"{kind} on held": held[:, :, np.array(kinds) == kind].sum(axis=2) for kind in KINDS}
        return _Forces(
            turning=of["turning"] + of["internal"],
            internal=of["internal"],
            world=of["world"],
            on_held=of["turning on held"] + of["internal on held"],
            world_on_held=of["world on held"],
            acceleration=acceleration,
        )

    def _base_at_end(self) -> BaseState:
        """Where the base is to be after the step; it stands still where nothing says."""
        base = self._environment.base_at(self.time + self.dt)
        return self.pose._replace(velocity=np.zeros(3), angular_velocity=np.zeros(3)) if base is None else base

    def _solve(self, forces: _Forces, base: BaseState | None) -> tuple[_Motion, _Rate]:
        """The body after a step, and its mid-step rate."""
        now, h, s = self._now, self.dt, self.system
        rate = _Rate(now.r, now.Mr, self._resisted(now.r), _times(s.damping, now.r))
        size, speed, ω = np.inf, self._speed(now), now.ω
        for _ in range(MOST_ITERATIONS):
            after = self._after(rate, forces, base, ω)
            δ = -self._inverted(self._balance(after, rate, forces))
            Mδ, Δω = _times(s.mass, δ), after.ω - ω
            rate = _Rate(*(rate.r + δ, rate.Mr + Mδ, rate.Kr + self._resisted(δ), rate.Dr + _times(s.damping, δ)))
            before, ω = size, after.ω
            turned = 0.0 if base is not None else float(Δω @ self._inertia(after) @ Δω)
            size = np.sqrt(self._dot(δ, Mδ) + turned)
            scale = max(speed, self._speed(after), np.sqrt(self._dot(rate.r, rate.Mr)))
            if size <= TOLERANCE * scale or (size <= NO_PROGRESS * scale and size > before / 2):
                return self._after(rate, forces, base, ω), rate
            if not np.isfinite(size):
                break
        raise StepError(
            f"no step of {h:g} s was found that turns the body by {h * np.linalg.norm(now.ω):.2g} rad and bends it as "
            "it does; a smaller dt is the cure"
        )

    def _after(self, rate: _Rate, forces: _Forces, base: BaseState | None, ω: Array) -> _Motion:
        """The body after a step at a mid-step rate; `ω` (3,) is what a free body turns by then, as nearly as known."""
        now, h = self._now, self.dt
        q, Mq, Kq = now.q + h * rate.r, now.Mq + h * rate.Mr, now.Kq + h * rate.Kr
        fields = 2 * rate.r - now.r, 2 * rate.Mr - now.Mr, q, Mq, Kq
        if base is not None:
            R = rotation_matrix(base.rotation)
            return _Motion(*fields, R, np.array(base.position), np.array(base.velocity) @ R, base.angular_velocity @ R)
        R = now.R @ cayley(h / 2 * (now.ω + ω))
        after = _Motion(*fields, R, now.position, now.v, ω)
        force, torque, _ = self._external(forces, after, _middle(now, after, h))
        L = (now.R @ self._momenta(now)[1] + h * torque) @ R
        v = now.R @ now.v + h / self._mass * force
        ω = np.linalg.solve(self._inertia(after), L - self._turned(after))
        return after._replace(ω=ω, v=v @ R, position=now.position + h / 2 * (now.R @ now.v + v))

    def _balance(self, after: _Motion, rate: _Rate, forces: _Forces) -> Array:
        """What the equation of the displacements lacks, (n, 3), N."""
        now, h, mX, m1 = self._now, self.dt, self._frame.mass_times[:, 1:], self._frame.mass_times[:, :1]
        ω, ω_end = now.ω, after.ω
        My, My_end = mX + now.Mq, mX + after.Mq
        My_mean, Kq = (My + My_end) / 2, (now.Kq + after.Kq) / 2
        ρ = (after.Mr - now.Mr + np.cross(ω_end, My_end) - np.cross(ω, My)) / h + Kq[0] + rate.Dr
        ρ += (np.cross(ω, after.Mr) + np.cross(ω_end, now.Mr)) / 2
        ρ += (np.cross(ω, np.cross(ω_end, My_mean)) + np.cross(ω_end, np.cross(ω, My_mean))) / 2
        if len(Kq) > 1:
            pairs = np.outer(ω, ω_end) + np.outer(ω_end, ω)
            i, j = VOIGT_PAIRS.T
            ρ += np.tensordot(np.where(i == j, pairs[i, j] / 2, pairs[i, j]), Kq[1:], 1)
        if self._frame.carried:
            ρ += m1 * ((after.v - now.v) / h + (np.cross(ω, after.v) + np.cross(ω_end, now.v)) / 2)
        return ρ - self._external(forces, after, _middle(now, after, h))[2]

    def _external(self, forces: _Forces, after: _Motion, middle: Array) -> tuple[Array, Array, Array]:
        """Force and torque about the origin in world axes, (3,) each, and forces on displacements, (n, 3)."""
        now, X, m1 = self._now, self._frame.arms, self._frame.mass_times[:, :1]
        mean = (now.R + after.R) / 2
        modal = forces.turning + forces.world @ middle + m1 * (forces.acceleration @ middle)
        arms = ((X + now.q) @ now.R.T + (X + after.q) @ after.R.T) / 2
        moment = (now.R @ self._moment(now) + after.R @ self._moment(after)) / 2
        turning = np.cross(X + (now.q + after.q) / 2, forces.turning) - np.cross((now.q + after.q) / 2, forces.internal)
        whole = np.stack([forces.turning, turning, forces.world, np.cross(arms, forces.world)], axis=1)
        force, torque, world, world_torque = self._sum(whole.reshape(len(X), 12)).reshape(4, 3)
        held = self._frame.held_arms
        force, torque = force + forces.on_held.sum(axis=0), torque + np.cross(held, forces.on_held).sum(axis=0)
        world = world + forces.world_on_held.sum(axis=0)
        world_torque = world_torque + np.cross(held @ mean.T, forces.world_on_held).sum(axis=0)
        return (
            mean @ force + world + self._mass * forces.acceleration,
            mean @ torque + world_torque + np.cross(moment, forces.acceleration),
            modal,
        )

    def _moment(self, motion: _Motion) -> Array:
        """Σ m y (3,)."""
        return self._first + self._sum(motion.q, self._frame.mass_times[:, :1])

    def _turned(self, motion: _Motion) -> Array:
        """Σ M y × r (3,): the angular momentum of the rate."""
        return self._sum(np.cross(self._frame.mass_times[:, 1:] + motion.Mq, motion.r))

    def _inertia(self, motion: _Motion) -> Array:
        """I (3, 3), with what geometric stiffness takes from it."""
        inner, q, mX = self.system.algebra.inner, motion.q, self._frame.mass_times[:, 1:]
        half, bent = inner(np.hstack([mX, motion.Mq]), q).reshape(2, 3, 3)
        products = self._frame.moments[1:, 1:] + half + half.T + (bent + bent.T) / 2
        inertia = np.trace(products) * np.eye(3) - products
        if len(motion.Kq) > 1:
            inertia -= np.array([self._dot(q, K) for K in motion.Kq[1:]])[VOIGT_INDEX]
        return inertia

    def _momenta(self, motion: _Motion) -> tuple[Array, Array]:
        """P and L about the origin, in the frame's axes."""
        moment, drift = self._moment(motion), self._sum(motion.r, self._frame.mass_times[:, :1])
        P = self._mass * motion.v + np.cross(motion.ω, moment) + drift
        return P, self._inertia(motion) @ motion.ω + self._turned(motion) + np.cross(moment, motion.v)

    def _speed(self, motion: _Motion) -> float:
        """√(2 J) of what is stored, as the frame has it."""
        stored = self._dot(motion.r, motion.Mr) + self._dot(motion.q, motion.Kq[0])
        return float(np.sqrt(abs(stored + motion.ω @ self._inertia(motion) @ motion.ω)))

    def _sum(self, field: Array, weights: Array | None = None) -> Array:
        """Over all nodes of a field (n, any), (any,)."""
        weights = np.ones((len(field), 1)) if weights is None else weights
        return self.system.algebra.inner(weights, np.ascontiguousarray(field))[0]

    def _dot(self, a: Array, b: Array) -> float:
        return float(self.system.algebra.inner(a.reshape(-1, 1), b.reshape(-1, 1))[0, 0])

    def _resisted(self, field: Array) -> Array:
        """(7, n, 3), or (1, n, 3) where stress does not stiffen."""
        return np.stack([_times(K, field) for K in self._resisting])

    def _strained(self, field: Array) -> Array:
        """Less its rigid motions."""
        R, inner = self.system.rigid, self.system.algebra.inner
        return (field.reshape(-1, 1) - R @ inner(self._MR, field.reshape(-1, 1))).reshape(-1, 3)

    def _inverted(self, ρ: Array) -> Array:
        """A⁻¹ρ of A = 2/h M + D + h/2 K, among displacements without rigid motions."""
        h, s = self.dt, self.system
        if self._factored is None or self._factored[0] != h:
            self.close()
            factor = PetscFactor(combination((2 / h, s.mass), (1.0, s.damping), (h / 2, s.stiffness)), one_by_one=True)
            reactions = factor.solve(self._MR) if self._MR.shape[1] else self._MR
            self._factored = h, factor, reactions
        _, factor, reactions = self._factored
        x = factor.solve(ρ.reshape(-1, 1))
        if reactions.shape[1]:
            inner = s.algebra.inner
            x = x - reactions @ np.linalg.solve(inner(self._MR, reactions), inner(self._MR, x))
        return self._strained(x)


def _middle(now: _Motion, after: _Motion, h: float) -> Array:
    """R* = R (1 + h/2 ω̂~)."""
    middle: Array = now.R @ (np.eye(3) + h / 4 * cross_matrix(now.ω + after.ω))
    return middle


def _times(operator: Any, field: Array) -> Array:
    """Of a field (n, 3)."""
    product: Array = (operator @ field.reshape(-1, 1)).reshape(-1, 3)
    return product
