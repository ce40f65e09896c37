"""Rigid shapes in their own axes, about their centre of mass: distances, inertia, surfaces.

Each refuses by a SceneError what it cannot be: dimensions that are not finite and > 0, points in one plane.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import GREATEST, SMALLEST, is_number
from fenics_rom.errors import SceneError, shown
from fenics_rom.mechanics import obstacles
from fenics_rom.mechanics.obstacle_outline import Outline
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.mechanics.triangle_surface import NearPlanes
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.world.convex_hull import convex_hull

ROUND = 48  # segments of a circle in pictures
MOST_CORNERS = 200  # of a hull: what touches is looked for among all pairs of its edges


@dataclass(frozen=True)
class Shape:
    """A rigid body of one density, convex but for a mesh, in axes of its own about its centre of mass.

    Distances and cores are those of the obstacle of the same shape, where there is one.

    Attributes:
        radius_around: of the ball about the centre of mass that holds it, m.
        volume: m³.
        squares: mean of x xᵀ over the volume, (3, 3), m².
    """

    radius_around: float = field(init=False, repr=False, compare=False)
    volume: float = field(init=False, repr=False, compare=False)
    squares: Array = field(init=False, repr=False, compare=False)
    _obstacle: obstacles.Obstacle = field(init=False, repr=False, compare=False)

    def inertia(self, density: float) -> tuple[float, Array]:
        """Mass, kg, and inertia about the centre of mass, (3, 3), kg m², at a density in kg/m³."""
        mass = density * self.volume
        return mass, mass * (np.trace(self.squares) * np.eye(3) - self.squares)

    @property
    def obstacle(self) -> obstacles.Obstacle:
        """What has its distances, if it is none of a round block or a hull."""
        return self._obstacle

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        return self._obstacle.distance(points)

    @property
    def core(self) -> tuple[float, Array]:
        """Radius, m, of the largest balls that it holds, infinite of a half-space, and centres (C, 3) of some, m."""
        return self._obstacle.core

    @property
    def outline(self) -> Outline:
        """As of an Obstacle."""
        return self._obstacle.outline

    def surface(self) -> tuple[Array, Array]:
        """Vertices (V, 3), m, and triangles (T, 3), counterclockwise from outside."""
        raise NotImplementedError


@dataclass(frozen=True)
class RoundShape(Shape):
    """A shape that is the same all around the z axis."""

    _profile: tuple[Array, Array] = field(init=False, repr=False, compare=False)  # radii and heights, m, from below

    def surface(self) -> tuple[Array, Array]:
        """Vertices (V, 3), m, and triangles (T, 3), counterclockwise from outside."""
        angle, (radii, heights) = 2 * np.pi * np.arange(ROUND) / ROUND, self._profile
        ring = np.stack([np.cos(angle), np.sin(angle), np.ones(ROUND)], axis=1)
        vertices = ring * np.stack([radii, radii, heights], axis=1)[:, None]
        low = np.arange(vertices.size // 3).reshape(len(radii), ROUND)[:-1]
        beside = np.roll(low, -1, axis=1)
        # Where the profile begins and ends there is one point alone.
        lower = np.stack([low, beside, beside + ROUND], axis=-1)[1:]
        upper = np.stack([low, beside + ROUND, low + ROUND], axis=-1)[:-1]
        return vertices.reshape(-1, 3), np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])


@dataclass(frozen=True)
class Sphere(RoundShape):
    """A ball.

    Args:
        radius: m.
    """

    radius: float

    def __post_init__(self) -> None:
        ball = obstacles.Sphere((0.0, 0.0, 0.0), self.radius)
        r, angle = ball.radius, np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1)
        _keep(self, radius=r, radius_around=r, volume=4 / 3 * math.pi * r**3, squares=r**2 / 5 * np.eye(3))
        _keep(self, _obstacle=ball, _profile=(r * np.cos(angle), r * np.sin(angle)))


@dataclass(frozen=True)
class Capsule(RoundShape):
    """All that is nearer than a radius to a piece of the z axis.

    Args:
        radius: m.
        length: of the piece, m; with both ends the capsule is longer by two radii.
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _check_positive(self, "length")
        half = self.length / 2
        obstacle = obstacles.Capsule((0.0, 0.0, -half), (0.0, 0.0, half), self.radius)
        r = obstacle.radius
        rod, ball = math.pi * r**2 * self.length, 4 / 3 * math.pi * r**3
        across = (rod * r**2 / 4 + ball * r**2 / 5) / (rod + ball)
        off_middle = r**2 / 5 + half**2 + 3 / 4 * half * r  # half a ball has its centre of mass at 3r/8
        along = (rod * half**2 / 3 + ball * off_middle) / (rod + ball)
        _keep(self, radius=r, radius_around=r + half, volume=rod + ball, squares=np.diag([across, across, along]))
        angle = np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2)
        _keep(self, _obstacle=obstacle, _profile=(r * np.cos(angle), r * np.sin(angle) + half * np.sign(angle)))


