"""Contact of a body with itself by compiled loops, where numba is; forces that these do not find are `SelfContact`'s.

Pairs that are near are handed to the loops as points of their own, with their relative velocities and operator.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, or_numpy
from fenics_rom.mechanics.braking import SWINGS, Braking
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Law, pairs_from
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.compiled.own_pairs import find_pair_forces, set_corner_maps, set_operator
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, Opposite, PointMotion
from fenics_rom.mechanics.contact_look import Look
from fenics_rom.mechanics.contact_pairs import Decided, Settled
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.reach import reach_of
from fenics_rom.mechanics.self_contact import SelfContact, beside

_NO_OUTWARDS, _NOBODY = np.empty(0), np.empty(0, dtype=bool)


class CompiledSelfContact(SelfContact):
    """Arguments and attributes as in SelfContact; of obstacles that are convex."""

    def solve(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        settled: Settled | None = None,
        is_patient: bool = True,
    ) -> ContactSolution | None:
        """As in ContactSolver."""
        self._last = self.search, self._begun, (points, delassus, dt, obstacles, quasi_static)
        start = self._begin(points)
        found = self._find(points, delassus, dt, beside(obstacles), quasi_static, start, settled)
        if found is None:
            return super().solve(points, delassus, dt, obstacles, quasi_static, settled, is_patient)
        self._settled = settled
        contact, self.search = found
        self._touches = contact is not None
        return self._told_of(contact)

    @or_numpy
    def _find(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        start: ContactSearch,
        settled: Settled | None,
    ) -> tuple[ContactSolution | None, ContactSearch] | None:
        """Contact of a step, and what the next search begins with; None where loops did not find forces."""
        self._look_around(points, dt, settled)
        look, decided = self._looked_at(points.displacement, obstacles, dt), None
        are_near, N, begun = look.gaps <= self._due(points, obstacles, dt), len(look.gaps), self._begun[1]
        swung, outwards = begun.swung, _NO_OUTWARDS
        if settled is not None:
            outwards, decided = settled.outwards(_NO_OUTWARDS), settled.decided()
        if decided is not None:
            are_near |= decided.chosen
            swung = swung if decided.braking is None else decided.braking.swung_before
        near, friction = are_near.nonzero()[0], float(self.law.friction)
        pairs, n = pairs_from(start.forces[near], friction), int(np.searchsorted(near, self._own.start))
        pairs.axes[:, 0] = look.normals[near]
        forces, motion = np.empty((len(self.points), 3)), np.stack([points.free_velocity, points.velocity])
        moving = _moving_beside(near[:n], look, obstacles, len(self.points))
        nodes, maps = map(in_plain, self._moved_by(near))
        of_pairs = nodes, maps, n, look.gaps[near], moving, begun.forces[near]
        known = outwards[near] if len(outwards) else outwards, _decided_before(decided, near)
        before = np.zeros(len(near), dtype=np.int64) if swung is None else swung[near].astype(np.int64)
        given = *self._laws(dt, quasi_static), in_plain(delassus), motion, *of_pairs, *known, before
        found = find_pair_forces(*given, pairs, forces)
        if found.status == OTHERWISE:
            return None
        braked = None
        if friction and not quasi_static and (settled is not None or pairs.helped.any()):
            braked = Braking(_among(N, near, pairs.target[:, 1:]).T.copy(), swung)
            if pairs.helped.any():
                braked.know(_among(N, near, pairs.helped), _among(N, near, pairs.relative[:, 1:]).T / 2)
        chosen = pairs.chosen
        if settled is not None:
            settled.keep(_among(N, near, chosen), _among(N, near, pairs.free[:, 0]), braked)
        if found.status != FOUND:
            return None, start._replace(swung=None)
        active, w, power = near[chosen], obstacles.velocities(dt)[:, :3], found.normal_power if friction else None
        told = forces, found.sweeps, active, look.normals[active], pairs.forces[chosen], w, power
        contact = ContactSolution(*told, surface_velocities=look.surface(active))
        swung = None if braked is None else braked.swung
        return contact, start._replace(forces=_among(N, near, pairs.forces), laws=(), swung=swung)

    def _laws(self, dt: float, quasi_static: bool) -> tuple[Law, Law]:
        """That of pairs with obstacles, and of those of the body with itself."""
        radii = [float(obstacle.core[0]) for obstacle in self.obstacles[: self._O]]
        given = float(self.law.restitution), float(self.law.friction), *self.law.in_steps(dt), quasi_static, SWINGS
        return Law(dt, *given, min(radii, default=np.inf)), Law(dt, *given, self._itself.core[0])

    def _due(self, points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
        """The largest gap, m, of pairs that may be due; also of springs."""
        of_obstacles = reach_of(points, self.points, obstacles, dt) * max(1.0, -1 / (self.law.in_steps(dt)[0] * dt))
        return max(of_obstacles, self.reach)

    def _between(self, delassus: Array, pairs: Array) -> Array:
        """As in SelfContact."""
        (nodes, maps), between = map(in_plain, self._moved_by(pairs)), np.empty((3 * len(pairs),) * 2)
        set_operator(in_plain(delassus), nodes, maps, between)
        return between

    def _corner_maps(self, opposite: Opposite) -> Array:
        """As in SelfContact."""
        maps = np.empty((len(opposite.nodes), 3, 3, 3))
        set_corner_maps(in_plain(self._middle), self._itself.row, opposite.nodes, opposite.weights, maps)
        return maps


def _moving_beside(pairs: Array, look: Look, obstacles: ObstacleMotion, points: int) -> Beside:
    """How obstacles move at pairs (n,) of so many points with these."""
    if look.turning is not None:
        return Beside(look.w[pairs], look.turning.now[pairs], look.turning.first[pairs])
    owner = pairs // points
    return Beside(look.w[owner, :3], obstacles.velocities_before[owner, :3], np.empty((0, 3)))


def _decided_before(decided: Decided | None, pairs: Array) -> tuple[Array, Array, Array]:
    """What sweeps before have decided of pairs (n,), as of `find_pair_forces`."""
    if decided is None:
        return _NOBODY, _NOBODY, _NO_OUTWARDS
    braked = decided.braking
    if braked is None or braked.helped is None:
        return decided.chosen[pairs], _NOBODY, _NO_OUTWARDS
    return decided.chosen[pairs], braked.helped[pairs], 2 * braked.slopes[pairs]


def _among(count: int, pairs: Array, values: Array) -> Array:
    """Values of some pairs (n, ...) among those of so many, the others 0."""
    every = np.zeros((count, *values.shape[1:]), values.dtype)
    every[pairs] = values
    return every
