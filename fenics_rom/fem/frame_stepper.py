"""Full-order steps of a body whose frame moves with it, free or carried by a rigid base whose motion is given.

In a step (`frame_step.py`) with the momenta P and L of `nodal_frame.py` the base puts on the body

    F = ΔP/h + ω̂ × P̂ - R*ᵀ Σ f,    τ = ΔL/h + ω̂ × L̂ + v̂ × P̂ - R*ᵀ Σ a × f

and the energy grows by the work of forces and base less h r̂ᵀD r̂, at any h: that of contact is what its law means, as
points go by how far their velocities say.
"""

from functools import partial
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.fem.frame_readings import ReadInWorldAxes
from fenics_rom.fem.frame_step import FrameStep, ToFind
from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_fit import misfit, misfit_message
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.frame_contact import touch
from fenics_rom.mechanics.frame_geometry import vector
from fenics_rom.mechanics.frame_motion import ZERO, quaternion_of, rotation_matrix
from fenics_rom.mechanics.step import MOVING_FRAME, StepInput
from fenics_rom.system.system import System


class MovingFrameStepper(ReadInWorldAxes):
    """Arguments and attributes as in FullOrderBody; x and v are displacement and its rate in the frame.

    Attributes:
        wrench: force (N) and torque about the origin (N m) of the base on the body in the last step, in world axes;
            None of a free body.

    Raises:
        StepError: the body begins in an obstacle.
    """

    def __init__(self, system: System, dt: float, environment: ActiveEnvironment, *, ledger: bool = True):
        self._body, self._environment = NodalFrame(system, environment.environment.viscoelasticity), environment
        super().__init__(self._body.system, dt, environment, ledger)
        self._frame = self._body.frame
        self.kind = MOVING_FRAME
        self.reason = "a rigid base carries the body" if self._frame.carried else "nothing holds the body"
        self.wrench = np.zeros((2, 3)) if self._frame.carried else None
        self._now = self._body.at_rest()
        self._before: tuple[Any, ...] = ()
        self._misfit = 0.0, 0.0  # how far a base went otherwise than its twists say, at most, m and rad
        if self._frame.carried and (base := environment.base_at(0.0)) is not None:
            self.place(base)
        self.check_start()

    @property
    def energy(self) -> float:
        """Stored, J: of the motion in world axes, and elastic."""
        return self._body.energy(self._now)

    @property
    def pose(self) -> BaseState:
        """Where the frame is and how it moves, in world axes."""
        now = self._now
        return BaseState(now.position, quaternion_of(now.R), now.R @ now.v, now.R @ now.ω)

    @property
    def momentum(self) -> tuple[Array, Array]:
        """Linear, N s, and angular about the frame's origin, N m s, in world axes."""
        P, L = self._body.momenta(self._now)
        return self._now.R @ P, self._now.R @ L

    def place(self, pose: BaseState) -> None:
        """Puts the frame, with the shape that the body has."""
        R = rotation_matrix(pose.rotation)
        v, ω = np.array(pose.velocity) @ R, np.array(pose.angular_velocity) @ R
        self._now = self._now._replace(R=R, position=np.array(pose.position), v=v, ω=ω)

    def set_state(self, x: Array, v: Array) -> None:
        """Local rows of displacement (m) and its rate (m/s) in the frame, (rows here,) each, with relaxed branches."""
        if self._body.branches is not None:
            self._body.branches.resume(np.empty(0))
        self._take(self._body.with_shape(self._now, x, v))

    def step(self, inputs: StepInput) -> float:
        """See Stepper.

        Raises:
            StepError: no step was found; none was taken.
        """
        now, h = self._now, self.dt
        base = self._base_at_end() if self._frame.carried else None
        step = self._begun(inputs.u, base)
        x, contact = step.solve(), None
        if step.found is not None or (self.interface is not None and inputs.obstacles is not None):
            x, contact = touch(step, self.interface, x, inputs.obstacles, None if step.found is None else step)
        turn, rate = step.geometry(x), step.rate(x)
        push, touched = None, None
        if contact is not None:
            arms = step.arms(turn, rate.r)
            push = step.push(contact.forces, turn, arms)
            touched = step.velocities(turn, arms, x) + step.translation(turn, push.force, x)
        after = step.after(x, rate, push)
        if base is None:
            self._body.check_definite(after)
        if base is not None:
            gaps = misfit(self.pose, base, turn, vector((now.v + after.v) / 2), h, self._body.size)
            self._misfit = max(self._misfit[0], gaps[0]), max(self._misfit[1], gaps[1])
        tied = step.tied(x, turn, ZERO if push is None else push.force)
        supplied, wrench = step.balances(turn, after, rate, push, tied)
        sums = None if self.ledger is None else self.ledger.sums
        self._before = now, self.wrench, self.contact, self.reactions, sums
        self.wrench, self.contact, self.reactions, self.time = wrench, contact, step.reactions, self.time + h
        self._take(after)
        drawn, rubbed = self._body.drawn(rate, h), h * self._body.dot(step.rubbed, rate.r)
        if self.ledger is not None:
            heat = 0.0 if tied is None or self._body.ties is None else h * self._body.ties.heat(tied.rates)
            self.ledger.book(supplied=h * supplied - rubbed, dissipated=drawn - rubbed + heat)
            if contact is not None and touched is not None:
                self.ledger.book_contact(*contact.work(touched, h))
        return self.energy

    def rollback(self) -> None:
        """See Stepper."""
        before, self.wrench, self.contact, self.reactions, sums = self._before
        self._take(before)
        if self._body.branches is not None:
            self._body.branches.rollback()
        self.time -= self.dt
        if self.ledger is not None:
            self.ledger.sums = sums

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        return *super().diagnostics(), *misfit_message(*self._misfit)

    def close(self) -> None:
        """Gives the factor's memory back."""
        self._body.close()

    def _begun(self, u: Array, base: BaseState | None) -> FrameStep:
        """A step under inputs u, with the forces that were found in the step before."""
        of_system = self.system, self.contact_mode, self.input_matrix
        loads_of, actuators, found = (
            partial(FrameLoads.of, *of_system, environment=self._environment),
            self.actuators,
            None,
        )
        if actuators is not None:
            columns, (forces, given) = self.input_matrix[:, actuators.columns], actuators.split(u)
            strokes, rates = self._body.inner(columns, np.hstack([self.x, self.v])).T
            found = ToFind(actuators, columns, forces, actuators.targets(given, strokes, rates, self.dt), loads_of)
        loads = loads_of(u) if found is None else found.acting(self.reactions)
        return FrameStep(self._body, self._now, self.dt, loads, base, self.interface, found, self.reactions)

    def _take(self, motion: Motion) -> None:
        self._now, self.x, self.v = motion, motion.q.reshape(-1, 1), motion.r.reshape(-1, 1)

    def _base_at_end(self) -> BaseState:
        """Where the base is to be after the step; it stands still where nothing says."""
        base = self._environment.base_at(self.time + self.dt)
        return self.pose._replace(velocity=np.zeros(3), angular_velocity=np.zeros(3)) if base is None else base
