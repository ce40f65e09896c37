"""Equilibria of a body that a rigid base carries: those of one that is held, in the axes of the base.

The base is where it is to be at the end of a step, so loads are as it sees them there, and points of the body at
x = p + R y, y = X + u. Between two equilibria they go by x⁺ - x = h ŝ, so that contact is found for R⁺ W R⁺ᵀ and

    ŝ = (p⁺ + R⁺ y - p - R y)/h + R⁺ û

and its forces are R⁺ᵀ f to the body. What they do beyond that, the base supplies. Springs to the ground are the same in
all axes, and what they pull the unbent body with is a load.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.contact import ContactSolution, ContactWork, ObstacleMotion
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import Geometry, Push, turned_operator, vector
from fenics_rom.mechanics.frame_motion import ZERO, Rotation, added, cross, rotation_matrix, rotation_of
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.steppers.carried_base import frame_state
from fenics_rom.runtime.steppers.frame_kernel import FrameState
from fenics_rom.runtime.steppers.frame_loads import FrameLoads
from fenics_rom.runtime.steppers.frame_watch import FrameWatch
from fenics_rom.runtime.steppers.ground_ties import GroundTies, TieForces
from fenics_rom.runtime.steppers.kernel import BookedKernel

if TYPE_CHECKING:
    from fenics_rom.mechanics.active_environment import ActiveEnvironment
    from fenics_rom.mechanics.actuator_forces import ActuatorForces
    from fenics_rom.runtime.steppers.acts.following import FollowingLoads
    from fenics_rom.runtime.steppers.contact_interface import ContactInterface
    from fenics_rom.runtime.steppers.residual_motion import ResidualMotion

Wrench = tuple[tuple[float, float, float], tuple[float, float, float]]


class OnBase(BookedKernel):
    """A kernel of equilibria on a base; `put_on_base` comes after its making.

    Attributes:
        frame: where the base is; set it, then `resume`.
        base: where it is to be at the end of the next step; None: it stands still.
        ties: springs to the ground; None where there are none.
        wrench: force (N) and torque about the frame's origin (N m) of the base in the last step, in world axes.
        elastic: as in PartedKernel.
        act_by: of the kernel: has from now on these forces of inputs of 1 whose direction stays, (m, p), and one
            without inputs, (m,).
    """

    elastic = None
    base: BaseState | None = None
    act_by: Callable[[Array, Array], None]

    def put_on_base(
        self, frame: MovingFrame, loads: FrameLoads, watch: FrameWatch, following: "FollowingLoads | None"
    ) -> None:
        """Of a contact mode its frame, loads, watch, and the loads that follow the body."""
        self._constants, self._of_frame, self._bent, self._rims = frame, loads, watch, following
        self._touching = self._interface
        self._turned: tuple[Array, Rotation, Array] | None = None  # W, R⁺ and the operator of these
        self.ties = None if frame.springs is None else GroundTies(frame)
        self._resistance, self._beyond = springs_within(frame), 0.0
        self.notes |= watch.notes
        self.frame = self._frame_before = FrameState(vector(frame.origin), (1.0, 0.0, 0.0, 0.0), ZERO, ZERO)
        self._at_rest, self._wrench = self.frame, cast("Wrench | partial[Wrench]", (ZERO, ZERO))
        self._wrench_before = self._wrench
        self.resume(np.empty(0))

    @property
    def model(self) -> Any:
        """Of the contact mode."""
        return self._model

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
    def momenta(self) -> Wrench:
        """None without inertia."""
        return ZERO, ZERO

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

    def check_differentiable(self) -> None:
        """As in Kernel."""
        refused = {"contact": self._touching is not None, "springs to the ground": self.ties is not None}
        for what, there in refused.items():
            if there:
                raise StructureError(f"{what} of a body without inertia on a base: its steps are not differentiated")
        super().check_differentiable()

    def begin(self) -> None:
        """Puts the base where it is at rest."""
        self.place(self._at_rest)

    def place(self, frame: FrameState) -> None:
        """Puts the base where it is to be."""
        self.frame = frame
        self.resume(self.auxiliary)

    def resume(self, auxiliary: Array) -> None:
        """As in Kernel."""
        super().resume(auxiliary)
        self._store_in_springs()

    def rollback(self) -> None:
        """As in Kernel."""
        super().rollback()
        self.frame, self._wrench = self._frame_before, self._wrench_before
        self._store_in_springs()

    def point_displacement(self) -> Array:
        """As in Kernel, in world axes."""
        assert self._touching is not None
        rest, R = self._touching.points.coordinates, rotation_matrix(self.frame.rotation)
        places: Array = (rest - self._constants.origin + super().point_displacement()).dot(R.T) + self.frame.position
        return places - rest

    @property
    def touched(self) -> Array:
        """As in BookedKernel, in world axes."""
        seen: Any = self._interface
        touched: Array = seen.velocities(super().touched, self.h)
        return touched

    def step(self, u: Array, obstacles: ObstacleMotion | None = None) -> float:
        """As in Kernel; to `base`."""
        start = self.frame
        end = start._replace(velocity=ZERO, turning=ZERO) if self.base is None else frame_state(self.base)
        R = rotation_of(*end.rotation)
        turn = Geometry(R, R, ZERO)
        standing = np.zeros(1)
        if self.ties is not None:
            self.ties.place(end.position, R, np.zeros(self._model.order))
            standing = self._pulled(turn).push().modal
        self.act_by(self._of_frame.columns_of(turn, self._constants), standing)
        if self._touching is not None:
            self._interface = SeenFromBase(self, self._touching, start, end)  # type: ignore[assignment]
        beyond, wrench = self._beyond, self._wrench
        super().step(u, obstacles)
        self._frame_before, self._wrench_before, self.frame = start, wrench, end
        self._store_in_springs()
        if self._beyond != beyond:
            self._owed[-1] = self._owed[-1]._replace(supplied=self._owed[-1].supplied + self._beyond - beyond)
        acting = u
        if self._actuators is not None:
            acting, _ = self._actuators.split(u)
            acting[self._actuators.columns] = self.reactions
        tied = None if self.ties is None else self._pulled(turn).push()
        self._wrench = partial(self._wrench_of, turn, acting, self._coordinates().copy(), self._pushed_from(), tied)
        self._bent.look(self._e, float(self._e.dot(self._e)), ZERO, self.notes)
        return 2 * self.energy

    def turned_operator(self, W: Array, end: Rotation) -> Array:
        """R⁺ W R⁺ᵀ, the same array as long as both are the same."""
        if self._turned is None or self._turned[0] is not W or self._turned[1] != end:
            R = np.array(end)
            self._turned = W, end, turned_operator(R, W, R)
        return self._turned[2]

    def _with_carried_energy(self, energy: float) -> float:
        """As in BookedKernel, with what springs store at their true places."""
        return super()._with_carried_energy(energy) + self._beyond

    def _store_in_springs(self) -> None:
        """Notes what they store beyond ½ qᵀK_s q, J."""
        if self.ties is not None:
            q = self._coordinates()
            self.ties.place(self.frame.position, rotation_of(*self.frame.rotation), q)
            self._beyond = self.ties.placed.stored - float(q.dot(self._resistance).dot(q)) / 2

    def _pulled(self, turn: Geometry) -> TieForces:
        """What springs do where they are placed."""
        assert self.ties is not None
        placed = self.ties.placed
        return TieForces(placed, turn, 0.0, -placed.pull, np.zeros((3, 7)), np.zeros(len(placed.q)))

    def _pushed_from(self) -> tuple[Array, Array] | None:
        """Of contact, places from the origin (P, 3) in the frame and forces there (P, 3)."""
        if self.contact is None or self._touching is None:
            return None
        return (
            self._touching.points.coordinates - self._constants.origin + super().point_displacement(),
            self.contact.forces,
        )

    def _wrench_of(
        self, turn: Geometry, u: Array, q: Array, pushed: tuple[Array, Array] | None, tied: Push | None
    ) -> Wrench:
        """Of the base, which bears all else that acts at q (m,) under u (p,)."""
        frame, forces = self._constants, self._of_frame.at(u)
        force, torque = forces.force, forces.torque
        if forces.torque_by_shape is not None:
            torque = added(torque, 1.0, vector(forces.torque_by_shape.dot(q)))
        if forces.acceleration != ZERO:
            g, moment = turn.seen(forces.acceleration), vector(frame.first_moment + frame.moment_modes.dot(q))
            force, torque = added(force, frame.mass, g), added(torque, 1.0, cross(moment, g))
        if self._rims is not None and self._rims.rims:
            wrench = self._rims.wrench(u, q, frame.origin)
            force, torque = added(force, 1.0, vector(wrench[:3])), added(torque, 1.0, vector(wrench[3:]))
        if pushed is not None:
            force = added(force, 1.0, vector(pushed[1].sum(axis=0)))
            torque = added(torque, 1.0, vector(np.cross(*pushed).sum(axis=0)))
        others = [] if tied is None else [tied]
        if forces.at_points is not None:
            points = self._of_frame.points
            others.append(points.push(forces.at_points, turn, (points.rest + points.moved(q)).dot(turn.end.T)))
        for push in others:
            force, torque = added(force, 1.0, turn.seen(push.force)), added(torque, 1.0, push.turning)
        return turn.mean(added(ZERO, -1.0, force)), turn.mean(added(ZERO, -1.0, torque))


class SeenFromBase:
    """A ContactInterface as the kernel sees it in a step in which the base goes from a start to an end."""

    def __init__(self, kernel: OnBase, interface: "ContactInterface", start: FrameState, end: FrameState):
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


def resting_kernel(
    rom: Rom,
    contact: str,
    model: ContactModel,
    environment: "ActiveEnvironment",
    interface: "ContactInterface | None",
    ledger: EnergyLedger | None,
    residual: "ResidualMotion | None",
    actuators: "ActuatorForces | None",
) -> OnBase:
    """What finds equilibria of a carried body in a contact mode; arguments as in `moving_frame_stepper`."""
    frame, following = rom.moving_frame, cast("FollowingLoads | None", None)
    assert frame is not None
    kernel: Any
    if rom.deformation is not None:
        from fenics_rom.runtime.steppers.body_parts import parts_of
        from fenics_rom.runtime.steppers.equilibrium import Equilibrium

        springs = springs_within(frame.of_mode(model.coordinates))
        rom = replace(rom, deformation=replace(rom.deformation, springs=springs))
        parts = parts_of(rom, contact, model, "equilibrium", actuators, None, interface)
        kernel, following = on_base(Equilibrium)(rom, contact, ledger, interface, residual, parts), parts.following
    else:
        from fenics_rom.runtime.steppers.quasi_static import QuasiStatic

        model = with_springs(model, springs_within(frame.of_mode(model.coordinates)))
        kernel = on_base(QuasiStatic)(model, ledger, np.empty(0), interface, actuators, residual)
    of_mode = frame.of_mode(model.coordinates)
    places = ([], []) if following is None else following.places
    loads = FrameLoads(rom, contact, model, frame, environment.environment, places)
    kernel.put_on_base(of_mode, loads, FrameWatch(rom, model, "full"), following)
    made: OnBase = kernel
    return made


def on_base(kernel: type[BookedKernel]) -> type[Any]:
    """A kernel of equilibria, on a base."""
    return type(f"{kernel.__name__}OnBase", (OnBase, kernel), {})


def turned(contact: ContactSolution | None, R: Array) -> ContactSolution | None:
    """The same with vectors v as Rᵀv."""
    if contact is None:
        return None
    forces, pairs, normals = contact.forces.dot(R), contact.pair_forces.dot(R), contact.normals.dot(R)
    return contact._replace(forces=forces, pair_forces=pairs, normals=normals)


def with_springs(model: ContactModel, springs: Array) -> ContactModel:
    """The same with springs (m, m) in its stiffness."""
    if not springs.any():
        return model
    γ, U = np.linalg.eigh(np.diag(model.eigenvalues) + springs)
    inputs, coordinates = U.T.dot(model.inputs), model.coordinates.dot(U)
    turned = replace(model, eigenvalues=γ, inputs=inputs, coordinates=coordinates, left_inverse=None)
    return replace(turned, directions=np.eye(len(γ)), damping=np.zeros(len(γ)))


def springs_within(frame: MovingFrame) -> Array:
    """VᵀK_s V (m, m) of springs to the ground on the coordinates of a frame's contact mode, 1/s²."""
    m = frame.order
    if frame.springs is None:
        return np.zeros((m, m))
    resistance: Array = np.einsum("aiaj->ij", frame.springs[4:, 4:].reshape(3, m, 3, m))
    return resistance
