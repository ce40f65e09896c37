"""Equilibria of a body that a rigid base carries: those of one that is held, in the axes of the base.

The base is where it is to be at the end of a step, so loads are as it sees them there, and points of the body at
x = p + R y, y = X + u. Between two equilibria they go by x⁺ - x = h ŝ, so that contact is found for R⁺ W R⁺ᵀ and

    ŝ = (p⁺ + R⁺ y - p - R y)/h + R⁺ û

and its forces are R⁺ᵀ f to the body. What they do beyond that, the base supplies. Springs to the ground are the same in
all axes, but for what they pull the unbent body with.
"""

from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import Geometry, Push, turned_operator, vector
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, added, cross, rotation_matrix, rotation_of
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.body_parts import BodyParts
from fenics_rom.runtime.steppers.carried_base import frame_state
from fenics_rom.runtime.steppers.elastic.at_rest import Potential, Tied
from fenics_rom.runtime.steppers.equilibrium import Equilibrium
from fenics_rom.runtime.steppers.frame_loads import FrameLoads
from fenics_rom.runtime.steppers.frame_slopes import Moving
from fenics_rom.runtime.steppers.frame_state import FrameState
from fenics_rom.runtime.steppers.frame_watch import FrameWatch
from fenics_rom.runtime.steppers.ground_ties import GroundTies, TieForces

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.held_part import HeldPart
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion
    from fenics_rom.runtime.steppers.resting_part import RestingPart

Wrench = tuple[tuple[float, float, float], tuple[float, float, float]]
AT_REST = (1.0, 0.0, 0.0, 0.0)


