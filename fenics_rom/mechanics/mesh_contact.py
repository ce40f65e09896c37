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
from fenics_rom.mechanics.triangle_surface import MORE_PLANES, SAME

_PLANE = HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # stands for those that are added: it is flat
_ONES = np.ones(3)


class MeshContact(ContactSolver):
    """Of obstacles of which some are meshes that are not convex. Arguments as in ContactSolver.

    Attributes:
        obstacles: those that are given, and after them planes of the meshes that may be added in a step.
    """

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
        begun = self.search._replace(laws=())  # of planes that may be others
        while True:
            self.search = begun
            contact = super().solve(points, delassus, dt, motion, quasi_static, settled, is_patient)
            if self.law.stiffness is not None:
                break  # springs push along the way to the nearest place
            if not self._add_planes(points, delassus, contact, dt, motion, quasi_static):
                break
        if contact is None:
            return None
        obstacle, point = np.divmod(contact.pairs, len(self.points))
        pairs = self._owner[obstacle] * len(self.points) + point
        return contact._replace(pairs=pairs, obstacle_velocities=obstacles.velocities(dt))

    def _asked(self, gaps: Array, gap: float, obstacles: ObstacleMotion, dt: float, quasi_static: bool) -> Asked:
        """As in ContactSolver; and no point goes on through a plane that the step before did not foresee."""
        asked = super()._asked(gaps, gap, obstacles, dt, quasi_static)
        if self.law.stiffness is not None:
            return asked
        surface = np.minimum(-gaps / dt, 0.0)

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
        self,
        points: PointMotion,
        delassus: Array,
        contact: ContactSolution | None,
        dt: float,
        obstacles: ObstacleMotion,
        quasi_static: bool,
    ) -> bool:
        """Adds planes that ways go through under these forces; whether there are any."""
        middle = points.free_velocity
        if contact is not None:
            middle = middle + moved_by(delassus, contact.forces).reshape(middle.shape)
        after = 0.0 if quasi_static else middle - points.velocity / 2  # half of what the step ends with
        assert self._planes is not None
        displacement, (gaps, normals) = self._planes
        gaps, normals = gaps.reshape(len(self.obstacles), -1), normals.reshape(len(self.obstacles), -1, 3)
        w, placed, are_added = obstacles.velocities(dt), self.points + displacement, False
        for number in self._meshes:
            mesh = self._given[number]
            assert isinstance(mesh, Mesh)
            start = placed - obstacles.start[number]
            end = start + dt * (middle - w[number])
            later = end + dt * (after - (0.0 if quasi_static else w[number] / 2))
            way = np.sqrt(np.square(end - start).dot(_ONES)) + np.sqrt(np.square(later - end).dot(_ONES))
            far = (way >= gaps[number]).nonzero()[0]
            if not len(far):
                continue
            crossed = mesh.surface.first_crossed(start[far], end[far])
            crossed = np.where(crossed < 0, mesh.surface.first_crossed(end[far], later[far]), crossed)
            rows = crossed >= 0
            point, gap, normal = far[rows], *mesh.surface.planes(crossed[rows], start[far[rows]])
            slots = np.concatenate([[number], np.flatnonzero(self._owner == number)[1:]])
            of_point = gaps[slots][:, point], normals[slots][:, point]
            is_known = (np.abs(of_point[0] - gap) <= SAME * mesh.surface.size) & (
                (of_point[1] * normal).dot(_ONES) >= 1 - SAME
            )
            free = np.isinf(of_point[0])
            new = (gap >= -SAME * mesh.surface.size) & ~is_known.any(axis=0) & free.any(axis=0)
            slot, point = slots[free.argmax(axis=0)[new]], point[new]
            if len(point):
                if not are_added:
                    gaps, normals, are_added = gaps.copy(), normals.copy(), True
                gaps[slot, point], normals[slot, point] = gap[new], normal[new]
        if are_added:
            self._planes = displacement, (gaps.ravel(), normals.reshape(-1, 3))
        return are_added
