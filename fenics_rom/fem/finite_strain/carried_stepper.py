"""Steps of a full-order body that deforms largely and that a rigid base carries, whose motion is given.

The body is stepped in the axes of its base, at whose twists (v, ω) and (v⁺, ω⁺) a step begins and ends. With y = X + q
the balance of the displacements has beside that of a body at rest (`residuals.py`), as in `fem/frame_step.py`,

    [ω⁺×M y⁺ - ω×M y]/h + ½ [ω×M r⁺ + ω⁺×M r] + ½ [ω×(ω⁺×M ŷ) + ω⁺×(ω×M ŷ)] + M 1 [Δv/h + ½ (ω×v⁺ + ω⁺×v)]

which is linear in the mid-step rate r̂; and the base puts on the body what its momenta change by, less other forces.
"""

from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.finite_strain.carried_terms import CarriedTerms, CarriedTies
from fenics_rom.fem.finite_strain.follower_loads import SupportPush
from fenics_rom.fem.finite_strain.model import ExternalForce, FiniteStrainModel, multiply
from fenics_rom.fem.finite_strain.residuals import InFrame
from fenics_rom.fem.finite_strain.stepper import FiniteStrainStepper
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.fem.on_base import OnBase
from fenics_rom.fem.points_of_step import CarriedPoints
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import ZERO
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput
from fenics_rom.system.system import System


class CarriedFiniteStrainStepper(OnBase, FiniteStrainStepper):
    """Arguments and attributes as in FiniteStrainStepper and OnBase."""

    _points: CarriedPoints | None

    def __init__(
        self,
        system: System,
        model: FiniteStrainModel,
        dt: float,
        environment: ActiveEnvironment,
        *,
        ledger: bool = True,
    ):
        self._put_on_base(system, environment)
        self._tied: CarriedTies | None = None  # in the part that is taken
        self._mean_wrench = self.wrench
        super().__init__(system, model, dt, environment, ledger=ledger)
        self.kind, self.reason = MOVING_FRAME, "a rigid base carries the body, which deforms largely"

    @property
    def energy(self) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        now = self._motion(self._base)
        if not self._has_inertia:
            return super().energy + self._beyond_springs(now)
        spring = self._model.dot(self.x, multiply(self._model.spring, self.x)) / 2
        return super().energy - spring + self._body.energy(now) - self._body.dot(now.r, now.Mr) / 2

    def step(self, inputs: StepInput) -> float:
        """As in FiniteStrainStepper."""
        start, self._mean_wrench = self._base, np.zeros((2, 3))
        energy = super().step(inputs)
        self.wrench = self._mean_wrench
        self._look_at_base(start)
        return energy

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
        """As in FiniteStrainStepper."""
        return self._take_loads(u, self._base_at(self.time + self.dt))

    def _points_in(self, h: float, at_rest: bool) -> CarriedPoints | None:
        """As in FiniteStrainStepper."""
        return self._points_on_base(h, at_rest)

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
            terms = CarriedTerms(body, now, (base.v, base.ω), self._tied, h)
            self._frame_terms = InFrame(carried=terms)
        iterations, (trial,) = super()._part(done, share, load, u, given, obstacles, missing), self._trial
        after = self._motion(end)
        if missing is None:
            wrench = self._book_motion(now, after, turn, h)
        else:
            turn = self._geometry(end, end, h)
            others = [self._of_followers(turn), *self._pulled_by_springs(after, turn)]
            wrench = self._wrench_of((after, after), turn, np.zeros((2, 3)), others, trial.v)
            if self.ledger is not None:
                more = self._beyond_springs(after) - beyond
                self.ledger.book(supplied=self._supplied_at_rest(before, trial.v, h, more))
        self._base, self._mean_wrench = end, self._mean_wrench + share * wrench
        return iterations

    def _book_motion(self, now: Motion, after: Motion, turn: Geometry, h: float) -> Array:
        """Books what the base supplies in a part of h, s, and gives its wrench (2, 3) in world axes."""
        body, v̂, ω̂, (trial,) = self._body, (now.v + after.v) / 2, (now.ω + after.ω) / 2, self._trial
        (P, L), (P_end, L_end) = body.momenta(now), body.momenta(after)
        inertial = (P_end - P) / h + np.cross(ω̂, P + P_end) / 2
        turning = (L_end - L) / h + np.cross(ω̂, L + L_end) / 2 + np.cross(v̂, P + P_end) / 2
        supplied, heat, others = float(inertial @ v̂ + turning @ ω̂), 0.0, [self._of_followers(turn)]
        if self.contact is not None and self._points is not None:  # contact is booked with all that it does
            power = float((self.contact.forces * self._points.velocities(trial.v)).sum())
            supplied -= power - self._model.dot(self._points.force(self.contact), trial.v)
        if self._tied is not None and body.ties is not None:  # the base does what ties do not do on the shape
            r̂ = body.nodal(trial.v)
            tied = self._tied.at(r̂)
            supplied, heat = supplied + body.dot(tied.push.modal, r̂) - tied.power, body.ties.heat(tied.rates)
            others.append(tied.push)
        if self.ledger is not None:
            self.ledger.book(supplied=h * supplied, dissipated=h * heat)
        return self._wrench_of((now, after), turn, np.array([inertial, turning]), others, trial.v)

    def _of_followers(self, turn: Geometry) -> Push:
        """What followed the body does on all of its nodes, but for `modal`; the base bears what drives supports."""
        (trial,) = self._trial
        u, total = trial.u, np.zeros(6)
        arms = self.system.body.nodes - self._frame.origin + u
        following = (each for each in trial.external.following if not isinstance(each[1], SupportPush))
        for value, follower in following:
            forces = value * follower.force(u)
            total += np.concatenate([forces.sum(axis=0), np.cross(arms, forces).sum(axis=0)])
        force, torque = total.reshape(2, 3) @ (turn.start + turn.end).T / 2
        return Push(vector(force), vector(torque), ZERO, np.zeros(0))
