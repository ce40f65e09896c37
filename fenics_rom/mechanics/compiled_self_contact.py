"""Contact of a body with itself by compiled loops, where numba is; forces that these do not find are `SelfContact`'s.

Pairs that are near are handed to the loops as points of their own, with their relative velocities and operator.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, Law
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.compiled.own_pairs import find_pair_forces, set_corner_maps
from fenics_rom.mechanics.compiled_contact import NO_OUTWARDS, Told
from fenics_rom.mechanics.compiled_pairs import FoundNear, Near, NearContact, among
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, Opposite, PointMotion
from fenics_rom.mechanics.contact_look import Look
from fenics_rom.mechanics.contact_pairs import Decided, Settled
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.points_operator import Operator, part_with
from fenics_rom.mechanics.self_contact import SelfContact, beside

_NOBODY = np.empty(0, dtype=bool)


class CompiledSelfContact(NearContact, SelfContact):
    """Arguments and attributes as in SelfContact; of obstacles that are convex."""

    def solve(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool = False,
        settled: Settled | None = None,
        is_patient: bool = True,
    ) -> ContactSolution | None:
        """As in ContactSolver."""
        self._last = self.search, self._begun, lambda: (points, delassus, dt, obstacles, quasi_static)
        self._look_around(points, dt, settled)
        found = self._find(points, delassus, dt, beside(obstacles), quasi_static, settled)
        if found is None or self._add_crossings(points, delassus, dt, found[0]):
            return super().solve(points, delassus, dt, obstacles, quasi_static, settled, is_patient)
        self._settled = settled
        contact, self.search = found
        self._touches = contact is not None
        return self._told_of(contact)

    @property
    def is_alone(self) -> bool:
        """Whether the body touches itself alone, by the rigid law: as compiled steps know it."""
        return self._O == 0 and self.law.stiffness is None

    def own_law(self, dt: float) -> Law:
        """That of the body with itself in steps of dt, s."""
        return Law.of(self.law, dt, False, self._itself.core[0])

    def keep(
        self, told: Told, opposite: Opposite, tell: Callable[[], tuple[Any, ...]], obstacles: ObstacleMotion
    ) -> ContactSolution | None:
        """Contact of a step that compiled loops found; the next search begins with it. None where nothing touches.

        Args:
            told: what they found.
            opposite: what each of all points meets, (P, 3), if it takes part.
            tell: tells what `solve` would have been given.
            obstacles: none of them.
        """
        start, asked, self._told = self.search, told.braking, None
        self._last, self._settled = (start, (b"", start), tell), None
        swung = None if asked is None else asked.swung
        self._touches = self._has_touched = told.touches
        self.clear = 0.0
        if not told.touches:
            self.search = start._replace(swung=None)
            return None
        kept = ContactSearch(told.pairs.forces, start.residual, held=start.held, slots=start.slots)
        self.search = kept._replace(swung=swung)
        active = told.active
        contact = told.solution(obstacles.velocities_before, None)
        return contact._replace(opposite=Opposite(*(part[active] for part in opposite)))

    def _found_near(
        self,
        near: Near,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
    ) -> FoundNear | None:
        """As in NearContact."""
        if self.keeps_out or self._itself.crossing is not None:
            return None
        look, _, at, pairs, known, decided, swung = near
        n, before = int(np.searchsorted(at, self._own.start)), self._begun[1].forces_before[at]
        pairs.axes[:, 0] = look.normals[at]
        forces, motion = np.zeros((len(self.points), 3)), np.stack([points.free_velocity, points.velocity])
        moving = _moving_beside(at[:n], look, obstacles, len(self.points))
        nodes, maps = self._moved_by(at)
        W, own, some = part_with(delassus, nodes)
        of_pairs = in_plain(own), in_plain(maps), n, look.gaps[at], moving, before
        settled = known[at] if len(known) else known, _decided_before(decided, at)
        given = *self._laws(dt, quasi_static), in_plain(W), in_plain(motion[:, some]), *of_pairs, *settled, swung
        few = in_plain(forces[some])
        found = find_pair_forces(*given, pairs, few)
        forces[some] = few
        if found.status == OTHERWISE:
            return None
        return FoundNear(found, forces, among(len(look.gaps), at, pairs.free[:, 0]))

    def _laws(self, dt: float, quasi_static: bool) -> tuple[Law, Law]:
        """That of pairs with obstacles, and of those of the body with itself."""
        radius = min((obstacle.core[0] for obstacle in self.obstacles[: self._O]), default=np.inf)
        given = self.law, dt, quasi_static
        return Law.of(*given, radius), Law.of(*given, self._itself.core[0])

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
        return _NOBODY, _NOBODY, NO_OUTWARDS
    braked = decided.braking
    if braked is None or braked.helped is None:
        return decided.chosen[pairs], _NOBODY, NO_OUTWARDS
    return decided.chosen[pairs], braked.helped[pairs], 2 * braked.slopes[pairs]