@dataclass(frozen=True)
class Cylinder(RoundShape):
    """A round block along the z axis.

    Args:
        radius: m.
        length: m.
    """

    radius: float
    length: float

    def __post_init__(self) -> None:
        _check_positive(self, "radius")
        _check_positive(self, "length")
        r, half = self.radius, self.length / 2
        _keep(self, radius_around=math.hypot(r, half), volume=2 * math.pi * r**2 * half)
        _keep(self, squares=np.diag([r**2 / 4, r**2 / 4, half**2 / 3]))
        _keep(self, _profile=(np.array([0.0, r, r, 0.0]), np.array([-half, -half, half, half])))
        thick = 2 * (r + self.length)  # enough that these sides are never the nearest
        _keep(self, _obstacle=obstacles.Box((0.0, 0.0, 0.0), (2 * r, thick, self.length)))  # in a plane of its axis

    @cached_property
    def prism(self) -> "Hull":
        """Half inside and half outside of it, where it meets flat shapes."""
        angle = 2 * np.pi * np.arange(ROUND) / ROUND
        radius = self.radius * 2 / (1 + math.cos(math.pi / ROUND))
        rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return Hull([(*point, end) for end in (-self.length / 2, self.length / 2) for point in rim.tolist()])

    @cached_property
    def outline(self) -> Outline:
        """As of an Obstacle: its rims, as polygons of 48 sides inside of it, and its side about the axis."""
        angle, step, half = 2 * np.pi * np.arange(ROUND) / ROUND, np.arange(ROUND), self.length / 2
        rim = np.stack([self.radius * np.cos(angle), self.radius * np.sin(angle), np.full(ROUND, half)], axis=1)
        corners = np.concatenate([rim, rim * [1, 1, -1], [[0.0, 0.0, -half], [0.0, 0.0, half]]])
        edges = np.stack([step, (step + 1) % ROUND], axis=1)
        edges = np.concatenate([edges, edges + ROUND, [[2 * ROUND, 2 * ROUND + 1]]])
        return Outline(corners, edges, 0.0, np.append(np.zeros(2 * ROUND), self.radius))

    @property
    def core(self) -> tuple[float, Array]:
        """The less of radius and half length, m, and centres (2, 3) of balls at both ends, m."""
        radius = min(self.radius, self.length / 2)
        off = self.length / 2 - radius
        return radius, np.array([[0.0, 0.0, -off], [0.0, 0.0, off]])

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        x, y, z = points.T
        out = np.hypot(x, y)
        gaps, normals = self._obstacle.distance(np.stack([out, 0 * out, z], axis=1))
        across = points[:, :2] / np.where(out > 0, out, 1.0)[:, None]
        across[out == 0] = 1.0, 0.0  # on the axis
        return gaps, np.concatenate([normals[:, :1] * across, normals[:, 2:]], axis=1)


@dataclass(frozen=True)
class HalfSpace(Shape):
    """All below z = 0; it has no mass, and does not move freely."""

    def __post_init__(self) -> None:
        _keep(self, radius_around=math.inf, volume=math.inf, squares=np.full((3, 3), math.nan))
        _keep(self, _obstacle=obstacles.HalfSpace((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))

    def inertia(self, density: float) -> tuple[float, Array]:
        """Refused by a SceneError."""
        raise SceneError("half-space: has no mass; use one that is held, or moves on a given path")

    def surface(self) -> tuple[Array, Array]:
        """A square of its face, 2 m wide."""
        return np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])