class CarriedEquilibrium(Equilibrium):
    """Arguments as in Equilibrium, and what acts.

    Attributes:
        frame: where the base is; set it, then `resume`.
        base: where it is to be at the end of the next step; None: it stands still.
        wrench: force (N) and torque about the frame's origin (N m) of the base in the last step, in world axes.
    """

    base: BaseState | None = None
    momenta: Wrench = ZERO, ZERO  # none without inertia

    def __init__(
        self,
        rom: Rom,
        contact: str,
        model: ContactModel,
        environment: "ActiveEnvironment",
        ledger: EnergyLedger | None,
        interface: "ContactInterface | None",
        residual: "ResidualMotion | None",
        parts: BodyParts,
    ):
        super().__init__(rom, model, ledger, interface, residual, parts)
        frame = rom.moving_frame
        assert frame is not None
        self._constants = frame.of_mode(model.coordinates)
        places = ([], []) if self._following is None else self._following.places
        self._of_frame = FrameLoads(rom, contact, model, frame, environment.environment, places)
        self._bent, self._body = FrameWatch(rom, model, "full"), self.potential
        self.notes |= self._bent.notes
        self._touching = interface
        self._turned: tuple[Array, Rotation, Array] | None = None  # W, R⁺ and the operator of these
        self._ties = None if frame.springs is None else GroundTies(self._constants)
        self._wrench = cast("Wrench | partial[Wrench]", (ZERO, ZERO))
        self.place(FrameState(vector(frame.origin), AT_REST, ZERO, ZERO))
        self._before_step = self.frame, self.potential, self._wrench

    @property
    def wrench(self) -> Wrench:
        """See the class."""
        if isinstance(self._wrench, partial):
            self._wrench = self._wrench()
        return self._wrench

    @wrench.setter
    def wrench(self, wrench: Wrench) -> None:
        self._wrench = wrench

    @property
    def seen_contact(self) -> ContactSolution | None:
        """Contact in the last step, in world axes."""
        return turned(self.contact, rotation_matrix(self.frame.rotation).T)

    @property
    def messages(self) -> tuple[str, ...]:
        """As in Kernel."""
        return *super().messages, *self._bent.messages(self.notes)

    @property
    def distrusted(self) -> bool:
        """As in FrameKernel."""
        return bool(self._bent.messages(self.notes))

    def begin(self) -> None:
        """Puts the base where it is at rest."""
        self.place(FrameState(vector(self._constants.origin), AT_REST, ZERO, ZERO))

    def place(self, frame: FrameState) -> None:
        """Puts the base where it is to be."""
        self.frame = frame
        self.resume(self.auxiliary)

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        super().resume(auxiliary)
        self.potential = self._potential_on(self.frame)

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self.frame, self.potential, self._wrench = self._before_step

    def point_displacement(self) -> Array:
        """As in Kernel, in world axes."""
        assert self._touching is not None
        places: Array = self._arms().dot(rotation_matrix(self.frame.rotation).T) + self.frame.position
        return places - self._touching.points.coordinates

    @property
    def touched(self) -> Array:
        """As in BookedKernel, in world axes."""
        seen: Any = self._interface
        touched: Array = seen.velocities(super().touched, self.h)
        return touched

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; to `base`."""
        start, before, wrench = self.frame, self.potential, self._wrench
        end = start._replace(velocity=ZERO, turning=ZERO) if self.base is None else frame_state(self.base)
        R = rotation_of(*end.rotation)
        turn = Geometry(R, R, ZERO)
        self.loads.dead = self._of_frame.columns_of(turn, self._constants)
        if self._touching is not None:
            self._interface = SeenFromBase(self, self._touching, start, end)  # type: ignore[assignment]
        lifted, self.potential = 0.0, self._potential_on(end)
        if isinstance(before, Tied) and isinstance(self.potential, Tied):
            q = self._coordinates()
            lifted = self.potential.of_springs(q) - before.of_springs(q)
        try:
            twice = super().step(u, obstacles)
        except BaseException:
            self.potential = before
            raise
        self._before_step, self.frame = (start, before, wrench), end
        if lifted:
            self._owed[-1] = self._owed[-1]._replace(supplied=self._owed[-1].supplied + lifted)
        acting, q = self.loads.with_found(u, self.reactions), self._coordinates().copy()
        pushed = None if self.contact is None or self._touching is None else (self._arms(), self.contact.forces)
        self._wrench = partial(self._wrench_of, turn, end, acting, q, pushed)
        self._bent.look(self._e, float(self._e.dot(self._e)), ZERO, self.notes)
        return twice

    def _part_of(self, held: "HeldPart", u: Array, q: Array, after: Array) -> "RestingPart":
        """As in Equilibrium."""
        from fenics_rom.runtime.steppers.resting_part import RestingPart, RestingPoints

        turn = Geometry(rotation_of(*self._before_step[0].rotation), rotation_of(*self.frame.rotation), ZERO)
        end, points = Moving(np.array(self.frame.position), np.zeros(3), np.zeros(3), after, 0 * after), None
        if self._touching is not None and self.contact is not None:
            arms, inside = self._touching.points.coordinates - self._constants.origin, (after - q) / self.h
            places, inside = (arms + q.dot(self._Sᵀ).reshape(-1, 3), inside.dot(self._Sᵀ).reshape(-1, 3))
            if self.residual is not None:
                y = self.residual.carried_before[: 4 * len(q.dot(self._Sᵀ))].reshape(4, -1, 3)[1]
                places, inside = places + y, inside + (self.residual.displacement - y) / self.h
            points = RestingPoints(places, inside, self.contact.forces)
        forces = self._of_frame.at(self.loads.with_found(u, self.reactions))
        return RestingPart(held, turn, end, self._constants, self._of_frame, forces, self._ties, points)

    def follow(self, other: "CarriedEquilibrium", P: Array, u: Array) -> Array:
        """As in FreeFrame."""
        self.frame = other._before_step[0]
        self._go_to_start_of(other, P)
        self._remember()
        self._before_step, self.frame = (self.frame, self.potential, self._wrench), other.frame
        R = rotation_of(*self.frame.rotation)
        self.loads.dead = self._of_frame.columns_of(Geometry(R, R, ZERO), self._constants)
        self.potential, q = self._potential_on(self.frame), P @ other._coordinates()
        self._e[:], self.contact, self.reactions = self._ω * q, other.contact, other.reactions
        self._step_residual(self.contact)
        lack: Array = self.potential.force(q) - self.loads.force(self.loads.without_found(u), q)
        if self._found is not None:
            lack = lack - self._found.columns(q).dot(self.reactions)
        return lack if self.contact is None else lack - self._pushed(self.contact)

    def _potential_on(self, frame: FrameState) -> Potential:
        """What resists the shape on a base that is there."""
        if self._ties is None:
            return self._body
        R = rotation_of(*frame.rotation)
        self._ties.place(frame.position, R, np.zeros(self._model.order))
        pull = self._pulled(Geometry(R, R, ZERO)).modal
        return Tied(self._body, self._ties.within, pull, self._ties.placed.stored)

    def _pulled(self, turn: Geometry) -> Push:
        """What springs do where they are placed."""
        assert self._ties is not None
        placed = self._ties.placed
        return TieForces(placed, turn, 0.0, -placed.pull, np.zeros((3, 7)), np.zeros(len(placed.q))).push()

    def _arms(self) -> Array:
        """Contact points from the origin (P, 3), in the axes of the base."""
        assert self._touching is not None
        arms: Array = self._touching.points.coordinates - self._constants.origin + super().point_displacement()
        return arms

    def turned_operator(self, W: Array, end: Rotation) -> Array:
        """R⁺ W R⁺ᵀ, the same array as long as both are the same."""
        if self._turned is None or self._turned[0] is not W or self._turned[1] != end:
            R = np.array(end)
            self._turned = W, end, turned_operator(R, W, R)
        return self._turned[2]

    def _wrench_of(
        self, turn: Geometry, base: FrameState, u: Array, q: Array, pushed: tuple[Array, Array] | None
    ) -> Wrench:
        """Of the base, which bears all else that acts at q (m,) under u (p,).

        `pushed`: of contact, places from the origin (P, 3) and forces there (P, 3), in the axes of the base.
        """
        frame, forces = self._constants, self._of_frame.at(u)
        force, torque = forces.force, forces.torque
        if forces.torque_by_shape is not None:
            torque = added(torque, 1.0, vector(forces.torque_by_shape.dot(q)))
        if forces.acceleration != ZERO:
            g, moment = turn.seen(forces.acceleration), vector(frame.first_moment + frame.moment_modes.dot(q))
            force, torque = added(force, frame.mass, g), added(torque, 1.0, cross(moment, g))
        if self._following is not None and self._following.rims:
            wrench = self._following.wrench(u, q, frame.origin)
            force, torque = added(force, 1.0, vector(wrench[:3])), added(torque, 1.0, vector(wrench[3:]))
        if pushed is not None:
            force = added(force, 1.0, vector(pushed[1].sum(axis=0)))
            torque = added(torque, 1.0, vector(np.cross(*pushed).sum(axis=0)))
        others = list[Push]()
        if self._ties is not None:
            self._ties.place(base.position, turn.after, q)
            others.append(self._pulled(turn))
        if forces.at_points is not None:
            points = self._of_frame.points
            others.append(points.push(forces.at_points, turn, (points.rest + points.moved(q)).dot(turn.end.T)))
        for push in others:
            force, torque = added(force, 1.0, turn.seen(push.force)), added(torque, 1.0, push.turning)
        return turn.mean(added(ZERO, -1.0, force)), turn.mean(added(ZERO, -1.0, torque))


class SeenFromBase:
    """A ContactInterface as the kernel sees it in a step in which the base goes from a start to an end."""

    def __init__(self, kernel: CarriedEquilibrium, interface: "ContactInterface", start: FrameState, end: FrameState):
        self._kernel, self._interface, self._end = kernel, interface, rotation_of(*end.rotation)
        self._R, self._R_end = rotation_matrix(start.rotation), rotation_matrix(end.rotation)
        self._from, self._to = np.array(start.position), np.array(end.position)
        self._arms = interface.points.coordinates - kernel._constants.origin

    @property
    def solver(self) -> Any:
        """Of the contact law."""
        return self._interface.solver

    @property
    def points(self) -> Any:
        """The contact points."""
        return self._interface.points

    def solve_moved(
        self, motion: Array, delassus: Array, dt: float, obstacles: ObstacleMotion, quasi_static: bool
    ) -> ContactSolution | None:
        """As in ContactInterface, of motion and contact in the axes of the base."""
        self._arms_now = self._arms + motion[0]
        before = self._from + self._arms_now.dot(self._R.T)
        in_world = np.empty(motion.shape)
        in_world[0], in_world[1] = before - self._interface.points.coordinates, 0.0
        in_world[2] = self.velocities(motion[2], dt)
        W = self._kernel.turned_operator(delassus, self._end)
        return turned(self._interface.solve_moved(in_world, W, dt, obstacles, quasi_static), self._R_end)

    def work_at_rest(
        self,
        before: ContactSolution | None,
        after: ContactSolution | None,
        velocity: Array,
        dt: float,
        obstacles: ObstacleMotion,
    ) -> ContactWork:
        """As in ContactInterface; with what contact does on the body beyond its shape, which the base supplies."""
        done = sum(dt / 2 * float((one.forces * velocity).sum()) for one in (before, after) if one is not None)
        seen = turned(before, self._R.T), turned(after, self._R_end.T)
        work = self._interface.work_at_rest(*seen, self.velocities(velocity, dt), dt, obstacles)
        whole = work.supplied - work.contact - work.friction - work.numerical
        return work._replace(supplied=work.supplied + done - whole)

    def velocities(self, inside: Array, dt: float) -> Array:
        """Of the points in world axes (P, 3), by those in the frame."""
        by_base = (self._to - self._from + self._arms_now.dot((self._R_end - self._R).T)) / dt
        velocities: Array = by_base + inside.dot(self._R_end.T)
        return velocities


def turned(contact: ContactSolution | None, R: Array) -> ContactSolution | None:
    """The same with vectors v as Rᵀv."""
    if contact is None:
        return None
    forces, pairs, normals = contact.forces.dot(R), contact.pair_forces.dot(R), contact.normals.dot(R)
    return contact._replace(forces=forces, pair_forces=pairs, normals=normals)
