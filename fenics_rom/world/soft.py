"""A soft body in a step of several: its own stepper, to which contact hands the forces that are tried.

Held or carried, linear: its points answer forces by an operator that is known when the step begins, exactly, and the
step is taken once, under the forces that were found; a free one is a `FreeSoft`. Of large deformation: the stepper
asks for contact forces as it does among obstacles, and gets those of the try. How its contact points move then, it
tells by itself; a try is a step that is taken back.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.base_path import BaseState
from fenics_rom.mechanics.complementarity.solution import largest
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.energy_ledger import EnergyLedger
from fenics_rom.mechanics.frame_geometry import turned_operator
from fenics_rom.mechanics.frame_motion import rotation_matrix
from fenics_rom.mechanics.surface_points import mean_turning_maps
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.simulator import Simulator
from fenics_rom.runtime.steppers.carried_frame import CarriedFrame
from fenics_rom.runtime.steppers.contact_midpoint import ContactMidpoint
from fenics_rom.runtime.steppers.kernel import BookedKernel
from fenics_rom.runtime.steppers.residual_motion import operator_of
from fenics_rom.world.bodies import NO_ROWS, Points
from fenics_rom.world.collision.contacts import PlacedSurface
from fenics_rom.world.handed_forces import Handed, HandedForces, handed
from fenics_rom.world.surfaces import nearest_carriers, soft_points, spread_of

if TYPE_CHECKING:
    from fenics_rom.mechanics.signals import SignalLike
    from fenics_rom.world.mount import Mount

_ONES = np.ones(3)
KICKED = ContactMidpoint, CarriedFrame  # steppers of what takes impulses of joints
CLOSED = 1e-6  # of a body's size: so near to the point of a joint one of its own is to be


class _Reached(NamedTuple):
    """Contact points that forces at some points of the surface act on."""

    points: Points
    nodes: Array  # (s,)
    are_nodes: bool  # whether each of the points is a contact point, and none is between them, or a couple
    is_each_once: bool  # and no two are the same


class Soft(Simulator):
    """A soft body among others.

    Args:
        name: of the body, for messages.
        rom: the reduced model.
        dt: s.
        pose: of its frame: of the axes of a held body, of a free body its centre of mass.
        mount: where another body carries it; None: nothing does.
        is_alone: whether there is no other body: then it is a Simulator, with the obstacles of its scene.
        signals: as of a Simulator.
    """

    is_driven, takes_couples = False, False
    _solver_of: type[ContactSolver] | None = HandedForces

    def __init__(
        self,
        name: str,
        rom: Rom,
        dt: float,
        pose: BaseState,
        mount: "Mount | None",
        signals: "Mapping[str, SignalLike] | None",
        is_alone: bool = False,
    ):
        acting = rom.environment
        self.name, self._mount, self._fixed = name, mount, not acting.is_moving
        self.carrier = None if mount is None else mount.carrier
        self._R, self._held_at = rotation_matrix(pose.rotation), pose
        if is_alone:
            self._solver_of = None
            super().__init__(rom, dt, signals=signals)
            if not self._fixed:
                self.place(pose)
            return
        law = acting.contact_law
        if law is None or not acting.has_inertia or law.stiffness is not None:
            lacks = "inertia" if not acting.has_inertia else "effects.contact"
            said = f"made without {lacks}: allowed is a ROM whose scene has it, as other bodies may touch it"
            if law is not None and law.stiffness is not None:
                said = "made with effects.contact.method = 'penalty': allowed is 'complementarity', the law of a world"
            raise SceneError(f"body {name!r}: ROM {rom.name!r} was {said}; obstacles of its scene are left out")
        if (mount is not None) != (rom.moving_frame is not None and acting.is_moving and rom.moving_frame.carried):
            needs = (
                "is carried: allowed is on = BODY, one that moves as it is told" if mount is None else "is not carried"
            )
            raise SceneError(f"body {name!r}: ROM {rom.name!r} {needs}")
        super().__init__(rom, dt, scene=replace(acting, obstacles={}, run=None), signals=signals)
        assert self._stepper.interface is not None
        self._handed: HandedForces = self._stepper.interface.solver  # type: ignore[assignment]
        if not self._fixed:
            self.place(pose if mount is None else mount.start)
        elif acting.loads.get("gravity") is not None and not np.allclose(self._R, np.eye(3)):
            raise SceneError(
                f"body {name!r}: ROM {rom.name!r} has gravity along axes of its own: allowed is a rotation of a ROM "
                'without it, or one with frame = "moving"'
            )
        self._given: Mapping[str, Any] = {}
        self.keeps_contact_mode = False  # whoever is near
        self._asked: tuple[Points, Array, Array] | None = None  # points, their velocities without forces, and per force
        self._reached = _Reached(Points(*np.empty((4, 0, 3))), np.empty(0, dtype=int), False, False)
        self._turned_operator = np.empty((0, 0)), np.empty((0, 0))  # in axes of its own, and in the world's
        self._forces = np.empty((0, 3))
        self._turning = np.empty((0, 3, 3, 3))  # how surfaces that couples act on turn, per velocity of their points
        self._tried, self._is_open, self._twice = False, False, 0.0
        surface = self._stepper.interface.points.nodes
        number = np.full(len(rom.nodes), -1)
        number[surface] = np.arange(len(surface))
        triangles = number[rom.triangles]
        self.contact_triangles = triangles[(triangles >= 0).all(axis=1)]
        self._everywhere = np.arange(len(self.contact_coordinates))
        self.lead = np.zeros(3)

    @property
    def pose(self) -> BaseState:
        """As in Body; of a held body where its axes are."""
        if self._fixed:
            return self._held_at
        pose = super().pose
        assert pose is not None
        return pose

    @property
    def account(self) -> EnergyLedger:
        """As in Body."""
        assert self.ledger is not None
        return self.ledger

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

    @property
    def size(self) -> float:
        """As in Body."""
        return float(np.linalg.norm(np.ptp(self.contact_coordinates, axis=0))) / 2

    def places(self) -> Array:
        """Of the contact points now, (P, 3) in world axes, m."""
        return self.to_world(self._kernel.point_places())

    def node_places(self) -> Array:
        """Of all nodes now, (N, 3) in world axes, m."""
        return self.to_world(self.rom.nodes + self.displacement())

    def describe_passing(self, radii: Mapping[str, float]) -> str:
        """What to say of rigid bodies with such radii, m, by name, that fit between its points; or nothing."""
        assert self._stepper.interface is not None
        return self._stepper.interface.points.describe_passing(radii, self.rom.triangles, self.rom.nodes)

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
        self._velocity = self._turned(self._kernel.start_velocities())
        self._handed.reached = np.empty(0, dtype=int)
        if h == 0:
            return
        assert self._source is not None
        if self._mount is not None:
            self._base = self._mount.end
        u = self._by_name((), self._given)
        self._note_input(u)
        self._inputs = self._with_base(self._source.step_input(u, self._width, self.time, self._dt))
        self._handed.point_gaps = np.full(len(self._everywhere), np.inf)
        self._open()

    def _open(self) -> None:
        """Opens the step of a body that answers linearly."""
        kernel, inputs, self._asked = self._kernel, self._inputs, None
        if self._is_open:
            if isinstance(kernel, CarriedFrame):
                kernel.base = inputs.base
            self._free = self._turned(kernel.open(inputs.u))
            if not math.isfinite(self._free.sum()):
                self._leave_finite(inputs.u)

    def note_gaps(self, points: Points, gaps: Array) -> None:
        """Takes note of how near others are to points when the step begins, (k,), m."""
        if len(self.rom.contact_models) > 1:
            nodes = points.nodes[: len(gaps)]
            np.minimum.at(self._handed.point_gaps, nodes.ravel(), np.repeat(gaps, nodes.shape[1]))

    def placed(self) -> PlacedSurface:
        """As in Body."""
        return PlacedSurface(self._start + self._h / 2 * self._velocity, self.contact_triangles, self._everywhere)

    def travel(self) -> tuple[Array, float]:
        """As in Body."""
        whole = self._velocity.sum(axis=0) / len(self._velocity)
        beside = self._velocity - whole
        beside *= beside
        return self._h * whole, 2 * self._h * math.sqrt(largest(beside.dot(_ONES)))

    def swerve(self) -> tuple[Array, float]:
        """As in Body: it is not looked at."""
        return self.lead, 0.0

    def start_velocities(self, points: Points, places: Array) -> Array:
        """As in Body."""
        self._turn(points, self._start + self._h / 2 * self._velocity)
        return self._mean(points, self._velocity)

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
        result = self._stepper.step(self._inputs)
        self._tried, self._twice = True, 2 * result.energy
        if not math.isfinite(result.energy):
            self._leave_finite(self._inputs.u)
        if not len(forces):
            return forces
        touched = self._turned(self._kernel.touched)
        velocities = self._mean(points, touched)
        self._turn(points, self._start + self._h / 2 * touched)
        places[:] = self._mean(points, self._start) + self._h / 2 * velocities
        return velocities

    def _hand(self, points: Points, forces: Array) -> Handed:
        """Forces at points, as the stepper has them of its contact points."""
        spread, reached = np.zeros((len(self._everywhere), 3)), self._reach(points)
        if reached.is_each_once:
            spread[points.nodes[:, 0]] = forces
        else:
            shares, couples = points.weights[:, :, None] * forces[:, None, :], points.couples
            if len(couples):
                shares[couples] = np.matmul(forces[couples, None, None], self._turning)[:, :, 0]
            np.add.at(spread, points.nodes, shares)
        return handed(self._into_frame(spread), reached.nodes)

    def _reach(self, points: Points) -> _Reached:
        """Of these points; kept as long as they are the same."""
        if self._reached.points is not points:
            nodes = np.unique(points.nodes[points.weights != 0])
            are_nodes = bool(points.weights.shape[1]) and bool((points.weights[:, 0] == 1.0).all())
            are_nodes = are_nodes and not len(points.couples)
            self._reached = _Reached(points, nodes, are_nodes, are_nodes and len(nodes) == len(points.nodes))
        return self._reached

    def _mean(self, points: Points, values: Array) -> Array:
        """Of values (P, 3) at points."""
        if self._reach(points).are_nodes:
            mean: Array = values[points.nodes[:, 0]]
            return mean
        mean = (points.weights[:, :, None] * values[points.nodes]).sum(axis=1)
        if len(points.couples):
            mean[points.couples] = np.einsum("cnij,cnj->ci", self._turning, values[points.nodes[points.couples]])
        return mean

    def _turn(self, points: Points, places: Array) -> None:
        """Takes note of how the surfaces that couples act on turn, as their points (P, 3) are."""
        if len(points.couples):
            held = zip(places[points.nodes[points.couples]], points.weights[points.couples], strict=True)
            self._turning = np.array([mean_turning_maps(own - weights.dot(own), weights) for own, weights in held])

    def _answer(self, points: Points) -> tuple[Array, Array]:
        """Velocities of points without forces, and per force."""
        if self._asked is None or self._asked[0] is not points:
            self._asked = points, self._mean(points, self._free), self._operator(points, self._kernel.answer)
        return self._asked[1:]

    def known_delassus(self, points: Points) -> Array | None:
        """As in Body."""
        return self._answer(points)[1] if self._is_open else None

    def delassus(self, points: Points, places: Array) -> Array:
        """As in Body; after an attempt."""
        if self._is_open:
            return self._answer(points)[1]
        return self._operator(points, partial(operator_of, self._handed.delassus))

    def _operator(self, points: Points, of_nodes: Callable[[Array], Array]) -> Array:
        """Of points, (3 k, 3 k), in world axes, from that of their nodes; of nodes the same array while it is so."""
        if self._reach(points).are_nodes:
            known = of_nodes(points.nodes[:, 0])
            if not self._fixed:
                return known
            if known is not self._turned_operator[0]:
                self._turned_operator = known, turned_operator(self._R, known, self._R)
            return self._turned_operator[1]
        nodes, spread = spread_of(points, self._turning)
        W = spread.dot(of_nodes(nodes)).dot(spread.T)
        return turned_operator(self._R, W, self._R) if self._fixed else W

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
        """Whether joints stop it by impulses: a linear body that is held or carried."""
        return isinstance(self._kernel, KICKED)

    def end_velocities(self, points: Points) -> Array:
        """As in Body."""
        kernel = self._kernel
        assert isinstance(kernel, KICKED)
        return self._mean(points, self._turned(kernel.basis_velocities))

    def inverse_mass(self, points: Points) -> Array | None:
        """As in Body: of a linear body that is held or carried; of others what is left at joints stays."""
        kernel = self._kernel
        return self._operator(points, partial(operator_of, kernel.inverse_mass)) if isinstance(kernel, KICKED) else None

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
        self._source.environment.commit(self._inputs, self._dt)
        if self._twice <= self._monitor_threshold:
            self.steps += 1
        else:
            self._step_high(self._inputs.u, self._twice)

    def undo(self) -> None:
        """As in Body."""
        if self._tried:
            (self._kernel if self._is_open else self._stepper).rollback()
        self._tried = False

    def to_world(self, places: Array) -> Array:
        """Places (any, 3) of a body as it simulates it, in world axes, m."""
        return places if not self._fixed else self._held_at.position + places.dot(self._R.T)

    def _turned(self, vectors: Array) -> Array:
        turned: Array = vectors.dot(self._R.T) if self._fixed else vectors
        return turned

    def _into_frame(self, vectors: Array) -> Array:
        turned: Array = vectors.dot(self._R) if self._fixed else vectors
        return turned
