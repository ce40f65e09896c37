"""Contact of the bodies of a batch with obstacles: what is kept of it, and what it does in a step.

Only bodies that an obstacle may be within reach of are looked at. How far away it is at least is known from the last
look, and from how far body and obstacle can have moved since. The law is in `mechanics.batch_contact_solver`, how
points yield beyond the basis in `batch_residual`. Arrays hold bodies along their last axis, and rows of the
contact points are all x, then all y, then all z: in axes of their own, of which z is the normal of flat ground, if that
is all there is.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.batch_contact_solver import BatchContactSolver, BatchForces, BatchMotion, BatchObstacles
from fenics_rom.mechanics.body_axis import add, in_one_piece, put, taken
from fenics_rom.mechanics.complementarity.normals import along
from fenics_rom.mechanics.contact import ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_points import NEARNESS
from fenics_rom.mechanics.contact_search import ContactSearch, pushing
from fenics_rom.mechanics.contact_solver import PENETRATION_TOLERANCE, ContactSolver
from fenics_rom.mechanics.obstacles import HalfSpace
from fenics_rom.mechanics.readings import ContactPressure
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.residual_part import residual_part, strained_points
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_arrays import distinct
from fenics_rom.runtime.batch_contact_mode import BatchContactMode, by_axis, part_by_axis
from fenics_rom.runtime.batch_residual import BatchResidual
from fenics_rom.runtime.steppers.contact_interface import contact_interface

FARTHEST = 1e50  # m, that obstacles are placed away: what the bodies do then stays within the finite numbers


class ContactStep(NamedTuple):
    """What contact does to some bodies in a step."""

    bodies: Array  # (T,) among them
    push: Array  # (T, m) what it adds to what drives them, as `StepCoefficients.push` does
    works: Array  # (3, B) supplied by obstacles, dissipated by contact, and in residual parts, J


class BatchContact:
    """The contact of bodies of a ROM, in the environment of a run.

    Args:
        rom: with residual compliance.
        environment: with a rigid contact law.
        order: the largest of a contact model.
        size: number of bodies.

    Attributes:
        friction: μ (size,).
        frozen: (size,) bodies that began inside an obstacle.
        inexact: (size,) steps whose forces no method found.
        held_back: (size,) steps in which points were held before an obstacle; see `HeldBack`.
        residual: how the points yield beyond the basis.
        normal_forces: (P, size) of all obstacles on the points, N; zero where no reading asks for them.
        names: of the obstacles.
        points: the contact points.
        skin: what tells of obstacles that come through where these are not; None where there is nothing to look at.
    """

    def __init__(self, rom: Rom, environment: ActiveEnvironment, order: int, size: int):
        interface, residual = contact_interface(rom, environment), rom.residual_compliance
        law = environment.environment.contact_law
        assert interface is not None
        assert residual is not None
        assert law is not None
        interface.check_start()
        self.names, self._environment, self.points = list(environment.obstacles), environment, interface.points
        self.skin = interface.skin
        obstacles = list(environment.obstacles.values())
        self._axes, (first, *others) = np.identity(3), obstacles
        if isinstance(first, HalfSpace) and not others:
            self._axes, obstacles = first.axes, [HalfSpace((first.axes @ first.point).tolist(), (0.0, 0.0, 1.0))]
        coordinates = interface.points.coordinates @ self._axes.T
        self._solver = BatchContactSolver(coordinates, obstacles, law)
        self._coordinates, self._obstacles, self._law = coordinates, obstacles, law
        rows = by_axis(interface.rows, self._axes)
        H = strained_points(rom.stiffness, interface.rows)
        parts = (residual_part(rom.stiffness, model, H, residual) for model in rom.contact_models.values())
        self._modes = [
            BatchContactMode(model, rows, part_by_axis(part, self._axes), order)
            for model, part in zip(rom.contact_models.values(), parts, strict=True)
        ]
        self._β = residual.damping
        # No point moves faster than this times |v|, in any contact mode.
        P = len(coordinates)
        blocks = np.concatenate([mode.S.reshape(3, P, -1).transpose(1, 0, 2) for mode in self._modes])
        self._reach = float(np.linalg.norm(blocks, ord=2, axis=(1, 2)).max())
        self._largest = float(max(np.ptp(coordinates, axis=0).max(), np.abs(coordinates).max()))
        switches = environment.environment.switches_itself and len(self._modes) > 1
        self._watched = NEARNESS * float(np.linalg.norm(np.ptp(coordinates, axis=0))) if switches else 0.0
        count = len(obstacles)
        self.friction, self.frozen = np.full(size, law.friction), np.zeros(size, bool)
        self.inexact, self.held_back = np.zeros((2, size), int)
        self._forces, self._u = np.zeros((2, 3, P, size))  # in the last step, N and m/s
        self._is_read = any(isinstance(reading, ContactPressure) for reading in rom.readings.values())
        self.normal_forces = np.zeros((P, size))
        self._resultants, self._pushed = np.zeros((count, 3, size)), np.zeros((count, P, size), bool)
        self._swung = np.zeros((count, P, size), np.int8)  # in how many steps in a row friction did not stop pairs
        self.residual = BatchResidual(self._modes, rom.rigid, self._axes, size)
        self._stands = np.zeros(size, bool)  # in this step
        self._clear = np.full(size, -np.inf)  # m: no obstacle is nearer
        self._placed = np.full((count, 3, size), np.nan)  # where obstacles were put; NaN: where the scene says
        self._offsets, self._velocities = np.zeros((2, count, 3, size))  # of the obstacles now, m and m/s
        self._offsets[:] = self._offsets_at(0.0)[:, :, None]
        self._ends, self._speed = self._offsets, np.zeros((count, 3, size))

    @property
    def point_forces(self) -> Array:
        """On the points in the last step, (size, P, 3), N."""
        forces: Array = self._forces.transpose(2, 1, 0) @ self._axes
        return forces

    def resultant(self, obstacle: str) -> Array:
        """Of the forces of an obstacle on every body in the last step, (size, 3), N; a StepError if it is not there."""
        check_known("obstacle", obstacle, self.names, StepError)
        resultant: Array = self._resultants[self.names.index(obstacle)].T @ self._axes
        return resultant

    @property
    def offsets(self) -> Array:
        """Displacements of the obstacles of all bodies now, (O, 3, size), m, in axes of its own."""
        return self._offsets

    def offsets_of(self, body: int, offsets: Array | None = None) -> Array:
        """Displacements of the obstacles of a body now, or of some kept `offsets`, (O, 3), m."""
        own: Array = (self._offsets if offsets is None else offsets)[..., body] @ self._axes
        return own

    def set_time_step(self, h: float) -> None:
        """Makes the operators for a time step, s."""
        self._h = h
        for mode in self._modes:
            mode.set_time_step(h, self._β)

    def place(self, name: str, displacement: ArrayLike, bodies: Array) -> None:
        """Has an obstacle be displaced by (bodies, 3) or (3,), m, at the end of the next steps."""
        check_known("obstacle", name, self.names, StepError)
        given = real_numbers_or_nan(displacement)
        if given.shape not in ((3,), (len(bodies), 3)) or not (np.abs(given) <= FARTHEST).all():
            raise StepError(
                f"{name}: use three finite numbers within {FARTHEST:.0e}, in m, for each of {len(bodies)} "
                f"bodies, or for all (got an array of shape {given.shape})"
            )
        self._placed[self.names.index(name), :, bodies] = given @ self._axes.T

    def inside(self, bodies: Array, mode: Array, q: Array) -> Array:
        """Which (B,) of the bodies are inside an obstacle, in contact modes (B,) at q (B, m), without residual part."""
        return self._deep(self._points_of(mode, q), taken(self._offsets, bodies))

    def inside_at_rest(self, bodies: Array) -> Array:
        """The same of bodies that begin anew."""
        at_rest = np.zeros((*self._forces.shape[:2], len(bodies)))
        return self._deep(at_rest, self._offsets_at_start(bodies))

    def _deep(self, displacement: Array, offsets: Array) -> Array:
        gaps, _ = self._solver.distances(displacement, offsets)
        deep: Array = gaps.min(axis=(0, 1)) < -PENETRATION_TOLERANCE * self._largest
        return deep

    def _points_of(self, mode: Array, q: Array) -> Array:
        """Displacements (3, P, B) of the points of bodies in contact modes (B,) at q (B, m), m."""
        points = np.empty((*self._forces.shape[:2], len(q)))
        for k in np.unique(mode):
            bodies = np.flatnonzero(mode == k)
            put(points, bodies, self._modes[k].S @ q[bodies].T)
        return points

    def _offsets_at_start(self, bodies: Array) -> Array:
        placed, scene = taken(self._placed, bodies), self._offsets_at(0.0)[:, :, None]
        return np.where(np.isnan(placed), scene, placed)

    def _offsets_at(self, time: float) -> Array:
        """Displacements (O, 3) that the scene says obstacles have at a time, s, in m."""
        offsets: Array = self._environment.offsets_at(time) @ self._axes.T
        return offsets

    def begin(self, bodies: Array, frozen: Array) -> None:
        """Bodies are where they were put, and nothing touches; some of them are inside an obstacle."""
        for part in (self._forces, self.normal_forces, self._u, self._resultants, self._pushed, self._swung):
            part[..., bodies] = 0
        self._clear[bodies], self.frozen[bodies] = -np.inf, frozen
        self.residual.begin(bodies)

    def reset(self, bodies: Array, frozen: Array) -> None:
        """The same, and obstacles are where they begin."""
        self.begin(bodies, frozen)
        self._offsets[..., bodies], self._velocities[..., bodies] = self._offsets_at_start(bodies), 0.0
        self.inexact[bodies] = self.held_back[bodies] = 0

    # --- a step ------------------------------------------------------------------------------------------------------

    def nearest_modes(self, mode: Array, q: Array, bodies: Array) -> Array:
        """The contact modes (B,) that bodies are to be in, from those they are in and q (B, m)."""
        points = self._points_of(mode, q)
        points += taken(self.residual.state[1], bodies).reshape(points.shape)
        gaps, _ = self._solver.distances(points, taken(self._offsets, bodies))
        return self.points.nearest_modes(gaps.min(axis=0), mode)

    def watched(self) -> Array:
        """Bodies that may be so near an obstacle that their contact mode changes, but for those held."""
        if not self._watched:
            return np.empty(0, int)
        near = self.residual.moves | (self._clear < self._watched)
        near[self._held] = False
        return near.nonzero()[0]

    def begin_step(self, times: Array, held: Array) -> None:
        """Notes where obstacles move to, at the times (size,), s; they stand still beside held bodies."""
        ends, h = self._placed.copy(), self._h
        follows = np.isnan(ends)
        if follows.any():
            instants, which = distinct(times)
            scene = np.stack([self._offsets_at(time + h) for time in instants], axis=-1)
            if not (np.abs(scene) <= FARTHEST).all():
                raise StepError(
                    f"obstacles: use displacements within {FARTHEST:.0e} m; all bodies were left as they were"
                )
            np.copyto(ends, scene[..., which], where=follows)
        ends[..., held] = self._offsets[..., held]
        self._ends, self._speed = ends, (ends - self._offsets) / h
        self._fastest = np.sqrt(np.square(self._speed).sum(axis=1).max(axis=0, initial=0.0))
        self._held, self._stands[:] = held, False
        self._stands[held] = True

    def end_step(self) -> None:
        """Obstacles are where they moved to."""
        before = self._velocities[..., self._held]
        self._offsets, self._velocities = self._ends, self._speed
        self._velocities[..., self._held] = before

    def look(self, bodies: Array, w: Array, r: Array) -> Array:
        """Which (B,) of the bodies an obstacle may reach in the step, with w = 2 v̂ without contact and r (B, m)."""
        h, clear, fastest = self._h, self._clear[bodies], self._fastest[bodies]
        fast = self._reach / 2 * np.sqrt(np.einsum("bm,bm->b", w, w))
        start = self._reach * np.sqrt(np.einsum("bm,bm->b", r, r))
        near = self.residual.moves[bodies] | (clear < h * (2 * fast + start + 3 * fastest)) | (clear < self._watched)
        near &= ~self._stands[bodies]
        self._clear[bodies] = clear - h * (fast + fastest)
        return near

    def step(self, mode: int, bodies: Array, x: Array, r: Array, w: Array) -> ContactStep:
        """Contact of bodies in one contact mode.

        Args:
            mode: its number.
            bodies: (B,) which.
            x, r: (B, m) at the start, x = 2 q/h.
            w: (B, m) 2 v̂ without contact.
        """
        h, kind, B, own = self._h, self._modes[mode], len(bodies), in_one_piece(bodies)
        P = len(kind.S) // 3
        displacement, velocity, free = ((kind.S @ part.T).reshape(3, P, B) for part in (h / 2 * x, r, w / 2))
        moves = self.residual.moves[own]
        residual = taken(self.residual.state, own)
        if moves.any():  # those that rest have zeros
            rates = kind.unforced(residual)
            for part, yields in ((displacement, residual[1]), (velocity, residual[3]), (free, rates[1])):
                part += yields.reshape(part.shape)
        else:
            rates = np.zeros((2, 3 * P, B))
        motion = BatchMotion(displacement, velocity, free)
        obstacles = BatchObstacles(self._offsets, self._speed, self._velocities).of(own)
        distances = self._solver.distances(displacement, obstacles.start)
        self._clear[own] = distances[0].min(axis=(0, 1)) - h * (
            self._reach / 2 * np.sqrt(np.einsum("bm,bm->b", w, w)) + self._fastest[own]
        )
        pushed = taken(self._pushed, own).copy()
        problem = motion, distances, kind.operator, kind.respond, h, obstacles
        before = taken(self._forces, own), taken(self._u, own), taken(self._swung, own).copy()
        found = self._solver.solve(*problem, self.friction[own], pushed, *before)
        works, touching, push = np.zeros((3, B)), np.empty(0, int), np.empty((0, x.shape[1]))
        put(self._resultants, own, np.zeros((len(self.names), 3, B)))
        put(self._swung, own, np.zeros(before[2].shape, np.int8))
        if self._is_read:
            put(self.normal_forces, own, np.zeros((P, B)))
        if found is not None:
            touching, place = found.touching, in_one_piece(found.touching)
            among, response = in_one_piece(bodies[place]), found.response
            works[:2, place] = self._note(found, obstacles.of(place), among)
            for body in found.alone:
                points = PointMotion(*(part[..., body].T.copy() for part in motion))
                works[:2, body] = self._solve_alone(
                    *(kind, found, body, points, obstacles.of(body), int(bodies[body])),
                    *(pushed[..., body], before[2][..., body]),
                )
            if len(found.alone):
                response = kind.respond(found.forces)
            push = response.push
            put(self._u, among, found.velocities)
            put(self._forces, among, found.forces)
            for rate, part in zip(rates, (found.forces / kind.relaxation.whole, response.yields), strict=True):
                add(rate, place, part.reshape(3 * P, -1))
        goes = moves.copy()
        goes[touching] = True
        some = in_one_piece(goes.nonzero()[0])
        works[2, some] = self.residual.step(kind, in_one_piece(bodies[some]), taken(rates, some))
        goes[touching] = False
        some = goes.nonzero()[0]
        if len(some):
            put(self._forces, bodies[some], np.zeros((3, P, len(some))))
            self.residual.forget(kind, bodies[some], kind.stored(x[some], r[some]))
        return ContactStep(touching, push, works)

    def _note(self, found: BatchForces, obstacles: BatchObstacles, bodies: Array | slice) -> Array:
        """Notes what pushes bodies that touch; works (2, T) as in ContactStep."""
        pressing = along(found.forces, found.normals)
        pushed = pushing(pressing)
        for k in range(len(self.names)):
            own = pushed & (found.obstacle == k)
            put(self._pushed[k], bodies, own)
            if found.swung is not None:
                put(self._swung[k], bodies, found.swung * (found.obstacle == k))
            forces = found.forces if len(self.names) == 1 else found.forces * own
            put(self._resultants[k], bodies, forces.sum(axis=1))
        if self._is_read:
            put(self.normal_forces, bodies, pressing)
        supplied = np.einsum("oab,oab->b", taken(self._resultants, bodies), obstacles.velocities)
        return self._h * np.stack([supplied, -found.work])

    def _solve_alone(
        self,
        kind: BatchContactMode,
        found: BatchForces,
        body: int,
        points: PointMotion,
        obstacles: BatchObstacles,
        among: int,
        pushed: Array,
        swung: Array,
    ) -> tuple[float, float]:
        """One body by the solver of one, into what was found; works as in ContactStep. Where it finds none, that stays.

        Args:
            kind: the contact mode.
            found: of all.
            body: its place among those that were asked for.
            points: what its points do.
            obstacles: beside it.
            among: its place in the batch.
            pushed: (O, P) its pairs that had forces in the step before.
            swung: (O, P) in how many steps in a row friction did not stop them.
        """
        at, h, P = int(np.searchsorted(found.touching, body)), self._h, len(points.displacement)
        solver = ContactSolver(self._coordinates, self._obstacles, replace(self._law, friction=self.friction[among]))
        start, speed, before = obstacles
        begun = np.where(pushed[:, :, None], found.forces[..., at].T, 0.0)
        solver.search = ContactSearch(begun.reshape(-1, 3), swung=swung.ravel(), known_to_push=pushed.ravel())
        W = kind.operator.W.reshape(3, P, 3, P).transpose(1, 0, 3, 2).reshape(3 * P, 3 * P)
        try:
            contact = solver.solve(points, W, h, ObstacleMotion(start, start + h * speed, before))
        except StepError:
            contact = None
        if contact is None or solver.search.residual.steps:
            self.inexact[among] += 1
        self.held_back[among] += solver.search.held.steps
        if contact is None:
            return h * float((self._resultants[..., among] * speed).sum()), -h * float(found.work[at])
        found.forces[..., at], found.velocities[..., at] = contact.forces.T, 0.0
        self._resultants[..., among], self.normal_forces[:, among] = contact.by_obstacle, contact.normal_forces
        self._pushed[..., among] = solver.search.pushed.reshape(-1, P)
        self._swung[..., among] = 0 if solver.search.swung is None else solver.search.swung.reshape(-1, P)
        moved = W.dot(contact.forces.ravel()).reshape(P, 3)
        work = contact.work(points.free_velocity + moved, h)
        return work.supplied, work.contact + work.friction
