"""A soft body in a step of several: its own stepper, to which contact hands the forces that are tried.

Held or carried, linear: its points answer forces by an operator that is known when the step begins, exactly, and the
step is taken once, under the forces that were found; a free one is a `FreeSoft`. Of large deformation: the stepper
asks for contact forces as it does among obstacles, and gets those of the try. How its contact points move then, it
tells by itself; a try is a step that is taken back.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, StepError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.mechanics.contact import ObstacleMotion
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.frame_geometry import turned_operator
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.mechanics.points_operator import operator_of
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint
from fenics_rom.runtime.steppers.kernel import BookedKernel
from fenics_rom.world.acting import acting_in_world, touched_surface
from fenics_rom.world.bodies import NO_POINTS, NO_ROWS, Body, Points
from fenics_rom.world.carriers import Carriers
from fenics_rom.world.driven import Driven, mounted
from fenics_rom.world.handed_forces import Handed, HandedForces, handed
from fenics_rom.world.surfaces import nearest_carriers, soft_points

if TYPE_CHECKING:
    from fenics_rom.mechanics.signals import SignalLike

_ONES, KICKED = np.ones(3), (ContactMidpoint, CarriedFrame)  # the latter: what takes impulses of joints
OTHERS = ObstacleMotion(*np.zeros((3, 1, 3)))  # all that touches it, as one obstacle
CLOSED = 1e-6  # of a body's size: so near to the point of a joint one of its own is to be


class Soft(Simulator, Body):
    """A soft body among others.

    Args:
        name: of the body, for messages.
        rom: the reduced model.
        dt: s.
        pose: of its frame: of the axes of a held body, of a free body its centre of mass; of a carried body in the
            carrier's axes, from its centre of mass.
        carrier: what carries it; None: nothing does.
        is_alone: whether there is no other body: then it is a Simulator, with the obstacles of its scene.
        signals: as of a Simulator.
    """

    _solver_of: type[ContactSolver] | None = HandedForces

    def __init__(
        self,
        name: str,
        rom: Rom,
        dt: float,
        pose: BaseState,
        carrier: Driven | None,
        signals: "Mapping[str, SignalLike] | None",
        is_alone: bool = False,
    ):
        acting = rom.environment
        self.touches, self.has_inertia = acting.contact_law is not None, acting.has_inertia
        self._said: tuple[str, ...] = ()
        self.name, self.carrier, self._fixed, self._held_at = name, carrier, not acting.is_moving, pose
        self._at: Array = pose.position if self._fixed else np.zeros(3)
        self._R: Array = rotation_matrix(pose.rotation) if self._fixed else np.eye(3)
        if is_alone:
            self._solver_of = None
            super().__init__(rom, dt, signals=signals)
            assert self.ledger is not None
            self.account = self.ledger
            if not self._fixed:
                self.place(pose)
            return
        if (carrier is not None) != (rom.moving_frame is not None and acting.is_moving and rom.moving_frame.carried):
            needs = "carried: use on = BODY, one that moves as it is told" if carrier is None else "not carried"
            raise SceneError(f"body {name!r}: ROM {rom.name!r} is {needs}")
        try:
            rom, acting, self._said = acting_in_world(rom)
        except SceneError as error:
            raise SceneError(f"body {name!r}: {error}") from error
        super().__init__(rom, dt, scene=acting, signals=signals, errors=False)
        self._untold = "a body of a world with others does not know its error; use one that is alone"
        assert self._stepper.interface is not None
        assert self.ledger is not None
        self.account, self.size = self.ledger, float(np.linalg.norm(np.ptp(self.contact_coordinates, axis=0))) / 2
        self._handed: HandedForces = self._stepper.interface.solver  # type: ignore[assignment]
        if not self._fixed:
            self.place(pose if carrier is None else mounted(carrier.pose, pose))
        elif acting.loads.get("gravity") is not None and not np.allclose(self._R, np.eye(3)):
            raise SceneError(
                f"body {name!r}: ROM {rom.name!r} has gravity along axes of its own: use a rotation of a ROM "
                'without it, or one with frame = "moving"'
            )
        self._given: Mapping[str, Any] = {}
        self.keeps_contact_mode = False  # whoever is near
        self._asked: tuple[Points, Array, Array] | None = None  # points, their velocities without forces, and per force
        self._turned_operator = np.empty((0, 0)), np.empty((0, 0))  # in axes of its own, and in the world's
        self._forces, self._carriers = np.empty((0, 3)), Carriers(len(self.contact_coordinates))
        self._tried, self._is_open, self._twice = False, False, 0.0
        self._power = self._ahead = 0.0  # of forces in the last try, W; how far points may go that nothing holds, m
        self._supplied = 0.0  # by others when the step began, J
        self._went = np.zeros_like(self._handed.points)  # how points moved in the step before, that others touched
        self.surface = touched_surface(rom, self._stepper.interface.points)
        self.contact_triangles = self.surface.triangles

    @property
    def pose(self) -> BaseState:
        """As in Body; of a held body where its axes are."""
        if self._fixed:
            return self._held_at
        pose = super().pose
        assert pose is not None
        return pose

    @property
    def mount(self) -> BaseState:
        """Where its frame is on what carries it, from the centre of mass of that, or a held body's in world axes."""
        return self._held_at

    @property
    def warnings(self) -> tuple[str, ...]:
        """As of a Simulator."""
        return *self._said, *super().warnings

    @property
    def _kernel(self) -> BookedKernel:
        """That of the contact mode, which takes steps under contact forces."""
        kernel = self._stepper.kernel
        assert isinstance(kernel, BookedKernel)
        return kernel

    @property
    def yields(self) -> bool:
        """As in Body."""
        return self._kernel.residual is not None

    def places(self) -> Array:
        """Of the contact points now, (P, 3) in world axes, m."""
        return self.to_world(self._kernel.point_places())

    def point_velocities(self) -> Array:
        """Of the contact points now, (P, 3) in world axes, m/s; without inertia as they went in the step before."""
        return self._kernel.start_velocities().dot(self._R.T) if self.has_inertia else self._went

    def node_places(self) -> Array:
        """Of all nodes now, (N, 3) in world axes, m."""
        return self.to_world(self.rom.nodes + self.displacement())

    def describe_passing(self, radii: Mapping[str, float]) -> str:
        """What to say of rigid bodies with such radii, m, by name, that fit between its points; or nothing."""
        assert self._stepper.interface is not None
        points, passes = self._stepper.interface.points, {} if self.surface.faces else radii
        return points.describe_passing(passes, self.rom.triangles, self.rom.nodes)

    def take(self, inputs: Mapping[str, Any]) -> None:
        """As in Body: as of a Simulator, by name."""
        self._given = inputs

    def begin(self, h: float) -> None:
        """As in Body; in the contact mode that others were nearest to in the step before."""
        if h > 0 and not self.keeps_contact_mode:
            assert self._source is not None
            if self.contact != (nearest := self._source.nearest(self._stepper)):
                self.switch(nearest)
        self._h, self._tried, self._is_open = h, False, h > 0 and self._kernel.answers_linearly
        self._start = self.places()
        self._velocity = self.point_velocities()
        self._handed.reached = np.empty(0, dtype=int)
        if h == 0:
            return
        assert self._source is not None
        if self.carrier is not None:
            self.next_base = mounted(self.carrier.end, self._held_at)
        u = self._by_name((), self._given)
        self.tensions.note(u)
        self._blown = self._with_gas(self._source.full_input(u, self._width))
        inputs = self._with_base(self._source.environment.step_input(self._blown, self.time, self._dt))
        self._inputs = inputs._replace(obstacles=OTHERS)
        self._handed.point_gaps = np.full(len(self.surface.points), np.inf)
        self._open()

    def _open(self) -> None:
        """Opens the step of a body that answers linearly."""
        kernel, inputs, self._asked = self._kernel, self._inputs, None
        if self._is_open:
            if isinstance(kernel, CarriedFrame):
                kernel.base = inputs.base
            self._free = kernel.open(inputs.u).dot(self._R.T)
            if not math.isfinite(self._free.sum()):
                self._leave_finite(inputs.u)
        elif not self.has_inertia:
            self._look_ahead()

    def _look_ahead(self) -> None:
        """Finds how far its points go where nothing holds them, of what no inertia says where it goes."""
        self._ahead, self._supplied = 0.0, self.account.obstacles
        with suppress(StepError):  # what others hold need not have a shape without them
            self.attempt(NO_POINTS, NO_POINTS.arms, NO_POINTS.arms)
            away = self.places() - self._start - self._h * self._velocity
            self._ahead = math.sqrt(largest((away * away).dot(_ONES)))
            self.undo()

    def note_gaps(self, points: Points, gaps: Array) -> None:
        """Takes note of how near others are to points when the step begins, (k,), m."""
        if len(self.rom.contact_models) > 1:
            nodes = points.nodes[: len(gaps)]
            np.minimum.at(self._handed.point_gaps, nodes.ravel(), np.repeat(gaps, nodes.shape[1]))

    def placed(self) -> PlacedSurface:
        """As in Body."""
        return self.surface._replace(points=self._start + self._h / 2 * self._velocity)

    def travel(self) -> tuple[Array, float]:
        """As in Body."""
        whole = self._velocity.sum(axis=0) / len(self._velocity)
        beside = self._velocity - whole
        beside *= beside
        return self._h * whole, 2 * (self._h * math.sqrt(largest(beside.dot(_ONES))) + self._ahead)

    def start_velocities(self, points: Points, places: Array) -> Array:
        """As in Body."""
        self._carriers.turn(points, self._start + self._h / 2 * self._velocity)
        return self._carriers.mean(points, self._velocity)

    def attempt(self, points: Points, places: Array, forces: Array) -> Array:
        """As in Body; places of points that answer linearly are those that were expected."""
        if self._is_open:
            self._forces = forces
            if not len(forces):
                return forces
            free, W = self._answer(points)
            return free + W.dot(forces.ravel()).reshape(forces.shape)
        if self._tried:
            self._stepper.rollback()
            self._tried = False
        contact = self._hand(points, forces)
        self._handed.forces, self._handed.reached = contact.forces, contact.pairs
        energy = self._stepper.step(self._inputs)
        self._tried, self._twice = True, 2 * energy
        if not math.isfinite(energy):
            self._leave_finite(self._inputs.u)
        self._power = 0.0
        if not len(forces):
            return forces
        touched = self._kernel.touched.dot(self._R.T)
        velocities = self._carriers.mean(points, touched)
        self._power = float(forces.ravel().dot(velocities.ravel()))
        self._carriers.turn(points, self._start + self._h / 2 * touched)
        places[:] = self._carriers.mean(points, self._start) + self._h / 2 * velocities
        return velocities

    def _hand(self, points: Points, forces: Array) -> Handed:
        """Forces at points, as the stepper has them of its contact points."""
        spread, nodes = self._carriers.spread(points, forces)
        return handed(spread.dot(self._R), nodes)

    def _answer(self, points: Points) -> tuple[Array, Array]:
        """Velocities of points without forces, and per force."""
        if self._asked is None or self._asked[0] is not points:
            self._asked = points, self._carriers.mean(points, self._free), self._operator(points, self._kernel.answer)
        return self._asked[1], self._asked[2]

    def known_answer(self, points: Points, places: Array) -> tuple[Array, Array] | None:
        """As in Body."""
        if not self._is_open:
            return None
        return self._answer(points) if len(points.nodes) else (NO_POINTS.arms, np.empty((0, 0)))

    def accept_forces(self, points: Points, places: Array, forces: Array) -> None:
        """As in Body."""
        self._forces = forces

    def delassus(self, points: Points, places: Array) -> Array:
        """As in Body; after an attempt."""
        if self._is_open:
            return self._answer(points)[1]
        return self._operator(points, partial(operator_of, self._handed.delassus))

    def _operator(self, points: Points, of_nodes: Callable[[Array], Array]) -> Array:
        """Of points, (3 k, 3 k), in world axes, from that of their nodes; of nodes the same array while it is so."""

        def in_world(nodes: Array) -> Array:
            known = of_nodes(nodes)
            if not self._fixed:
                return known
            if known is not self._turned_operator[0]:
                self._turned_operator = known, turned_operator(self._R, known, self._R)
            return self._turned_operator[1]

        return self._carriers.operator(points, in_world)

    def close(self) -> None:
        """Takes the step that is open under the forces that were tried last."""
        if not self._is_open:
            return
        contact = self._hand(self._asked[0], self._forces) if self._asked is not None and len(self._forces) else None
        self._tried = True
        self._twice = self._kernel.close(contact)
        if not math.isfinite(self._twice):
            self._leave_finite(self._inputs.u)

    def points_at(self, places: Array, where: str, couples: Array = NO_ROWS) -> Points:
        """As in Body: contact points that are there, or else triangles of the contact surface."""
        own = self.places()
        nodes, weights, gaps = nearest_carriers(places, own, self.contact_triangles, CLOSED * self.size)
        if gaps.max() > CLOSED * self.size:
            worst = int(gaps.argmax())
            raise SceneError(
                f"{where}cannot be closed: body {self.name!r} has no contact surface at {places[worst].tolist()}, the "
                f"nearest is {gaps[worst]:.3g} m away; to hold a whole surface, name it"
            )
        return soft_points(nodes, weights)

    @property
    def takes_impulses(self) -> bool:
        """Whether joints stop it by impulses: by those of a held or carried body that no stroke or guide holds."""
        return isinstance(self._kernel, KICKED) and not len(self._kernel.reactions)

    def end_velocities(self, points: Points) -> Array:
        """As in Body."""
        kernel = self._kernel
        assert isinstance(kernel, KICKED)
        return self._carriers.mean(points, kernel.basis_velocities.dot(self._R.T))

    def inverse_mass(self, points: Points) -> Array | None:
        """As in Body: of others than those that take impulses what is left at joints stays."""
        if not self.takes_impulses:
            return None
        kernel = self._kernel
        assert isinstance(kernel, KICKED)
        return self._operator(points, kernel.inverse_mass)

    def kick(self, points: Points, impulses: Array) -> None:
        """As in Body; what a base takes of it is supplied."""
        kernel, energy, velocities = self._kernel, self.energy, self.end_velocities(points)
        assert isinstance(kernel, KICKED)
        kernel.kick(self._hand(points, impulses).forces)
        work = float((impulses * (velocities + self.end_velocities(points))).sum()) / 2
        self.account.book_contact(work, 0.0, 0.0, 0.0)
        self.account.book(supplied=self.energy - energy - work)

    def commit(self) -> None:
        """As in Body."""
        assert self._source is not None
        self._tried = False
        self._source.environment.commit(self._inputs._replace(obstacles=None), self._dt)
        self.book_gas(self._blown)
        if not self.has_inertia:
            self._commit_rest()
        if self._twice <= self._monitor_threshold:
            self.steps += 1
        else:
            self._step_high(self._inputs.u, self._twice)

    def stays_in(self, kernel: BookedKernel) -> bool:
        """Whether the next step is in the contact mode of a kernel."""
        return self._stepper.kernel is kernel and (self.keeps_contact_mode or self.nearest_contact == self.contact)

    def note_near(self, nodes: Array, gaps: Array) -> None:
        """Notes all contact points (k,) that others were near to when a step began, and how far they were, m."""
        self._handed.point_gaps = np.full(len(self.surface.points), np.inf)
        np.minimum.at(self._handed.point_gaps, nodes, gaps)

    def end_compiled(self, twice: float, u: Array, *steps: Any) -> None:
        """Ends compiled steps; twice the energy, J; steps: the rest of `end_steps`."""
        self._twice = twice
        self.end_steps(u, twice, *steps)

    def _commit_rest(self) -> None:
        """Books what others do by the forces that they feel, those at the end of a step, and notes how points went.

        The step has booked what it knows of their work, ½ (f + f⁺)·Δx, as numerical.
        """
        work, by_base = self._h * self._power, self.account.obstacles - self._supplied
        self.account.book_contact(work - by_base, 0.0, 0.0, 0.0)
        self.account.book(supplied=by_base, numerical=work)
        self._went = (self.places() - self._start) / self._h * self._handed.forces.any(axis=1, keepdims=True)

    def undo(self) -> None:
        """As in Body."""
        if self._tried:
            (self._kernel if self._is_open else self._stepper).rollback()
        self._tried = False

    def to_world(self, places: Array) -> Array:
        """Places (any, 3) of a body as it simulates it, in world axes, m."""
        return self._at + places.dot(self._R.T)
