"""Contact with meshes and of faces by compiled loops; forces that these do not find are NumPy's.

Pairs that are near are handed to the loops as points of their own, with their relative velocities and operator.
"""

from copy import copy
from typing import TypeVar, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, jit, or_numpy
from fenics_rom.mechanics import braking
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import NOTHING, OTHERWISE, Law, pairs_from
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.own_pairs import set_operator
from fenics_rom.mechanics.complementarity.delassus import axes_along
from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_pairs import Pairs, Settled, SolvedPairs
from fenics_rom.mechanics.contact_search import ContactSearch
from fenics_rom.mechanics.mesh_contact import MeshContact

_UNKNOWN, _ONES = in_one_piece(np.empty((0, 0))), np.ones(3)
_Contact = TypeVar("_Contact", bound=MeshContact)
_Found = tuple[ContactSolution | None, ContactSearch]
find_forces = jit(contact_law.find_forces)


def by_loops(kind: type[_Contact]) -> type[_Contact]:
    """The same kind of contact, whose forces compiled loops find."""
    return cast(type[_Contact], type(f"Compiled{kind.__name__}", (CompiledPairs, kind), {}))


class CompiledPairs(MeshContact):
    """Arguments and attributes as in MeshContact."""

    def _forces(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        settled: Settled | None,
        is_patient: bool,
    ) -> ContactSolution | None:
        """As in MeshContact."""
        begun, decided = self._begin(points), copy(settled)
        again, step = copy(self), (points, delassus, dt, obstacles, quasi_static)
        found = self._find(points, delassus, dt, obstacles, quasi_static, begun, settled)
        if found is None:
            return super()._forces(*step, settled, is_patient)

        def known() -> tuple[Pairs | None, SolvedPairs | None]:
            MeshContact._forces(again, *step, decided, is_patient)
            return again._considered, again._solved

        contact, self.search = found
        self._touches, self._told = contact is not None, known
        return contact

    @or_numpy
    def _find(
        self,
        points: PointMotion,
        delassus: Array,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
        begun: ContactSearch,
        settled: Settled | None,
    ) -> _Found | None:
        """Contact of a step, and what the next search begins with; None where loops did not find forces."""
        look, decided = self._looked_at(points.displacement, obstacles, dt), None
        is_near = look.gaps <= max(self._due(points, obstacles, dt), self.reach)
        if settled is not None and (decided := settled.decided()) is not None:
            is_near |= decided.chosen
        near, N = is_near.nonzero()[0], len(is_near)
        nothing = None, begun._replace(swung=None)
        if not len(near):
            self.clear = look.gap
            return nothing
        normals, μ = look.normals, float(self.law.friction)
        slides, swung = μ > 0 and not quasi_static, begun.swung
        free, relative = self._relative(points, obstacles, look)
        approach, outwards = ((normals * each).dot(_ONES) for each in (relative, free))
        leaving = outwards if settled is None else settled.outwards(outwards)
        asked = self._asked(look, obstacles, dt, quasi_static)(approach, leaving)
        pairs = pairs_from(begun.forces[near], μ)
        pairs.axes[:] = axes_along(normals[near]).transpose(0, 2, 1)
        pairs.free[:], pairs.relative[:] = (
            np.einsum("cij,cj->ci", pairs.axes, each[near]) for each in (free, relative)
        )
        pairs.level[:], pairs.target[:, 0] = asked.level[near], asked.target[near]
        pairs.target[:, 1:] = pairs.relative[:, 1:] / 2 if slides else 0.0
        pairs.chosen[:], pairs.helped[:] = pairs.free[:, 0] < pairs.level, False
        if decided is not None:
            pairs.chosen[:] |= decided.chosen[near]
            if decided.braking is not None:
                swung = decided.braking.swung_before
                if decided.braking.helped is not None:
                    pairs.helped[:] = decided.braking.helped[near]
                    pairs.target[:, 1:] *= 2 * decided.braking.slopes[near, None]
        if not pairs.chosen.any():
            return nothing
        far = self.rule(dt, quasi_static).too_far
        if far is not None and (far[near] > 1)[pairs.chosen].any():
            return None  # NumPy's step tells of it
        before = np.zeros(len(near), dtype=np.int64) if swung is None else swung[near].astype(np.int64)
        given = *self.law.in_steps(dt), quasi_static, braking.SWINGS, np.inf
        numbers = Law(dt, float(self.law.restitution), μ, *given)
        _, operator = self.operator_of(delassus, is_near, is_near.tobytes())
        found = find_forces(numbers, in_plain(operator.matrix), _UNKNOWN, len(near), before, pairs)
        if found.status == OTHERWISE:
            return None

        def of_all(values: Array) -> Array:
            whole = np.zeros((N, *values.shape[1:]), dtype=values.dtype)
            whole[near] = values
            return whole

        stopping = None
        if slides:
            stopping = braking.Braking(of_all(pairs.target[:, 1:]).T, swung)
            if pairs.helped.any():
                stopping.know(of_all(pairs.helped), of_all(pairs.relative[:, 1:]).T / 2)
        if settled is not None:
            settled.keep(of_all(pairs.chosen), outwards, stopping)
        if found.status == NOTHING:
            return nothing
        forces, active = of_all(pairs.forces), near[pairs.chosen]
        told = self._at_points(forces), found.sweeps, active, normals[active], forces[active]
        power, w = found.normal_power if μ else None, obstacles.velocities(dt)[:, :3]
        contact = ContactSolution(*told, w, power, surface_velocities=look.surface(active))
        kept = ContactSearch(forces, begun.residual, held=begun.held, slots=begun.slots)
        return contact, kept._replace(swung=None if stopping is None else stopping.swung)

    def _between(self, delassus: Array, pairs: Array) -> Array:
        """As in MeshContact."""
        (nodes, maps), between = map(in_plain, self._moved_by(pairs)), np.empty((3 * len(pairs),) * 2)
        set_operator(in_plain(delassus), nodes, maps, between)
        return between
