"""Springs of contact that would let points through: such a step is taken by the rigid law, and points stay before it.

Springs know how deep a point is, and nothing of what is behind. They would let it go on through a thin obstacle, which
then pushes it out on its other side. So the ways are looked at that the forces of springs lead to. A way goes through

    a ball, rod or box  if it ends deeper behind the plane before it than the largest ball that the obstacle holds;
    a mesh              if it comes out on a side that faces the other way, or ends nearer to that one;
    the body itself     if it ends deeper behind its plane than a quarter of the wall, or half a triangle, there.

Then the step is taken anew without springs: points do not go on through any plane, c = min(-g/h, 0). As c <= 0, that
does no work on the body. What springs hold they keep for the steps after it.
"""

import math
from typing import TypeVar, cast

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.contact import ContactSolution, ObstacleMotion, PointMotion, rigid_law
from fenics_rom.mechanics.contact_pairs import Pairs, Settled, SolvedPairs
from fenics_rom.mechanics.contact_solver import ContactSolver, LastStep
from fenics_rom.mechanics.obstacle_poses import seen
from fenics_rom.mechanics.obstacles import Mesh, Obstacle
from fenics_rom.mechanics.points_operator import Operator, moved_by

OTHER_WAY = -0.5  # cosine between normals: sides of which one faces the other way
_ONES = np.ones(3)
_Contact = TypeVar("_Contact", bound=ContactSolver)


def with_springs(kind: type[_Contact]) -> type[_Contact]:
    """The same kind of contact, whose springs let nothing through."""
    return cast(type[_Contact], type(f"Held{kind.__name__}", (HeldSprings, kind), {}))


class HeldSprings(ContactSolver):
    """Arguments and attributes as in ContactSolver; the law has springs.

    Attributes:
        is_held: whether the last step was taken without springs.
    """

    is_held = False
    _held_in: Settled | None = None  # the step whose sweeps are without springs

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
        step, begun, depth = (points, delassus, dt, obstacles, quasi_static, settled, is_patient), self.search, 0.0
        self.is_held = settled is not None and settled is self._held_in
        if not self.is_held:
            contact = super().solve(*step)
            depth = self._depth_gone(points, delassus, dt, obstacles, contact)
            if not depth:
                return contact
            self.search, self.is_held, self._held_in = begun, True, settled
        springs, keeps_out = self.law, self.keeps_out
        self.law, self.keeps_out = rigid_law(springs), True
        try:
            contact = super().solve(*step)
        finally:
            self.law, self.keeps_out = springs, keeps_out
        self.search = self.search._replace(held=begun.held.with_springs(depth))
        return contact

    @property
    def last_step(self) -> LastStep:
        """As in ContactSolver."""
        told = super().last_step
        if not self.is_held:
            return told

        def known() -> tuple[Pairs | None, SolvedPairs | None]:
            springs, keeps_out = self.law, self.keeps_out
            self.law, self.keeps_out = rigid_law(springs), True
            try:
                return told()
            finally:
                self.law, self.keeps_out = springs, keeps_out

        return known

    def _depth_gone(
        self,
        points: PointMotion,
        delassus: Operator,
        dt: float,
        obstacles: ObstacleMotion,
        contact: ContactSolution | None,
    ) -> float:
        """How deep, m, the deepest of points goes that go through something with such forces; 0: none does."""
        velocity, places, deepest = points.free_velocity, self.points + points.displacement, 0.0
        if contact is not None:
            velocity = velocity + moved_by(delassus, contact.forces).reshape(velocity.shape)
        ends = places + dt * velocity
        for obstacle, first, last in zip(self.obstacles, obstacles.start, obstacles.end, strict=False):
            if isinstance(obstacle, Mesh):
                gone = _through_mesh(obstacle, seen(places, first), seen(ends, last))
            elif contact is None or math.isinf(obstacle.core[0]):
                continue
            else:
                gone = _through(obstacle, seen(places, first), seen(ends, last))
            deepest = max(deepest, float(gone.max(initial=0.0)))
        return deepest if contact is None else max(deepest, self.depth_inside(points, velocity, dt, obstacles))


def _through(obstacle: Obstacle, starts: Array, ends: Array) -> Array:
    """How deep, m, points (P, 3) go that end (P, 3) deeper than what is convex is thick; 0 of others, (P,)."""
    gaps, normals = obstacle.distance(starts)
    goes = (normals * (ends - starts)).dot(_ONES)
    depth = -(gaps + goes)
    return np.where((goes < 0) & (depth > obstacle.core[0]), depth, 0.0)


def _through_mesh(mesh: Mesh, starts: Array, ends: Array) -> Array:
    """How far, m, points (P, 3) go that come out of a mesh, or end (P, 3), on another side; 0 of others, (P,)."""
    surface, gone = mesh.surface, np.zeros(len(starts))
    _, side = mesh.distance(starts)
    came, left = surface.first_crossed(starts, ends), surface.first_crossed(ends, starts)
    side = np.where(came[:, None] >= 0, surface.normals[came], side)
    after, beside = mesh.distance(ends)
    is_through = (left >= 0) & ((side * surface.normals[left]).dot(_ONES) < OTHER_WAY)
    is_through |= (after < 0) & ((side * beside).dot(_ONES) < OTHER_WAY)
    way = ends - starts
    is_through &= (side * way).dot(_ONES) < 0
    gone[is_through] = np.sqrt(np.square(way[is_through]).dot(_ONES))
    return gone
