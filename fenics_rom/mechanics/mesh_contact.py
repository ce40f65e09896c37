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

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactLaw, ContactSolution, ObstacleMotion, PointMotion, moved_by
from fenics_rom.mechanics.contact_pairs import Asked, NormalLaw, Settled
from fenics_rom.mechanics.contact_solver import ContactSolver
from fenics_rom.mechanics.obstacles import HalfSpace, Mesh, Obstacle
from fenics_rom.mechanics.triangle_surface import MORE_PLANES, SAME, TriangleSurface

_PLANE = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # stands for those that are added: it is flat
_ONES = np.ones(3)


class MeshContact(ContactSolver):
    """Of obstacles of which some are meshes that are not convex. Arguments as in ContactSolver.

    Attributes:
        obstacles: those that are given, and after them planes of the meshes that may be added in a step.
    """

    _own = slice(0, 0)  # of all pairs those of the body with itself, where it touches itself

    def __init__(self, points: Array, obstacles: Sequence[Obstacle], law: ContactLaw):
        given = tuple(obstacles)
        meshes = [number for number, each in enumerate(given) if not each.is_convex]
        added = [number for number in meshes for _ in range(MORE_PLANES)]
        super().__init__(points, (*given, *[_PLANE] * len(added)), law)
        self._given, self._meshes = given, meshes
        self._owner = np.array([*range(len(given)), *added])  # which obstacle each of them is
        self._planes: tuple[Array, tuple[Array, Array]] | None = None  # displacement, gaps and normals of a step
        self._settled: Settled | None = None

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
        motion = ObstacleMotion(*(of.take(self._owner, axis=0) for of in obstacles))
        if obstacles.end is obstacles.start:
            motion = motion._replace(end=motion.start)
        if settled is None or settled is not self._settled:
            self._planes = None
        self._settled = settled
        self._planes = points.displacement, self._distances(points.displacement, motion.start)
        begun = self.search
        while True:
            self.search = begun
            contact = super().solve(points, delassus, dt, motion, quasi_static, settled, is_patient)
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
        return contact._replace(pairs=pairs, obstacle_velocities=obstacles.velocities(dt))

    def _asked(self, gaps: Array, gap: float, obstacles: ObstacleMotion, dt: float, quasi_static: bool) -> Asked:
        """As in ContactSolver; and no point goes on through a plane that the step before did not foresee."""
        asked = super()._asked(gaps, gap, obstacles, dt, quasi_static)
        if self.law.stiffness is not None or not self._meshes:
            return asked
        surface = np.minimum(-gaps / dt, 0.0)
        surface[self._own] = -np.inf

        def kept_out(approach: Array, outwards: Array) -> NormalLaw:
            law = asked(approach, outwards)
            return law._replace(target=np.maximum(law.target, surface))

        return kept_out

    def _distances(self, displacement: Array, offsets: Array) -> tuple[Array, Array]:
        """As in ContactSolver; of planes that are not there gaps are infinite."""
        if self._planes is not None and displacement is self._planes[0] and len(offsets) == len(self.obstacles):
            return self._planes[1]
        placed = self.points + displacement
        found = [obstacle.distance(placed - offset) for obstacle, offset in zip(self._given, offsets, strict=False)]
        normals = [found[number][1] for number in self._owner]
        missing = np.full(len(placed) * (len(self.obstacles) - len(self._given)), np.inf)
        return np.concatenate([*(gaps for gaps, _ in found), missing]), np.concatenate(normals)

    def _add_planes(
        self, middle: Array, points: PointMotion, dt: float, obstacles: ObstacleMotion, quasi_static: bool
    ) -> bool:
        """Adds planes of triangles that points go through at mid-step velocities (P, 3), m/s; whether there are any."""
        assert self._planes is not None
        displacement, (gaps, normals) = self._planes
        gaps, normals = gaps.reshape(len(self.obstacles), -1).copy(), normals.reshape(len(self.obstacles), -1, 3).copy()
        w, are_added = obstacles.velocities(dt), False
        for number in self._meshes:
            mesh = self._given[number]
            assert isinstance(mesh, Mesh)
            start = self.points + displacement - obstacles.start[number]
            end = start + dt * (middle - w[number])
            later = end if quasi_static else end + dt * (middle - (points.velocity + w[number]) / 2)
            point, triangle = _crossed(mesh.surface, start, end, later, gaps[number])
            gap, normal = mesh.surface.planes(triangle, start[point])
            own = (self._owner == number).nonzero()[0]
            of_point, tolerance = gaps[own][:, point], SAME * mesh.surface.size
            are_same = (normals[own][:, point] * normal).dot(_ONES) >= 1 - SAME
            are_same &= np.abs(of_point - gap) <= tolerance
            free = np.isinf(of_point)
            new = (gap >= -tolerance) & ~are_same.any(axis=0) & free.any(axis=0)
            slot, point = own[free.argmax(axis=0)[new]], point[new]
            gaps[slot, point], normals[slot, point] = gap[new], normal[new]
            are_added |= len(point) > 0
        if are_added:
            self._planes = displacement, (gaps.ravel(), normals.reshape(-1, 3))
        return are_added


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