@dataclass(frozen=True, eq=False)
class Mesh(Shape):
    """What a surface of triangles encloses, convex or not; it stands still, or moves on a given path.

    Args:
        vertices: (V, 3), m, in axes of its own.
        triangles: (T, 3) rows of vertices, counterclockwise from outside.
        open: whether the surface may have a border; all behind it is solid.
    """

    vertices: Array
    triangles: Array
    open: bool = False

    def __post_init__(self) -> None:
        mesh = obstacles.Mesh(self.vertices, self.triangles, open=int(self.open))
        radius = float(np.linalg.norm(mesh.vertices, axis=1).max())
        _keep(self, vertices=mesh.vertices, triangles=mesh.triangles, _obstacle=mesh, radius_around=radius)
        _keep(self, volume=math.nan, squares=np.full((3, 3), math.nan))

    def inertia(self, density: float) -> tuple[float, Array]:
        """Refused by a SceneError."""
        raise SceneError("mesh: has no mass; use one that is held, or moves on a given path")

    def planes_near(self, points: Array, reach: float) -> NearPlanes:
        """As of a TriangleSurface."""
        return self._obstacle.surface.planes_near(points, reach)  # type: ignore[attr-defined]

    @property
    def sharp_corners(self) -> Array:
        """Its vertices that are no part of a flat or hollow place, (k, 3), m."""
        return self._obstacle.surface.sharp_corners  # type: ignore[attr-defined]

    def surface(self) -> tuple[Array, Array]:
        """Vertices (V, 3), m, and triangles (T, 3), counterclockwise from outside."""
        return self.vertices, self.triangles


def passing_radius(shape: Shape) -> float:
    """Radius of what passes where a shape passes, m, as `obstacles.smallest_radius`; infinite of a half-space."""
    if isinstance(shape, Mesh):
        return shape.core[0]
    if isinstance(shape, Polytope):
        return float(np.sort(np.ptp(shape.vertices, axis=0))[1]) / 2
    return float(getattr(shape, "radius", math.inf))


@dataclass(frozen=True)
class Polytope(Shape):
    """A shape with flat faces."""

    vertices: Array = field(init=False, repr=False, compare=False)  # (V, 3), m
    loops: list[Array] = field(init=False, repr=False, compare=False)  # corners of faces, counterclockwise from outside
    normals: Array = field(init=False, repr=False, compare=False)  # (F, 3), units, outward
    levels: Array = field(init=False, repr=False, compare=False)  # (F,), m: n·x <= level inside

    def _set_faces(self, vertices: Array, faces: Sequence[Sequence[int]]) -> None:
        polygons = [vertices[list(face)] for face in faces]
        normals = np.array([np.cross(loop, np.roll(loop, -1, axis=0)).sum(axis=0) for loop in polygons])  # Newell's
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        levels = np.array([loop.mean(axis=0).dot(n) for loop, n in zip(polygons, normals, strict=True)])
        radius = float(np.linalg.norm(vertices, axis=1).max())
        _keep(self, vertices=vertices, loops=[np.array(face) for face in faces], normals=normals, levels=levels)
        _keep(self, radius_around=radius)

    def surface(self) -> tuple[Array, Array]:
        """Vertices (V, 3), m, and triangles (T, 3), counterclockwise from outside."""
        fans = [(face[0], face[k], face[k + 1]) for face in self.loops for k in range(1, len(face) - 1)]
        return self.vertices, np.array(fans)


@dataclass(frozen=True)
class Box(Polytope):
    """A block with flat faces.

    Args:
        size: full lengths of the edges along x, y and z, m.
    """

    size: Sequence[float]

    def __post_init__(self) -> None:
        box = obstacles.Box((0.0, 0.0, 0.0), self.size)
        size = np.array(box.size)
        _keep(self, _obstacle=box, size=box.size, volume=math.prod(box.size), squares=np.diag(size**2) / 12)
        signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
        faces = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]  # -x +x -y +y ...
        self._set_faces(signs * size / 2, faces)


