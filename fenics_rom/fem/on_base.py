"""A full-order body on a rigid base whose motion is given, in whose axes it is stepped: what its steppers share."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from fenics_rom.fem.frame_loads import FrameLoads
from fenics_rom.fem.frame_readings import ReadInWorldAxes
from fenics_rom.fem.nodal_frame import NodalFrame
from fenics_rom.fem.nodal_motion import Motion
from fenics_rom.fem.points_of_step import CarriedPoints
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.base_fit import misfit, misfit_message
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution
from fenics_rom.mechanics.frame_geometry import Geometry, Push, vector
from fenics_rom.mechanics.frame_motion import ZERO, rotation_matrix, rotation_of
from fenics_rom.system.system import System


class OnBase(ReadInWorldAxes):
    """Arguments and attributes as in FullOrderBody; x and v are displacement and its rate in the frame.

    Attributes:
        wrench: force (N) and torque about the origin (N m) of the base on the body in the last step, in world axes.
    """

    _points: CarriedPoints | None
    _loads: FrameLoads

    def _put_on_base(self, system: System, environment: ActiveEnvironment) -> None:
        """Begins at the start of the base's path, before there is anything else."""
        assert system.moving_frame is not None
        self._frame, self._environment = system.moving_frame, environment
        self._body = NodalFrame(replace(system, moving_frame=replace(self._frame, geometric_stiffness=None)))
        still = BaseState(self._frame.origin, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
        self._base = self._end = environment.base_at(0.0) or still
        self.wrench, self._misfit = np.zeros((2, 3)), (0.0, 0.0)

    @property
    def pose(self) -> BaseState:
        """Where the base is and how it moves, in world axes."""
        return self._base

    @property
    def momentum(self) -> tuple[Array, Array]:
        """Linear, N s, and angular about the frame's origin, N m s, in world axes; none without inertia."""
        if not self._has_inertia:
            return np.zeros(3), np.zeros(3)
        now = self._motion(self._base)
        P, L = self._body.momenta(now)
        return now.R @ P, now.R @ L

    def place(self, pose: BaseState) -> None:
        """Puts the base, with the shape that the body has."""
        self._base = pose

    def diagnostics(self) -> tuple[str, ...]:
        """See Stepper."""
        return *super().diagnostics(), *misfit_message(*self._misfit)

    def _look_at_base(self, start: BaseState) -> None:
        """Notes how far the base went otherwise than its twists say, in a step from there."""
        turn = self._geometry(start, self._base, self.dt)
        v̂ = (rotation_matrix(start.rotation).T @ start.velocity + turn.end.T @ self._base.velocity) / 2
        gaps = misfit(start, self._base, turn, vector(v̂), self.dt, self._body.size)
        self._misfit = max(self._misfit[0], gaps[0]), max(self._misfit[1], gaps[1])

    def _take_loads(self, u: Array, end: BaseState) -> Array:
        """Has the loads of an input (p,), as the base sees them in the middle of a step, or at rest at its end.

        Returns:
            What they do to the unknowns, (rows here, 1), N.

        At rest that is with what springs to the ground pull the body with that the base carries there unbent.
        """
        nodal, contact = self._body.system, self.contact_mode
        B = self.input_matrix if nodal is self.system else nodal.input_matrix(contact)
        self._loads = FrameLoads.of(nodal, contact, B, u, self._environment)
        force = self._loads.on_nodes(self._body, self._geometry(self._base if self._has_inertia else end, end, self.dt))
        if not self._has_inertia and (ties := self._body.ties) is not None:
            there = self._motion(end)
            pull = ties.pull(there._replace(q=np.zeros_like(there.q)))[0]
            force = force - ties.of_here(pull @ there.R)
        return self._body.on_unknowns(force)

    def _beyond_springs(self, now: Motion) -> float:
        """What springs to the ground store at their true places, less ½ qᵀK_s q of a base that stands, J."""
        if (ties := self._body.ties) is None:
            return 0.0
        q = ties.of_all(now.q)
        return ties.pull(now)[1] - float((q * (ties.springs @ q)).sum()) / 2

    def _points_on_base(self, h: float, at_rest: bool) -> CarriedPoints | None:
        """The contact points in h, s, in which the base goes to its end; None where nothing can touch."""
        if self.interface is None:
            return None
        start, end = self._motion(self._base), self._motion(self._end)
        turn = self._geometry(self._base, self._end, h)
        twist = None if at_rest else ((start.v + end.v) / 2, (start.ω + end.ω) / 2)
        state = self.x, self.v
        return CarriedPoints(self.interface, self._frame.origin, state, start, end.position, turn, twist, h)

    def _supplied_at_rest(self, before: ContactSolution | None, v: Array, h: float, beyond: float) -> float:
        """What the base supplies in h, s, between two equilibria, J.

        Args:
            before: contact in the first one.
            v: (rows here, 1) by which the body goes to the second one, m/s.
            h: s.
            beyond: what springs store more, as `_beyond_springs`.
        """
        if (points := self._points) is None:
            return beyond
        velocities, inner = points.velocities(v), self.system.algebra.inner
        for contact, force in ((before, points.force_before(before)), (self.contact, points.force(self.contact))):
            if contact is not None:  # contact is booked with all that it does
                power = float((contact.forces * velocities).sum())
                beyond -= h / 2 * (power - float(inner(force, v)[0, 0]))
        return beyond

    def _wrench_of(
        self, motions: tuple[Motion, Motion], turn: Geometry, inertial: Array, others: Sequence[Push], v: Array
    ) -> Array:
        """Of the base in world axes (2, 3).

        Args:
            motions: at the start and the end; at rest twice that at the end.
            turn: how the frame turns between them.
            inertial: force and torque (2, 3) in the frame that the body is to have.
            others: what acts beside loads and contact.
            v: mid-step velocity (rows here, 1).
        """
        force = self._loads.resultant(self._body, turn)
        torque = self._loads.torque(self._body, turn, *motions)
        if self.contact is not None and self._points is not None:
            others = [*others, self._points.push(self.contact, v)]
        for push in others:
            force, torque = force + push.force, torque + push.torque
        seen = inertial - np.array([force, torque]) @ turn.middle
        world: Array = seen @ (turn.start + turn.end).T / 2
        return world

    def _pulled_by_springs(self, at_rest: Motion, turn: Geometry) -> list[Push]:
        """What springs to the ground do at rest."""
        if (ties := self._body.ties) is None:
            return []
        arms = ties.places(at_rest) @ at_rest.R.T
        return [Push.of(-ties.pull(at_rest)[0], turn, arms, lambda inside: inside)]

    def _motion(self, base: BaseState) -> Motion:
        """The body with a base."""
        R, q, r = rotation_matrix(base.rotation), self._body.nodal(self.x), self._body.nodal(self.v)
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
