"""Steps of a full-order body that deforms largely and that a rigid base carries, whose motion is given.

The body is stepped in the axes of its base, at whose twists (v, ω) and (v⁺, ω⁺) a step begins and ends. With y = X + q
the balance of the displacements has beside that of a body at rest (`residuals.py`), as in `fem/frame_step.py`,

    [ω⁺×M y⁺ - ω×M y]/h + ½ [ω×M r⁺ + ω⁺×M r] + ½ [ω×(ω⁺×M ŷ) + ω⁺×(ω×M ŷ)] + M 1 [Δv/h + ½ (ω×v⁺ + ω⁺×v)]

which is linear in the mid-step rate r̂; and the base puts on the body what its momenta change by, less other forces.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.carried_terms import CarriedTerms, CarriedTies
from fenics_rom.fem.finite_strain.model import ExternalForce, FiniteStrainModel, multiply
from fenics_rom.fem.finite_strain.residuals import InFrame
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.fem.frame_readings import ReadInWorldAxes
from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.fem.points_of_step import CarriedPoints, PointsOfStep
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_fit import misfit, misfit_message
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion
from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import ZERO, rotation_matrix, rotation_of
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput, StepResult
from fenics_rom.system.system import System


class CarriedFiniteStrainStepper(ReadInWorldAxes, FiniteStrainStepper):
    """Arguments and attributes as in FiniteStrainStepper; x and v are displacement and its rate in the frame.

    Attributes:
        wrench: force (N) and torque about the origin (N m) of the base on the body in the last step, in world axes.
    """

    def __init__(
        self,
        system: System,
        model: FiniteStrainModel,
        dt: float,
        environment: ActiveEnvironment,
        *,
        ledger: bool = True,
    ):
        assert system.moving_frame is not None
        self._frame, self._environment = system.moving_frame, environment
        self._body = NodalFrame(replace(system, moving_frame=replace(self._frame, geometric_stiffness=None)))
        still = BaseState(self._frame.origin, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
        self._base = self._end = environment.base_at(0.0) or still
        self._tied: CarriedTies | None = None  # in the part that is taken
        self.wrench, self._mean_wrench = np.zeros((2, 3)), np.zeros((2, 3))
        self._misfit = 0.0, 0.0
        super().__init__(system, model, dt, environment, ledger=ledger)
        self.kind, self.reason = MOVING_FRAME, "a rigid base carries the body, which deforms largely"

    @property
    def pose(self) -> BaseState:
        """Where the base is and how it moves, in world axes."""
        return self._base

    @property
    def energy(self) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        now = self._motion(self._base)
        if not self._has_inertia:
            return super().energy + self._beyond_springs(now)
        spring = self._model.dot(self.x, multiply(self._model.spring, self.x)) / 2
        return super().energy - spring + self._body.energy(now) - self._body.dot(now.r, now.Mr) / 2

    @property
    def momentum(self) -> tuple[Array, Array]:
        """Linear, N s, and angular about the frame's origin, N m s, in world axes."""
        now = self._motion(self._base)
        P, L = self._body.momenta(now)
        return now.R @ P, now.R @ L

    def place(self, pose: BaseState) -> None:
        """Puts the base, with the shape that the body has."""
        self._base = pose

    def step(self, inputs: StepInput) -> StepResult:
        """As in FiniteStrainStepper."""
        start, self._mean_wrench = self._base, np.zeros((2, 3))
        result = super().step(inputs)
        self.wrench, turn = self._mean_wrench, self._geometry(start, self._base, self.dt)
        v̂ = (rotation_matrix(start.rotation).T @ start.velocity + turn.end.T @ self._base.velocity) / 2
        gaps = misfit(start, self._base, turn, vector(v̂), self.dt, self._body.size)
        self._misfit = max(self._misfit[0], gaps[0]), max(self._misfit[1], gaps[1])
        return result

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        return *super().diagnostics(), *misfit_message(*self._misfit)

    def close(self) -> None:
        """Gives the memory back."""
        super().close()
        self._body.close()

    def _state(self) -> tuple[Any, ...]:
        return *super()._state(), self._base, self.wrench

    def _restore(self, state: tuple[Any, ...]) -> None:
        *others, self._base, self.wrench = state
        super()._restore(tuple(others))

    def _dead_force(self, u: Array) -> Array:
        """As in FiniteStrainStepper, of loads as the base sees them in the middle of a step, or at rest at its end."""
        self._loads = FrameLoads.of(self.system, self.contact_mode, self.input_matrix, u, self._environment)
        end = self._base_at(self.time + self.dt)
        turn = self._geometry(self._base if self._has_inertia else end, end, self.dt)
        force = self._loads.on_nodes(self._body, turn)
        if not self._has_inertia and (ties := self._body.ties) is not None:
            rest = self._motion(end)
            pull = ties.pull(rest._replace(q=np.zeros_like(rest.q)))[0]
            force = force - ties.of_here(pull @ rest.R)
        return np.ascontiguousarray(force).reshape(-1, 1)

    def _beyond_springs(self, now: Motion) -> float:
        """What springs to the ground store at their true places, less ½ qᵀK_s q, J."""
        if self._body.ties is None:
            return 0.0
        return self._body.ties.pull(now)[1] - self._model.dot(self.x, multiply(self._model.spring, self.x)) / 2

    def _points_in(self, h: float, at_rest: bool) -> PointsOfStep | None:
        """As in FiniteStrainStepper."""
        if self.interface is None:
            return None
        start, end = self._motion(self._base), self._motion(self._end)
        turn = self._geometry(self._base, self._end, h)
        twist = None if at_rest else ((start.v + end.v) / 2, (start.ω + end.ω) / 2)
        return CarriedPoints(self.interface, self._frame.origin, start, end.position, turn, twist, h)

    def _part(
        self,
        done: float,
        share: float,
        load: ExternalForce,
        u: Array,
        given: Array,
        obstacles: ObstacleMotion | None,
        missing: Array | None,
    ) -> int:
        """As in FiniteStrainStepper."""
        h, end, now = share * self.dt, self._base_at(self.time + (done + share) * self.dt), self._motion(self._base)
        self._end, turn, before = end, self._geometry(self._base, end, h), self.contact
        beyond = 0.0 if missing is None else self._beyond_springs(now)
        if missing is None:
            base, body = self._motion(end), self._body
            if body.ties is not None:
                self._tied = CarriedTies(body.ties, now, turn, base.position, h, body.mass)
            terms = CarriedTerms(self._model.mass, body, now, (base.v, base.ω), self._tied, h)
            self._frame_terms = InFrame(carried=terms)
        iterations = super()._part(done, share, load, u, given, obstacles, missing)
        after = self._motion(end)
        if missing is None:
            wrench = self._book_motion(now, after, turn, h)
        else:
            wrench = self._wrench_of(after, after, self._geometry(end, end, h), np.zeros((2, 3)))
            self._book_at_rest(before, h, self._beyond_springs(after) - beyond)
        self._base, self._mean_wrench = end, self._mean_wrench + share * wrench
        return iterations

    def _book_motion(self, now: Motion, after: Motion, turn: Geometry, h: float) -> Array:
        """Books what the base supplies in a part of h, s, and gives its wrench (2, 3) in world axes."""
        body, v̂, ω̂, (trial,) = self._body, (now.v + after.v) / 2, (now.ω + after.ω) / 2, self._trial
        (P, L), (P_end, L_end) = body.momenta(now), body.momenta(after)
        inertial = (P_end - P) / h + np.cross(ω̂, P + P_end) / 2
        turning = (L_end - L) / h + np.cross(ω̂, L + L_end) / 2 + np.cross(v̂, P + P_end) / 2
        supplied, heat = float(inertial @ v̂ + turning @ ω̂), 0.0
        if self.contact is not None and self._points is not None:  # contact is booked with all that it does
            power = float((self.contact.forces * self._points.velocities(trial.v)).sum())
            supplied -= power - self._model.dot(self._points.force(self.contact), trial.v)
        if self._tied is not None and body.ties is not None:  # the base does what ties do not do on the shape
            r̂ = trial.v.reshape(-1, 3)
            tied = self._tied.at(r̂)
            supplied, heat = supplied + body.dot(tied.push.modal, r̂) - tied.power, body.ties.heat(tied.rates)
        if self.ledger is not None:
            self.ledger.book(supplied=h * supplied, dissipated=h * heat)
        return self._wrench_of(now, after, turn, np.array([inertial, turning]))

    def _book_at_rest(self, before: ContactSolution | None, h: float, beyond: float) -> None:
        """Books what the base supplies between two equilibria.

        Contact in the first one was `before`; what springs store grew `beyond` that of K_s, J.
        """
        (trial,), points, supplied = self._trial, self._points, beyond
        if self.ledger is None:
            return
        if points is not None:
            velocities = points.velocities(trial.v)
            for contact, force in ((before, points.force_before(before)), (self.contact, points.force(self.contact))):
                if contact is not None:
                    power = float((contact.forces * velocities).sum())
                    supplied -= h / 2 * (power - self._model.dot(force, trial.v))
        self.ledger.book(supplied=supplied)

    def _wrench_of(self, now: Motion, after: Motion, turn: Geometry, inertial: Array) -> Array:
        """Of the base in world axes (2, 3), which gives the body its inertial force and torque (2, 3) in the frame."""
        body, (trial,) = self._body, self._trial
        mean = (turn.start + turn.end) / 2
        following = mean @ self._of_followers().reshape(2, 3).T
        force = self._loads.resultant(body, turn) + following[:, 0]
        torque = self._loads.torque(body, turn, now, after) + following[:, 1]
        pushes = list[Push]()
        if self.contact is not None and isinstance(self._points, CarriedPoints):
            pushes.append(self._points.push(self.contact, trial.v))
        if self._tied is not None:
            pushes.append(self._tied.at(trial.v.reshape(-1, 3)).push)
        elif body.ties is not None:
            pull, arms = body.ties.pull(after)[0], body.ties.places(after) @ after.R.T
            pushes.append(Push.of(-pull, turn, arms, lambda inside: inside))
        for push in pushes:
            force, torque = force + push.force, torque + push.torque
        seen = inertial - np.array([force, torque]) @ turn.middle
        world: Array = seen @ mean.T
        return world

    def _of_followers(self) -> Array:
        """Force and torque about the origin (6,) of what followed the body, on all of its nodes, in the frame."""
        (trial,) = self._trial
        u, total = trial.u, np.zeros(6)
        arms = self.system.body.nodes - self._frame.origin + u
        for value, follower in trial.external.following:
            forces = value * follower.force(u)
            total += np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])
        return total

    def _motion(self, base: BaseState) -> Motion:
        """The body with a base."""
        R, q, r = rotation_matrix(base.rotation), self.x.reshape(-1, 3), self.v.reshape(-1, 3)
        Mq, Mr = self._body.inert(q), self._body.inert(r)
        twist = base.velocity @ R, base.angular_velocity @ R
        return Motion(r, Mr, q, Mq, np.zeros((1, *q.shape)), R, np.array(base.position), *twist)

    def _geometry(self, start: BaseState, end: BaseState, h: float) -> Geometry:
        """How the base turns from one to the other in h, s; not at all where they are the same."""
        turn = ZERO
        if start is not end:
            ω = start.angular_velocity @ rotation_matrix(start.rotation)
            turn = vector(h / 2 * (ω + end.angular_velocity @ rotation_matrix(end.rotation)))
        return Geometry(rotation_of(*start.rotation.tolist()), rotation_of(*end.rotation.tolist()), turn)

    def _base_at(self, time: float) -> BaseState:
        """Where the base is to be at a time, s; it stands still where nothing says."""
        base = self._environment.base_at(time)
        return self._base._replace(velocity=np.zeros(3), angular_velocity=np.zeros(3)) if base is None else base