@dataclass(frozen=True)
class Hull(Polytope):
    """The convex hull of points.

    Args:
        points: (P, 3), m, in any axes.

    Attributes:
        shift: (3,), m: where the centre of mass is in the axes of the points; the shape's own begin there.
    """

    points: Sequence[Sequence[float]]
    shift: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        points = real_numbers_or_nan(self.points)
        if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 4 or not np.isfinite(points).all():
            raise SceneError("hull: points: use at least 4 points of three finite numbers, in m")
        vertices, faces = convex_hull(points)
        if len(vertices) > MOST_CORNERS:
            raise SceneError(f"hull: points: use hulls of at most {MOST_CORNERS} corners (got {len(vertices)})")
        origin = vertices.mean(axis=0)  # near, for round-off
        self._set_faces(vertices - origin, faces)
        volume, first, _ = self._moments()
        _keep(self, points=tuple(map(tuple, points.tolist())), shift=origin + first / volume, volume=volume)
        self._set_faces(vertices - self.shift, faces)
        _keep(self, squares=self._moments()[2] / volume)

    @cached_property
    def outline(self) -> Outline:
        """As of an Obstacle: its corners and edges."""
        sides = [np.stack([loop, np.roll(loop, -1)], axis=1) for loop in self.loops]
        return Outline(self.vertices, np.unique(np.sort(np.concatenate(sides), axis=1), axis=0), 0.0)

    def _moments(self) -> tuple[float, Array, Array]:
        """∫ 1, ∫ x and ∫ x xᵀ over the volume, by the signed tetrahedra between the origin and the triangles."""
        vertices, triangles = self.surface()
        corners = vertices[triangles]
        volumes, sums = np.linalg.det(corners) / 6, corners.sum(axis=1)
        second = np.einsum("t,ti,tj->ij", volumes, sums, sums) + np.einsum("t,tci,tcj->ij", volumes, corners, corners)
        return float(volumes.sum()), volumes @ sums / 4, second / 20

    @property
    def core(self) -> tuple[float, Array]:
        """Of the ball about the centre of mass, m, and this, (1, 3), m; larger ones may be elsewhere."""
        return float(self.levels.min()), np.zeros((1, 3))

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        beyond = points @ self.normals.T - self.levels
        face = beyond.argmax(axis=1)
        gap, normals = beyond[np.arange(len(points)), face], self.normals[face]
        outside = np.flatnonzero(gap > 0)
        if len(outside):
            gap[outside], normals[outside] = self._outside(points[outside], gap[outside], normals[outside])
        return gap, normals

    def _outside(self, points: Array, gap: Array, normals: Array) -> tuple[Array, Array]:
        """The same of points outside: to the nearest triangle; where they are on it, the normal of its plane stays."""
        vertices, triangles = self.surface()
        corners = vertices[triangles]
        count = len(points)
        _, places = nearest_on_triangles(np.repeat(points, len(corners), axis=0), np.tile(corners, (count, 1, 1)))
        offsets = points[:, None] - places.reshape(count, -1, 3)
        lengths = np.linalg.norm(offsets, axis=2)
        nearest = lengths.argmin(axis=1)
        away = lengths[np.arange(count), nearest]
        beside = away > gap * (1 + 1e-9)  # not above the face
        normals[beside] = offsets[np.flatnonzero(beside), nearest[beside]] / away[beside, None]
        gap[beside] = away[beside]
        return gap, normals


def _check_positive(shape: Shape, name: str) -> None:
    value = getattr(shape, name)
    if not (is_number(value) and SMALLEST <= value <= GREATEST):
        kind = type(shape).__name__.lower()
        raise SceneError(f"{kind}: {name}: use a finite number > 0, in m (got {shown(value)})")
    _keep(shape, **{name: float(value)})


def _keep(shape: Shape, **values: object) -> None:
    """Sets attributes of a shape, which is frozen."""
    for name, value in values.items():
        object.__setattr__(shape, name, value)
