"""Contact of the bodies of a batch with obstacles: what is kept of it, and what it does in a step.

Only bodies that an obstacle may be within reach of are looked at. How far away it is at least is known from the last
look, and from how far body and obstacle can have moved since. The law is in `mechanics.batch_contact_solver`, how
points yield beyond the basis in `steppers.residual_motion`. Arrays hold bodies along their last axis, and rows of the
contact points are all x, then all y, then all z.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.errors import StepError, check_known
from fenics_rom.mechanics.active_environment import ActiveEnvironment
from fenics_rom.mechanics.batch_contact_solver import BatchContactSolver, BatchForces, BatchMotion, BatchObstacles
from fenics_rom.mechanics.body_axis import in_one_piece, put, taken
from fenics_rom.mechanics.contact import ContactSearch, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_points import NEARNESS
from fenics_rom.mechanics.contact_solver import PENETRATION_TOLERANCE, ContactSolver
from fenics_rom.mechanics.readings import ContactPressure
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.rom.residual_part import residual_part, strained_points
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.batch_contact_mode import BatchContactMode, by_axis
from fenics_rom.runtime.steppers.contact_interface import contact_interface
from fenics_rom.runtime.steppers.residual_motion import FORGOTTEN

FARTHEST = 1e50  # m, that obstacles are placed away: what the bodies do then stays within the finite numbers
_LEAST = 1e-100  # N: forces to begin a search with, where there were some
NEGLIGIBLE = 1e-20  # of a body's energy: what is stored in its residual part no more


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
        forces: (3, P, size) on the points in the last step, N.
        resultants: (O, 3, size) of each obstacle on the body, N.
        normal_forces: (P, size) of all obstacles on the points, N; zero where no reading asks for them.
        offsets: (O, 3, size) displacements of the obstacles now, m.
        names: of the obstacles.
        points: the contact points.
    """

    def __init__(self, rom: Rom, environment: ActiveEnvironment, order: int, size: int):
        interface, residual = contact_interface(rom, environment), rom.residual_compliance
        law = environment.environment.contact_law
        assert interface is not None
        assert residual is not None
        assert law is not None
        interface.check_start()
        self.names, self._environment, self.points = list(environment.obstacles), environment, interface.points
        coordinates, obstacles = interface.points.coordinates, list(environment.obstacles.values())
        self._solver = BatchContactSolver(coordinates, obstacles, law)
        self._coordinates, self._obstacles, self._law = coordinates, obstacles, law
        rows = by_axis(interface.rows)
        H = by_axis(strained_points(rom.stiffness, interface.rows, residual))
        self._modes = [
            BatchContactMode(model, rows, residual_part(rom.stiffness, model, H, residual), order)
            for model in rom.contact_models.values()
        ]
        self._β, self._rigid = residual.damping, rom.rigid
        # No point moves faster than this times |v|, in any contact mode.
        P = len(coordinates)
        blocks = np.concatenate([mode.S.reshape(3, P, -1).transpose(1, 0, 2) for mode in self._modes])
        self._reach = float(np.linalg.norm(blocks, ord=2, axis=(1, 2)).max())
        self._largest = float(max(np.ptp(coordinates, axis=0).max(), np.abs(coordinates).max()))
        switches = environment.environment.switches_itself and len(self._modes) > 1
        self._watched = NEARNESS * float(np.linalg.norm(np.ptp(coordinates, axis=0))) if switches else 0.0
        count = len(obstacles)
        self.friction, self.frozen = np.full(size, law.friction), np.zeros(size, bool)
        self.inexact = np.zeros(size, int)
        self.forces, self._z = np.zeros((2, 3, P, size))
        self._is_read = any(isinstance(reading, ContactPressure) for reading in rom.readings.values())
        self.normal_forces = np.zeros((P, size))
        self.resultants, self._pushed = np.zeros((count, 3, size)), np.zeros((count, P, size), bool)
        self._residual = np.zeros((4, 3 * P, size))  # g, y, ġ, ẏ
        self._moves = np.zeros(size, bool)  # whether the residual part does
        self._stands = np.zeros(size, bool)  # in this step
        self._clear = np.full(size, -np.inf)  # m: no obstacle is nearer
        self._placed = np.full((count, 3, size), np.nan)  # where obstacles were put; NaN: where the scene says
        self.offsets, self._velocities = np.zeros((2, count, 3, size))
        self.offsets[:] = environment.offsets_at(0.0)[:, :, None]
        self._ends, self._speed = self.offsets, np.zeros((count, 3, size))

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
                f"{name}: allowed are three finite numbers within {FARTHEST:.0e}, in m, for each of {len(bodies)} "
                f"bodies, or for all; given: an array of shape {given.shape}"
            )
        self._placed[self.names.index(name), :, bodies] = given

    def inside(self, bodies: Array, mode: Array, q: Array) -> Array:
        """Which (B,) of the bodies are inside an obstacle, in contact modes (B,) at q (B, m), without residual part."""
        return self._deep(self._points_of(mode, q), taken(self.offsets, bodies))

    def inside_at_rest(self, bodies: Array) -> Array:
        """The same of bodies that begin anew."""
        at_rest = np.zeros((*self.forces.shape[:2], len(bodies)))
        return self._deep(at_rest, self._offsets_at_start(bodies))

    def _deep(self, displacement: Array, offsets: Array) -> Array:
        gaps, _ = self._solver.distances(displacement, offsets)
        deep: Array = gaps.min(axis=(0, 1)) < -PENETRATION_TOLERANCE * self._largest
        return deep

    def _points_of(self, mode: Array, q: Array) -> Array:
        """Displacements (3, P, B) of the points of bodies in contact modes (B,) at q (B, m), m."""
        points = np.empty((*self.forces.shape[:2], len(q)))
        for k in np.unique(mode):
            bodies = np.flatnonzero(mode == k)
            put(points, bodies, self._modes[k].S @ q[bodies].T)
        return points

    def _offsets_at_start(self, bodies: Array) -> Array:
        placed, scene = taken(self._placed, bodies), self._environment.offsets_at(0.0)[:, :, None]
        return np.where(np.isnan(placed), scene, placed)

    def begin(self, bodies: Array, frozen: Array) -> None:
        """Bodies are where they were put, and nothing touches; some of them are inside an obstacle."""
        for part in (self.forces, self.normal_forces, self._z, self.resultants, self._pushed, self._residual):
            part[..., bodies] = 0
        self._clear[bodies], self._moves[bodies], self.frozen[bodies] = -np.inf, False, frozen

    def reset(self, bodies: Array, frozen: Array) -> None:
        """The same, and obstacles are where they begin."""
        self.begin(bodies, frozen)
        self.offsets[..., bodies], self._velocities[..., bodies] = self._offsets_at_start(bodies), 0.0
        self.inexact[bodies] = 0

    def stored(self, bodies: Array, mode: Array) -> Array:
        """Energy (B,) in the residual parts of bodies in contact modes (B,), J."""
        g, y, ġ, ẏ = taken(self._residual, bodies)
        τ = np.array([kind.part.time_constant for kind in self._modes])[mode]
        stored: Array = (np.einsum("pb,pb->b", g, y) + τ**2 * np.einsum("pb,pb->b", ġ, ẏ)) / 2
        return stored

    def carry_over(self, start: int, end: int, bodies: Array, strained: Array) -> Array:
        """Goes on in another contact mode, with the whole displacement; see ResidualMotion.carry_over.

        Args:
            start, end: numbers of the contact modes.
            bodies: (B,) which.
            strained: (B, m) energy coordinates √γ q in the mode before; those (B, m_end - rigid) in the next return.
        """
        there, here = self._modes[start].part, self._modes[end].part
        e_start, (g, y, ġ, ẏ) = strained[:, self._rigid : self._modes[start].model.order], taken(self._residual, bodies)
        e = (e_start @ there.basis.T + there.strained(g.T)) @ here.basis
        stored = np.square(e_start).sum(axis=1) + np.einsum("pb,pb->b", g, y) - np.square(e).sum(axis=1)
        moving = there.time_constant**2 * np.einsum("pb,pb->b", ġ, ẏ) / here.time_constant**2
        y = y + there.basis_points @ e_start.T - here.basis_points @ e.T
        for place, points, most in ((0, y, stored), (2, ẏ, moving)):
            root = here.inverse_root @ points
            square = np.einsum("pb,pb->b", root, root)
            over = square > most
            root[:, over] *= np.sqrt(np.maximum(most[over], 0.0) / square[over])
            carried = here.inverse_root.T @ root
            put(self._residual[place], bodies, carried)
            put(self._residual[place + 1], bodies, here.compliance @ carried)
        self._moves[bodies] = True
        return e

    def strained(self, mode: Array, bodies: Array) -> Array:
        """What residual parts of bodies in contact modes (B,) add in the shared basis; see ResidualPart.strained."""
        strained = np.zeros((len(bodies), len(self._modes[0].part.basis)))
        for k in np.unique(mode[self._moves[bodies]]):
            own = (mode == k).nonzero()[0]
            strained[own] = self._modes[k].part.strained(taken(self._residual[0], bodies[own]).T)
        return strained

    def beyond_shared(self, body: int, mode: int) -> Array:
        """What no shape of the shared basis has of the displacement of nodes that can be touched, (nodes, 3), m."""
        part, (g, y) = self._modes[mode].part, self._residual[:2, :, body]
        beyond: Array = (y - part.points[:, : len(part.basis)] @ part.strained(g)).reshape(3, -1).T
        return beyond[: len(self.points.nodes)]

    # --- a step ------------------------------------------------------------------------------------------------------

    def nearest_modes(self, mode: Array, q: Array, bodies: Array) -> Array:
        """The contact modes (B,) that bodies are to be in, from those they are in and q (B, m)."""
        points = self._points_of(mode, q)
        points += taken(self._residual[1], bodies).reshape(points.shape)
        gaps, _ = self._solver.distances(points, taken(self.offsets, bodies))
        return self.points.nearest_modes(gaps.min(axis=0), mode)

    def watched(self) -> Array:
        """Bodies that may be so near an obstacle that their contact mode changes, but for those held."""
        if not self._watched:
            return np.empty(0, int)
        near = self._moves | (self._clear < self._watched)
        near[self._held] = False
        return near.nonzero()[0]

    def begin_step(self, times: Array, held: Array) -> None:
        """Notes where obstacles move to, at the times (size,), s; they stand still beside held bodies."""
        ends, h = self._placed.copy(), self._h
        follows = np.isnan(ends)
        if follows.any():
            instants, which = np.unique(times, return_inverse=True)
            scene = np.stack([self._environment.offsets_at(time + h) for time in instants], axis=-1)
            if not (np.abs(scene) <= FARTHEST).all():
                raise StepError(
                    f"obstacles: allowed are displacements within {FARTHEST:.0e} m; all bodies were left as they were"
                )
            np.copyto(ends, scene[..., which], where=follows)
        ends[..., held] = self.offsets[..., held]
        self._ends, self._speed = ends, (ends - self.offsets) / h
        self._fastest = np.sqrt(np.square(self._speed).sum(axis=1).max(axis=0, initial=0.0))
        self._held, self._stands[:] = held, False
        self._stands[held] = True

    def end_step(self) -> None:
        """Obstacles are where they moved to."""
        before = self._velocities[..., self._held]
        self.offsets, self._velocities = self._ends, self._speed
        self._velocities[..., self._held] = before

    def look(self, bodies: Array, w: Array, r: Array) -> Array:
        """Which (B,) of the bodies an obstacle may reach in the step, with w = 2 v̂ without contact and r (B, m)."""
        h, clear, fastest = self._h, self._clear[bodies], self._fastest[bodies]
        fast = self._reach / 2 * np.sqrt(np.einsum("bm,bm->b", w, w))
        start = self._reach * np.sqrt(np.einsum("bm,bm->b", r, r))
        near = self._moves[bodies] | (clear < h * (2 * fast + start + 3 * fastest)) | (clear < self._watched)
        near &= ~self._stands[bodies]
        self._clear[bodies] = clear - h * (fast + fastest)
        return near

    def step(self, mode: int, bodies: Array, x: Array, r: Array, w: Array, energy: Array) -> ContactStep:
        """Contact of bodies in one contact mode.

        Args:
            mode: its number.
            bodies: (B,) which.
            x, r: (B, m) at the start, x = 2 q/h.
            w: (B, m) 2 v̂ without contact.
            energy: (B,) stored in the basis at the start, J.
        """
        h, kind, B, own = self._h, self._modes[mode], len(bodies), in_one_piece(bodies)
        inertia, whole, _ = kind.relaxation
        P = len(kind.S) // 3
        displacement, velocity, free = ((kind.S @ part.T).reshape(3, P, B) for part in (h / 2 * x, r, w / 2))
        moves = self._moves[own]
        if moves.any():
            some = in_one_piece(moves.nonzero()[0])
            y, ẏ = taken(self._residual[1::2], in_one_piece(bodies[some])).reshape(2, 3, P, -1)
            for part, yields in ((displacement, y), (velocity, ẏ), (free, (inertia * ẏ - y) / whole)):
                put(part, some, taken(part, some) + yields)
        motion = BatchMotion(displacement, velocity, free)
        obstacles = BatchObstacles(self.offsets, self._speed, self._velocities).of(own)
        distances = self._solver.distances(displacement, obstacles.start)
        self._clear[own] = distances[0].min(axis=(0, 1)) - h * (
            self._reach / 2 * np.sqrt(np.einsum("bm,bm->b", w, w)) + self._fastest[own]
        )
        pushed = taken(self._pushed, own).copy()
        problem = motion, distances, kind.operator, h, obstacles
        found = self._solver.solve(*problem, self.friction[own], pushed, taken(self._z, own))
        works, forces, touching = np.zeros((3, B)), np.zeros(displacement.shape), np.empty(0, int)
        put(self.resultants, own, np.zeros((len(self.names), 3, B)))
        if self._is_read:
            put(self.normal_forces, own, np.zeros((P, B)))
        if found is not None:
            touching, place = found.touching, in_one_piece(found.touching)
            among = in_one_piece(bodies[place])
            works[:2, place] = self._note(found, obstacles.of(place), among)
            for body in found.alone:
                points = PointMotion(*(part[..., body].T.copy() for part in motion))
                works[:2, body] = self._solve_alone(
                    kind, found, body, points, obstacles.of(body), int(bodies[body]), pushed[..., body]
                )
            put(forces, place, found.forces)
            put(self._z, among, found.z)
        put(self.forces, own, forces)
        rests = ~moves
        rests[touching] = False
        some = in_one_piece((~rests).nonzero()[0])
        touches = np.zeros(B, bool)
        touches[touching] = True
        works[2, some] = self._step_residual(kind, bodies[some], taken(forces, some), touches[some], energy[some])
        push = taken(forces, in_one_piece(touching)).reshape(len(kind.S), -1).T @ kind.push
        return ContactStep(touching, push, works)

    def _note(self, found: BatchForces, obstacles: BatchObstacles, bodies: Array | slice) -> Array:
        """Notes what pushes bodies that touch; works (2, T) as in ContactStep."""
        pushed = found.forces.any(axis=0)
        for k in range(len(self.names)):
            own = pushed & (found.obstacle == k)
            put(self._pushed[k], bodies, own)
            put(self.resultants[k], bodies, (found.forces * own).sum(axis=1))
        if self._is_read:
            put(self.normal_forces, bodies, np.einsum("apb,apb->pb", found.forces, found.normals))
        supplied = np.einsum("oab,oab->b", taken(self.resultants, bodies), obstacles.velocities)
        given = np.einsum("apb,apb->b", found.forces, found.relative + found.moved)
        return self._h * np.stack([supplied, -given])

    def _solve_alone(
        self,
        kind: BatchContactMode,
        found: BatchForces,
        body: int,
        points: PointMotion,
        obstacles: BatchObstacles,
        among: int,
        pushed: Array,
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
        """
        at, h, P = int(np.searchsorted(found.touching, body)), self._h, len(points.displacement)
        solver = ContactSolver(self._coordinates, self._obstacles, replace(self._law, friction=self.friction[among]))
        start, speed, before = obstacles
        begun = np.where(pushed[:, :, None], found.forces[..., at].T + _LEAST, 0.0)  # the law asks what pushed before
        solver.search = ContactSearch(begun.reshape(-1, 3))
        W = kind.operator.W.reshape(3, P, 3, P).transpose(1, 0, 3, 2).reshape(3 * P, 3 * P)
        try:
            contact = solver.solve(points, W, h, ObstacleMotion(start, start + h * speed, before))
        except StepError:
            contact = None
        if contact is None or solver.search.residual.steps:
            self.inexact[among] += 1
        if contact is None:
            given = float((found.forces * (found.relative + found.moved))[..., at].sum())
            return h * float((self.resultants[..., among] * speed).sum()), -h * given
        found.forces[..., at], found.z[..., at] = contact.forces.T, kind.operator.ρ * contact.forces.T
        self.resultants[..., among], self.normal_forces[:, among] = contact.by_obstacle, contact.normal_forces
        self._pushed[..., among] = solver.search.forces.any(axis=1).reshape(-1, P)
        moved = W.dot(contact.forces.ravel()).reshape(P, 3)
        work = contact.work(points.free_velocity + moved, h)
        return work.supplied, work.contact + work.friction

    def _step_residual(
        self, kind: BatchContactMode, bodies: Array, forces: Array, touches: Array, energy: Array
    ) -> Array:
        """Takes the step of the residual parts of bodies (B,) under the forces; what they dissipate, J, (B,)."""
        h, (inertia, whole, heat), B, own = self._h, kind.relaxation, len(bodies), in_one_piece(bodies)
        state = taken(self._residual, own)  # itself, if they are a slice
        f, (g, y, ġ, ẏ) = forces.reshape(len(kind.S), B), state
        moved = inertia * ẏ - y
        moved += kind.part.compliance @ f
        moved /= whole
        change = inertia * ġ - g
        change += f
        change /= whole
        dissipated: Array = h * heat * np.einsum("pb,pb->b", change, moved)
        np.subtract(2 * change, ġ, out=ġ)
        np.subtract(2 * moved, ẏ, out=ẏ)
        g += h * change
        y += h * moved
        τ = kind.part.time_constant
        stored = np.einsum("pb,pb->b", g, y) + τ**2 * np.einsum("pb,pb->b", ġ, ẏ)
        rests = stored <= np.maximum(2 * FORGOTTEN, NEGLIGIBLE * energy)
        rests &= ~touches
        state[..., rests] = 0.0
        if not isinstance(own, slice):
            put(self._residual, own, state)
        self._moves[own] = ~rests
        return dissipated
