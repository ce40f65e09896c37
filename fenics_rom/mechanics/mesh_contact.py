"""Contact with meshes that are not convex: a point meets all planes that its way in a step goes through.

A step that ends before the plane of the nearest place does not enter a convex obstacle. In the corner of a room, a
groove or a bowl there are other planes that it may go through. So forces are found with the plane of the nearest place
alone; then the ways of all points are looked at that these lead to. Where one goes through a triangle, from before it,
the plane of this triangle is added, and forces are found anew, until no way goes through any. All planes obey the law
of `contact_solver`, which does no work, however many they are.

By that law a pair takes part a step before it has to be stopped. So a way is that of the step, and half of the next one
with the velocity that the step ends with.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.delassus import operator_among, operator_between
from fenics_rom.mechanics.contact import ContactLaw, ContactSolution, ObstacleMotion, PointMotion
from fenics_rom.mechanics.contact_look import Look
from fenics_rom.mechanics.contact_pairs import Settled
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacle_poses import distance_from, rotated, rotated_back, seen
from fenics_rom.mechanics.obstacles import HalfSpace, Mesh, Obstacle
from fenics_rom.mechanics.points_operator import Operator, moved_by
from fenics_rom.mechanics.reach import reach_of
from fenics_rom.mechanics.triangle_surface import MORE_PLANES, SAME, TriangleSurface

_PLANE = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # stands for those that are added: it is flat
_ONES = np.ones(3)


class MeshContact(ContactSolver):
    """Of obstacles of which some are meshes that are not convex. Arguments as in ContactSolver.

    Attributes:
        obstacles: those that are given, and after them planes of the meshes that may be added in a step.
        reach: the largest gap, m, with which points of the body may be due to meet one another in a step.
    """

    reach = 0.0

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        given = tuple(obstacles)
        meshes = [number for number, each in enumerate(given) if not each.is_convex]
        added = [number for number in meshes for _ in range(MORE_PLANES)]
        super().__init__(points, (*given, *[_PLANE] * len(added)), law)
        self._given, self._meshes, self.keeps_out = given, meshes, bool(meshes)
        self._owner = np.array([*range(len(given)), *added])  # which obstacle each of them is
        self._planes: _Planes | None = None  # of a step
        self._settled: Settled | None = None
        self._motion: _KnownMotion | None = None  # of all planes, in a step
        self._looked: Look | None = None
        self._seen_at: tuple[Look, Array, object, object] | None = None  # the last look, and what it is of

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
        if settled is None or settled is not self._settled:
            self._planes = self._motion = None
        if self._motion is None:
            self._motion = _KnownMotion.of(obstacles, self._owner)
        motion = self._motion
        self._settled = settled
        x, at_start = points.displacement, self._distances(points.displacement, motion.start)
        at_end = at_start if motion.end is motion.start else self._distances(x, motion.end) if motion.turns else None
        self._planes = _Planes(x, motion.start, at_start, motion.end, at_end)
        begun = self.search
        while True:
            self.search = begun
            contact = self._forces(points, delassus, dt, motion, quasi_static, settled, is_patient)
            if self.law.stiffness is not None or not self._meshes:
                break  # springs push along the way to the nearest place
            middle = points.free_velocity
            if contact is not None:
                middle = middle + moved_by(delassus, contact.forces).reshape(middle.shape)
            if not self._add_planes(middle, points, dt, motion, quasi_static):
                break
            begun = begun._replace(laws=())  # what is followed is asked of the nearest places alone
        if contact is None:
            return None
        obstacle, point = np.divmod(contact.pairs, len(self.points))
        pairs = self._owner[obstacle] * len(self.points) + point
        return contact._replace(pairs=pairs, obstacle_velocities=motion.velocities(dt)[: len(obstacles.start), :3])

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
        """As `solve`, with the planes that there are."""
        return super().solve(points, delassus, dt, obstacles, quasi_static, settled, is_patient)

    def _looked_at(self, displacement: Array, obstacles: ObstacleMotion, dt: float) -> Look:
        """As in ContactSolver."""
        known, planes = self._seen_at, self._planes
        of = displacement, None if planes is None else planes.at_start, obstacles
        if known is None or any(one is not other for one, other in zip(known[1:], of, strict=True)):
            self._seen_at = known = super()._looked_at(displacement, obstacles, dt), *of
        self._looked = known[0]
        return self._looked

    def _distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """As in ContactSolver; of planes that are not there gaps are infinite."""
        if self._planes is not None and (known := self._planes.known(displacement, offsets)) is not None:
            return known
        placed = self.points + displacement
        found = [distance_from(shape, placed, row) for shape, row in zip(self._given, offsets, strict=False)]
        normals = [found[number][1] for number in self._owner]
        missing = np.full(len(placed) * (len(self.obstacles) - len(self._given)), np.inf)
        return np.concatenate([*(gaps for gaps, _ in found), missing]), np.concatenate(normals)

    def _renew(self, pairs: slice, gaps: Array, normals: Array) -> None:
        """Sets gaps and normals of some pairs, which change from sweep to sweep, in what planes were added to."""
        if (planes := self._planes) is None:
            return

        def renewed(known: tuple[Array, Array]) -> tuple[Array, Array]:
            both = known[0].copy(), known[1].copy()  # others have kept those before
            both[0][pairs], both[1][pairs] = gaps, normals
            return both

        at_end = None if planes.at_end is None else renewed(planes.at_end)
        self._planes = planes._replace(at_start=renewed(planes.at_start), at_end=at_end)

    def _moved_by(self, pairs: Array) -> tuple[Array, Array]:
        """Points (C, k) that pairs (C,) move with, and what the velocity of each adds to theirs, (C, k, 3, 3)."""
        return pairs[:, None] % len(self.points), np.tile(np.eye(3), (len(pairs), 1, 1, 1))

    def _due(self, points: PointMotion, obstacles: ObstacleMotion, dt: float) -> float:
        """The largest gap, m, with which points and obstacles may be due."""
        return reach_of(points, self.points, obstacles, dt)

    def _between(self, delassus: Operator, pairs: Array) -> Array:
        """Relative velocities of pairs (C,) per force of each, (3C, 3C)."""
        nodes, maps = self._moved_by(pairs)
        return operator_between(*operator_among(delassus, nodes), maps)

    def _add_planes(
        self, middle: Array, points: PointMotion, dt: float, obstacles: ObstacleMotion, quasi_static: bool
    ) -> bool:
        """Adds planes of triangles that points go through at mid-step velocities (P, 3), m/s; whether there are any."""
        assert self._planes is not None
        known, each, are_added = self._planes, (len(self.obstacles), len(self.points)), False
        (gaps, normals), at_end = known.at_start, known.at_end if obstacles.turns else None
        gaps, normals = gaps.reshape(each).copy(), normals.reshape(*each, 3).copy()
        used, looked = (gaps, normals), self._looked  # planes that the law has been asked of, where they end
        if at_end is not None and looked is not None:
            later, turned = at_end[0].reshape(each).copy(), at_end[1].reshape(*each, 3).copy()
            ends = looked.gaps - dt * (looked.w * looked.normals).dot(_ONES)
            used = ends.reshape(each), looked.normals.reshape(*each, 3)
        places = self.points + points.displacement
        w = obstacles.velocities_at(places, dt)[0] if obstacles.turns else obstacles.velocities(dt)[:, None]
        for number in self._meshes:
            mesh = self._given[number]
            assert isinstance(mesh, Mesh)
            first, last = obstacles.start[number], obstacles.end[number]
            start, end = seen(places, first), seen(places + dt * middle, last)
            later_way = dt * (middle - (points.velocity + w[number]) / 2)
            later_end = end if quasi_static else end + rotated_back(later_way, last)
            point, triangle = _crossed(mesh.surface, start, end, later_end, gaps[number])
            gap, normal = mesh.surface.planes(triangle, start[point])
            own, tolerance = (self._owner == number).nonzero()[0], SAME * mesh.surface.size
            there, along = gap, rotated(normal, first)
            if at_end is not None:
                there, along = mesh.surface.planes(triangle, seen(places[point], last))[0], rotated(normal, last)
            are_same = (used[1][own][:, point] * along).dot(_ONES) >= 1 - SAME
            are_same &= np.abs(used[0][own][:, point] - there) <= tolerance
            free = np.isinf(gaps[own][:, point])
            new = (gap >= -tolerance) & ~are_same.any(axis=0) & free.any(axis=0)
            slot, point = own[free.argmax(axis=0)[new]], point[new]
            gaps[slot, point], normals[slot, point] = gap[new], rotated(normal[new], first)
            if at_end is not None:
                later[slot, point], turned[slot, point] = there[new], along[new]
            are_added |= len(point) > 0
        if are_added:
            known = known._replace(at_start=(gaps.ravel(), normals.reshape(-1, 3)))
            if at_end is not None:
                known = known._replace(at_end=(later.ravel(), turned.reshape(-1, 3)))
            self._planes = known
        return are_added


class _KnownMotion(ObstacleMotion):
    """How all planes move in a step, which is found once where that is solved in sweeps."""

    _mean: Array | None = None  # velocities
    _there: tuple[Array, tuple[Array, Array]] | None = None  # places, and velocities of what is there

    @classmethod
    def of(cls, obstacles: ObstacleMotion, owner: Array) -> "_KnownMotion":
        """Of planes (any,) of these obstacles."""
        start, end, before = (of.take(owner, axis=0) for of in obstacles)
        return cls(start, start if obstacles.end is obstacles.start else end, before)

    def velocities(self, dt: float) -> Array:
        """As in ObstacleMotion, of one step."""
        if self._mean is None:
            self._mean = super().velocities(dt)
        return self._mean

    def velocities_at(self, places: Array, dt: float) -> tuple[Array, Array]:
        """As in ObstacleMotion, of one step."""
        if self._there is None or not np.array_equal(self._there[0], places):
            self._there = places, super().velocities_at(places, dt)
        return self._there[1]


class _Planes(NamedTuple):
    """Gaps (O P,), m, and normals (O P, 3) of points that have moved by a displacement (P, 3), m."""

    displacement: Array
    start: Array  # rows of the obstacles at the start of the step
    at_start: tuple[Array, Array]
    end: Array  # at its end
    at_end: tuple[Array, Array] | None  # None where none turns

    def known(self, displacement: Array, offsets: Array) -> tuple[Array, Array] | None:
        """Those of the start or the end, if these are asked for."""
        if displacement is not self.displacement:
            return None
        return self.at_start if offsets is self.start else self.at_end if offsets is self.end else None


def _crossed(surface: TriangleSurface, start: Array, end: Array, later: Array, gaps: Array) -> tuple[Array, Array]:
    """Points (k,) whose ways from start to end and on to later, (P, 3) each, m, go through triangles, and which first.

    gaps: (P,), m, that ways have to be as long as.
    """
    lengths = [np.sqrt(np.square(way).dot(_ONES)) for way in (end - start, later - end)]
    far = (sum(lengths) >= gaps).nonzero()[0]
    ways = (np.concatenate(ends) for ends in ((start[far], end[far]), (end[far], later[far])))
    crossed, then = np.split(surface.first_crossed(*ways), 2)
    first = np.where(crossed < 0, then, crossed)
    return far[first >= 0], first[first >= 0]
