"""Rigid obstacles: how far points are from them, and which way out.

The signed distance to a convex body is a convex function, so that with the unit normal n at x,
distance(x + d) >= distance(x) + n·d for every d: a step that keeps the right side positive does not penetrate.
A mesh need not be convex: then points meet more planes than one, those that their ways go through (`mesh_contact`).
An obstacle moves by translation only: evaluate it at points - offset.

Each refuses by a SceneError what it cannot be: vectors that are not three finite numbers, a radius or an edge that is
not finite and > 0, a normal or an axis of length 0.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.mesh_obstacle import Mesh
from fenics_rom.mechanics.obstacle_outline import BLOCK_CORNERS, BLOCK_EDGES, FLAT, Outline
from fenics_rom.mechanics.obstacle_parts import (
    SHORTEST_DIRECTION,
    check_positive,
    check_vector,
    keep,
    normalised,
    rotation_matrix_of,
    turning_of,
)

_ONES, _UP = np.ones(3), np.array([0.0, 0.0, 1.0])
_CORNERS = np.concatenate([np.zeros((1, 3), dtype=int), BLOCK_CORNERS])


class Obstacle(Protocol):
    """A rigid body."""

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""

    def curvature(self, points: Array) -> Array:
        """Second derivatives (P, 3, 3), 1/m, of the distance: by which normals turn with the points."""

    @property
    def core(self) -> tuple[float, Array]:
        """Radius, m, of the largest balls that it holds, infinite of a half-space, and centres (C, 3) of some, m."""

    @property
    def extent(self) -> float:
        """Radius of the ball about the origin of its axes that holds it, m; infinite of a half-space."""

    @property
    def outline(self) -> Outline:
        """What of it sticks out, that faces of a body can meet between their corners."""

    @property
    def is_convex(self) -> bool:
        """Whether it is, so that no step enters it that ends before the plane of the nearest place."""


@dataclass(frozen=True)
class HalfSpace:
    """All that lies behind a plane.

    Args:
        point: a point of the plane, m.
        normal: which way is out; of any length but 0.
    """

    is_convex: ClassVar = True
    point: Sequence[float]
    normal: Sequence[float]
    _n: Array = field(init=False, repr=False, compare=False)
    _level: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        point, normal = check_vector(self, "point"), check_vector(self, "normal")
        length = math.hypot(*normal)
        if not length > 0:
            raise SceneError("halfspace: normal: use a vector of any length but 0 (got length 0)")
        n = normal / length
        n /= math.hypot(*n)
        keep(self, _n=n, _level=float(point.dot(n)))

    @property
    def axes(self) -> Array:
        """Right-handed axes, orthonormal rows (3, 3), of which the last is the normal."""
        n = self._n
        if n[2] == 1:
            return np.identity(3)
        aside = np.cross(n, np.identity(3)[np.abs(n).argmin()])
        aside /= math.hypot(*aside)
        return np.array([aside, np.cross(n, aside), n])

    @property
    def height(self) -> float | None:
        """Of its plane, if its normal is the third axis, m."""
        return self._level if self._n[2] == 1 else None

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        normals = np.empty(points.shape)
        normals[:] = self._n
        return points.dot(self._n) - self._level, normals

    @property
    def core(self) -> tuple[float, Array]:
        """Of a half-space no ball is the largest."""
        return math.inf, np.empty((0, 3))

    @property
    def extent(self) -> float:
        """No ball holds it."""
        return math.inf

    @property
    def outline(self) -> Outline:
        """Of a half-space nothing sticks out."""
        return FLAT

    def curvature(self, points: Array) -> Array:
        """Second derivatives of the distance of points (P, 3), m: (P, 3, 3), 1/m."""
        return np.zeros((len(points), 3, 3))


@dataclass(frozen=True)
class Sphere:
    """A ball.

    Args:
        center: m.
        radius: m.
    """

    is_convex: ClassVar = True
    center: Sequence[float]
    radius: float
    _center: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        keep(self, _center=check_vector(self, "center"))
        check_positive(self, "radius")

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        length, normals = normalised(points - self._center, _UP)
        return length - self.radius, normals

    @property
    def core(self) -> tuple[float, Array]:
        """Its radius, m, and its centre (1, 3), m."""
        return self.radius, self._center[None]

    @property
    def extent(self) -> float:
        """Radius of the ball about the origin that holds it, m."""
        return math.hypot(*self._center) + self.radius

    @property
    def outline(self) -> Outline:
        """Its centre and radius."""
        return Outline(self._center[None], FLAT.edges, self.radius)

    def curvature(self, points: Array) -> Array:
        """Second derivatives of the distance of points (P, 3), m: (P, 3, 3), 1/m."""
        return turning_of(points - self._center, np.eye(3))


@dataclass(frozen=True)
class Capsule:
    """All that is nearer than a radius to a segment of a line.

    Args:
        start: one end of the segment, m.
        end: the other end, m.
        radius: m.
    """

    is_convex: ClassVar = True
    start: Sequence[float]
    end: Sequence[float]
    radius: float
    _start: Array = field(init=False, repr=False, compare=False)
    _axis: Array = field(init=False, repr=False, compare=False)
    _per_length: Array = field(init=False, repr=False, compare=False)
    _perpendicular: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        start, end = check_vector(self, "start"), check_vector(self, "end")
        check_positive(self, "radius")
        axis = end - start
        square = float(axis.dot(axis))
        if not square > 0:
            raise SceneError("capsule: use a start and an end that differ, or a sphere (got the same)")
        perpendicular = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        perpendicular /= np.linalg.norm(perpendicular)
        keep(self, _start=start, _axis=axis, _per_length=axis / square, _perpendicular=perpendicular)

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        from_start = points - self._start
        along = from_start.dot(self._per_length)
        np.minimum(along, 1.0, out=along)
        np.maximum(along, 0.0, out=along)
        length, normals = normalised(from_start - along[:, None] * self._axis, self._perpendicular)
        return length - self.radius, normals

    @property
    def core(self) -> tuple[float, Array]:
        """Its radius, m, and both ends of its axis (2, 3), m."""
        return self.radius, np.stack([self._start, self._start + self._axis])

    @property
    def extent(self) -> float:
        """Radius of the ball about the origin that holds it, m."""
        return max(math.hypot(*self.start), math.hypot(*self.end)) + self.radius

    @property
    def outline(self) -> Outline:
        """Its axis and radius."""
        return Outline(self.core[1], np.array([[0, 1]]), self.radius)

    def curvature(self, points: Array) -> Array:
        """Second derivatives of the distance of points (P, 3), m: (P, 3, 3), 1/m."""
        from_start = points - self._start
        along = from_start.dot(self._per_length)
        beside = (along > 0) & (along < 1)
        across = np.eye(3) - beside[:, None, None] * np.outer(self._axis, self._per_length)
        return turning_of(from_start - np.clip(along, 0.0, 1.0)[:, None] * self._axis, across)


@dataclass(frozen=True)
class Box:
    """A block with flat faces.

    Args:
        center: m.
        size: full lengths of the edges, m.
        rotation: axis times angle, rad (Rodrigues' formula), by which it is turned about its center.
    """

    is_convex: ClassVar = True
    center: Sequence[float]
    size: Sequence[float]
    rotation: Sequence[float] = (0.0, 0.0, 0.0)
    _center: Array = field(init=False, repr=False, compare=False)
    _half: Array = field(init=False, repr=False, compare=False)
    _axes: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        center, half = check_vector(self, "center"), check_vector(self, "size") / 2
        keep(self, _center=center, _half=half, _axes=rotation_matrix_of(check_vector(self, "rotation")))
        if not half.min() > 0:
            raise SceneError(f"box: size: use edges > 0, in m (got {list(self.size)})")

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        local = (points - self._center).dot(self._axes)
        excess = np.abs(local)  # beyond the faces
        excess -= self._half
        deepest = excess.max(axis=1)
        gap, normals = normalised(np.copysign(np.maximum(excess, 0.0), local), _UP)
        inside = deepest < SHORTEST_DIRECTION
        if inside.any():
            rows = np.flatnonzero(inside)
            faces = excess[rows].argmax(axis=1)
            gap[rows] = deepest[rows]
            normals[rows] = 0.0
            normals[rows, faces] = np.copysign(1.0, local[rows, faces])
        return gap, normals.dot(self._axes.T)

    @property
    def core(self) -> tuple[float, Array]:
        """Half of its least edge, m, and centres (9, 3) of balls in its corners and in the middle, m."""
        radius = float(self._half.min())
        return radius, self._center + (_CORNERS * (self._half - radius)) @ self._axes.T

    @property
    def extent(self) -> float:
        """Radius of the ball about the origin that holds it, m, or a little more."""
        return math.hypot(*self._center) + math.hypot(*self._half)

    @property
    def outline(self) -> Outline:
        """Its corners and edges."""
        return Outline(self._center + (BLOCK_CORNERS * self._half) @ self._axes.T, BLOCK_EDGES, 0.0)

    def curvature(self, points: Array) -> Array:
        """Second derivatives of the distance of points (P, 3), m: (P, 3, 3), 1/m."""
        local = (points - self._center).dot(self._axes)
        excess = np.maximum(np.abs(local) - self._half, 0.0)
        # Along its own axes, where what is beyond one face alone has exactly none, however near it is.
        turning = turning_of(np.copysign(excess, local), np.eye(3) * (excess > 0)[:, None, :])
        curvature: Array = self._axes @ turning @ self._axes.T
        return curvature


SHAPES: Mapping[str, Any] = {"half-space": HalfSpace, "sphere": Sphere, "capsule": Capsule, "box": Box, "mesh": Mesh}
Dimension = tuple[str, tuple[int | str, ...], str]  # unit, numbers or names of sizes, "f" real or "i" whole
DIMENSIONS: Mapping[str, Dimension] = {
    **dict.fromkeys(("point", "center", "start", "end", "size", "position"), ("m", (3,), "f")),
    "radius": ("m", (1,), "f"),
    "normal": ("1", (3,), "f"),
    "rotation": ("rad", (3,), "f"),
    "vertices": ("m", ("vertices", 3), "f"),
    "triangles": ("1", ("faces", 3), "i"),
    "open": ("1", (1,), "i"),
}


def dimensions_of(shape: str) -> dict[str, Dimension]:
    """What describes obstacles of one of the SHAPES."""
    return {each.name: DIMENSIONS[each.name] for each in fields(SHAPES[shape]) if each.init}


def shape_of(obstacle: Obstacle) -> str:
    """Its name among the SHAPES."""
    return next(shape for shape, kind in SHAPES.items() if isinstance(obstacle, kind))


def smallest_radius(obstacle: Obstacle) -> float:
    """Radius of what passes where an obstacle passes, m; infinite of a half-space.

    Of a box half of its middle edge: the face of a thin plate does not pass between points. Of a mesh that of its core.
    """
    if isinstance(obstacle, Box):
        return float(np.sort(obstacle.size)[1]) / 2
    if isinstance(obstacle, Mesh):
        return obstacle.core[0]
    return float(getattr(obstacle, "radius", math.inf))
