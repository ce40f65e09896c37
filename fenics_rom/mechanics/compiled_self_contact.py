"""Contact of a body with itself by compiled loops, where numba is; forces that these do not find are `SelfContact`'s.

Pairs that are near are handed to the loops as points of their own, with their relative velocities and operator.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, or_numpy
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import NOTHING, OTHERWISE, Law, pairs_from
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.own_surface import rows_between
from fenics_rom.mechanics.complementarity.delassus import axes_along
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.reach import reach_of
from fenics_rom.mechanics.self_contact import SelfContact, beside

_UNKNOWN, _ONES = in_one_piece(np.empty((0, 0))), np.ones(3)
find_forces = jit(contact_law.find_forces)


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
        """As in ContactSolver; sweeps are NumPy's."""
        self._last = self.search, self._begun, (points, delassus, dt, obstacles, quasi_static)
        if settled is None:
            start = self._begin(points)
            found = self._find(points, delassus, dt, beside(obstacles), quasi_static, start)
            if found is not None:
                contact, self.search = found
                self._touches = contact is not None
                return self._told_of(contact)
        return super().solve(points, delassus, dt, obstacles, quasi_static, settled, is_patient)

    @or_numpy
    def _find(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        start: ContactSearch,
    ) -> tuple[ContactSolution | None, ContactSearch] | None:
        """Contact of a step, and what the next search begins with; None where loops did not find forces."""
        self._look_around(points, dt)
        look = self._looked_at(points.displacement, obstacles, dt)
        gaps, normals = look.gaps, look.normals
        near = (gaps <= self._due(points, obstacles, dt)).nonzero()[0]
        nothing = None, start._replace(swung=None)
        if not len(near):
            return nothing
        w, μ, n = obstacles.velocities(dt)[:, :3], self.law.friction, len(near)
        free, relative = self._relative(points, obstacles, look)
        approach, outwards = ((normals * each).dot(_ONES) for each in (relative, free))
        asked = self._asked(look, obstacles, dt, quasi_static)(approach, outwards)
        pairs, slides = pairs_from(start.forces[near], float(μ)), μ > 0 and not quasi_static
        pairs.axes[:] = axes_along(normals[near]).transpose(0, 2, 1)
        pairs.free[:], pairs.relative[:] = (
            np.einsum("cij,cj->ci", pairs.axes, each[near]) for each in (free, relative)
        )
        pairs.level[:], pairs.target[:, 0] = asked.level[near], asked.target[near]
        pairs.target[:, 1:] = pairs.relative[:, 1:] / 2 if slides else 0.0
        pairs.chosen[:], pairs.helped[:] = pairs.free[:, 0] < pairs.level, False
        if not pairs.chosen.any():
            return nothing
        far = self.rule(dt, quasi_static).too_far
        if far is not None and (far[near] > 1)[pairs.chosen].any():
            return None  # NumPy's step tells of it
        swung = np.zeros(n, dtype=np.int64) if start.swung is None else start.swung[near].astype(np.int64)
        given = *self.law.in_steps(dt), quasi_static, braking.SWINGS, np.inf
        numbers = Law(dt, float(self.law.restitution), float(μ), *given)
        found = find_forces(numbers, self._between(delassus, near), _UNKNOWN, n, swung, pairs)
        if found.status == OTHERWISE:
            return None
        if found.status == NOTHING:
            return nothing
        forces, swings = np.zeros(normals.shape), None
        forces[near] = pairs.forces
        if slides and pairs.helped.any():
            swings = np.zeros(len(forces), dtype=int)
            swings[near] = braking.swung_with(pairs.helped, swung)
        active, power = near[pairs.chosen], found.normal_power if μ else None
        told = self._at_points(forces), found.sweeps, active, normals[active], forces[active], w, power
        contact = ContactSolution(*told, surface_velocities=look.surface(active))
        return contact, start._replace(forces=forces, laws=(), swung=swings)

    def _due(self, points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
        """The largest gap, m, of pairs that may be due; also of springs."""
        of_obstacles = reach_of(points, self.points, obstacles, dt) * max(1.0, -1 / (self.law.in_steps(dt)[0] * dt))
        return max(of_obstacles, self.reach)

    def _operator(self, W: Array, at: Array, maps: Array) -> Array:
        """As in SelfContact."""
        for _ in range(2):  # rows, then columns
            rows = np.empty((3 * len(at), W.shape[1]))
            rows_between(W, at, maps, rows)
            W = np.ascontiguousarray(rows.T)
        return W
