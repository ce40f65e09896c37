"""Contact with meshes and of faces by compiled loops; forces that these do not find are NumPy's.

Pairs that are near are handed to the loops as points of their own, with their relative velocities and operator.
"""

from copy import copy
from typing import NamedTuple, TypeVar, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, or_numpy
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Found, Law, pairs_from
from fenics_rom.mechanics.compiled.contact_law import Pairs as NearPairs
from fenics_rom.mechanics.compiled.own_pairs import set_operator
from fenics_rom.mechanics.compiled_contact import NO_OUTWARDS, UNKNOWN, find_forces, keep_decided
from fenics_rom.mechanics.complementarity.delassus import axes_along
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_look import Look
from fenics_rom.mechanics.contact_pairs import Decided, Pairs, Settled, SolvedPairs
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.mesh_contact import MeshContact
from fenics_rom.mechanics.points_operator import Operator, part_with

_ONES = np.ones(3)
_Contact = TypeVar("_Contact", bound=MeshContact)


def by_loops(kind: type[_Contact]) -> type[_Contact]:
    """The same kind of contact, whose forces compiled loops find."""
    return cast(type[_Contact], type(f"Compiled{kind.__name__}", (CompiledPairs, kind), {}))


def among(count: int, pairs: Array, values: Array) -> Array:
    """Values of some pairs (n, ...) among those of so many, the others 0."""
    every = np.zeros((count, *values.shape[1:]), values.dtype)
    every[pairs] = values
    return every


class Near(NamedTuple):
    """Pairs that are near in a step."""

    look: Look  # at all pairs (N,)
    are: Array  # which of these are near (N,)
    at: Array  # their numbers (n,)
    pairs: NearPairs  # with forces to begin with
    outwards: Array  # of all pairs, as sweeps before have decided, m/s; (0,) where these have not
    decided: Decided | None
    swung: Array  # in how many steps in a row friction did not stop them (n,)


class FoundNear(NamedTuple):
    """What loops found of pairs that are near."""

    found: Found
    forces: Array  # on the points (P, 3), N
    outwards: Array  # normal velocities without contact of all pairs (N,), m/s


class NearContact(MeshContact):
    """Contact whose near pairs loops are handed. Arguments and attributes as in MeshContact."""

    @or_numpy
    def _find(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        settled: Settled | None,
    ) -> tuple[ContactSolution | None, ContactSearch] | None:
        """Contact of a step, and what the next search begins with; None where loops did not find forces."""
        start, outwards, decided = self._begin(points), NO_OUTWARDS, None
        look = self._looked_at(points.displacement, obstacles, dt)
        if settled is not None:
            outwards, decided = settled.outwards(NO_OUTWARDS), settled.decided()
        are_near, N = look.gaps <= max(self._due(points, obstacles, dt), self.reach), len(look.gaps)
        if decided is not None:
            are_near |= decided.chosen
        at, swung, nothing = are_near.nonzero()[0], self._begun[1].swung, (None, start._replace(swung=None))
        if not len(at):
            self.clear = look.gap
            return nothing
        if decided is not None and decided.braking is not None:
            swung = decided.braking.swung_before
        pairs = pairs_from(start.forces[at], float(self.law.friction))
        swings = np.zeros(len(at), dtype=np.int64) if swung is None else swung[at].astype(np.int64)
        near = Near(look, are_near, at, pairs, outwards, decided, swings)
        told = self._found_near(near, points, delassus, dt, obstacles, quasi_static)
        if told is None:
            return None
        found, forces, outwards = told
        stopping = None
        if self.law.friction and not quasi_static and (settled is not None or pairs.helped.any()):
            stopping = braking.Braking(among(N, at, pairs.target[:, 1:]).T.copy(), swung)
            if pairs.helped.any():
                stopping.know(among(N, at, pairs.helped), among(N, at, pairs.relative[:, 1:]).T / 2)
        if settled is not None:
            settled.keep(among(N, at, pairs.chosen), outwards, stopping)
        if found.status != FOUND:
            return nothing
        active, w = at[pairs.chosen], obstacles.velocities(dt)[:, :3]
        power = found.normal_power if self.law.friction else None
        known = forces, found.sweeps, active, look.normals[active], pairs.forces[pairs.chosen], w, power
        contact = ContactSolution(*known, surface_velocities=look.surface(active))
        kept = ContactSearch(among(N, at, pairs.forces), start.residual, held=start.held, slots=start.slots)
        return contact, kept._replace(swung=None if stopping is None else stopping.swung)

    def _found_near(
        self,
        near: Near,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
    ) -> FoundNear | None:
        """Asks the law of pairs, which are set, and finds forces; None where loops did not."""
        raise NotImplementedError

    def _between(self, delassus: Operator, pairs: Array) -> Array:
        """As in MeshContact."""
        (nodes, maps), between = self._moved_by(pairs), np.empty((3 * len(pairs),) * 2)
        W, at, _ = part_with(delassus, nodes)
        set_operator(in_plain(W), in_plain(at), in_plain(maps), between)
        return between


class CompiledPairs(NearContact):
    """Arguments and attributes as in MeshContact."""

    def _forces(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        settled: Settled | None,
        is_patient: bool,
    ) -> ContactSolution | None:
        """As in MeshContact."""
        again, decided, step = copy(self), copy(settled), (points, delassus, dt, obstacles, quasi_static)
        again._told = None  # of the step before, which else kept all before that
        found = self._find(*step, settled)
        if found is None:
            return super()._forces(*step, settled, is_patient)

        def known() -> tuple[Pairs | None, SolvedPairs | None]:
            MeshContact._forces(again, *step, decided, is_patient)
            return again._considered, again._solved

        contact, self.search = found
        self._touches, self._told = contact is not None, known
        return contact

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
        (look, are_near, at, pairs, known, decided, swung), μ = near, float(self.law.friction)
        normals, (free, relative) = look.normals, self._relative(points, obstacles, look)
        approach, outwards = ((normals * each).dot(_ONES) for each in (relative, free))
        asked = self._asked(look, obstacles, dt, quasi_static)(approach, known if len(known) else outwards)
        pairs.axes[:] = axes_along(normals[at]).transpose(0, 2, 1)
        pairs.free[:], pairs.relative[:] = (np.einsum("cij,cj->ci", pairs.axes, each[at]) for each in (free, relative))
        pairs.level[:], pairs.target[:, 0] = asked.level[at], asked.target[at]
        pairs.target[:, 1:] = pairs.relative[:, 1:] / 2 if μ > 0 and not quasi_static else 0.0
        pairs.chosen[:], pairs.helped[:] = pairs.free[:, 0] < pairs.level, False
        if decided is not None:
            keep_decided(pairs, decided, at)
        if not pairs.chosen.any():
            return FoundNear(Found(NOTHING, 0, 0.0), np.zeros((len(self.points), 3)), outwards)
        far = self.rule(dt, quasi_static).too_far
        if far is not None and (far[at] > 1)[pairs.chosen].any():
            return None  # NumPy's step tells of it
        _, operator = self.operator_of(delassus, are_near, are_near.tobytes())
        given = in_plain(operator.matrix), UNKNOWN, len(at), swung, pairs
        found = find_forces(Law.of(self.law, dt, quasi_static), *given)
        if found.status == OTHERWISE:
            return None
        return FoundNear(found, self._at_points(among(len(normals), at, pairs.forces)), outwards)
