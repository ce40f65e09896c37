"""Obstacles of triangles, convex or not."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.arguments import SMALLEST
from fenics_rom.errors import SceneError, shown
from fenics_rom.mechanics.obstacle_outline import Outline
from fenics_rom.mechanics.obstacle_parts import check_vector, keep, rotation_matrix_of, turning_of
from fenics_rom.mechanics.signals import real_numbers_or_nan
from fenics_rom.mechanics.surface_checks import check_arrays, check_solid
from fenics_rom.mechanics.triangle_surface import TriangleSurface

_ONES = np.ones(3)
_CORE_PLACES = 9  # along each axis, where the middle of a ball is looked for that a mesh holds


@dataclass(frozen=True, eq=False)
class Mesh:
    """What a surface of triangles encloses; of an open one all that lies behind it.

    Args:
        vertices: (V, 3), m, in axes of its own.
        triangles: (T, 3) rows of vertices, counterclockwise from outside.
        position: where the origin of its axes is, m.
        rotation: axis times angle, rad, by which it is turned about this.
        open: whether the surface may have a border: 1 or 0.
    """

    vertices: Array = field(repr=False)
    triangles: Array = field(repr=False)
    position: Sequence[float] = (0.0, 0.0, 0.0)
    rotation: Sequence[float] = (0.0, 0.0, 0.0)
    open: int = 0
    surface: TriangleSurface = field(init=False, repr=False)
    is_convex: bool = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices, triangles = real_numbers_or_nan(self.vertices), np.asarray(self.triangles)
        if triangles.dtype.kind not in "iu":
            raise SceneError(f"mesh: triangles: use whole numbers (got {shown(self.triangles)})")
        check_arrays(vertices, triangles)
        position, turn = check_vector(self, "position"), rotation_matrix_of(check_vector(self, "rotation"))
        surface = TriangleSurface(vertices @ turn.T + position, triangles)
        check_solid(surface, bool(self.open))
        keep(self, vertices=vertices, triangles=triangles, open=int(self.open), surface=surface)
        keep(self, is_convex=surface.is_closed and not surface.is_concave and surface.is_before_no_plane)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mesh) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def _content(self) -> tuple[object, ...]:
        return self.vertices.tobytes(), self.triangles.tobytes(), self.position, self.rotation, self.open

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (P,), m, negative inside, of points (P, 3), m, and its gradient: unit normals (P, 3)."""
        return self.surface.distance(points)

    @cached_property
    def core(self) -> tuple[float, Array]:
        """Radius, m, and centre (1, 3), m, of a ball that it holds; larger ones may be elsewhere. Infinite if open."""
        if not self.surface.is_closed:
            return math.inf, np.empty((0, 3))
        low, high = self.surface.vertices.min(axis=0), self.surface.vertices.max(axis=0)
        places = low + (np.indices((_CORE_PLACES,) * 3).reshape(3, -1).T + 0.5) / _CORE_PLACES * (high - low)
        middles = self.surface.vertices[self.triangles].mean(axis=1)[:: max(1, len(self.triangles) // _CORE_PLACES**2)]
        gaps, _ = self.distance(places := np.concatenate([places, middles]))
        deepest = int(gaps.argmin())
        return max(-float(gaps[deepest]), SMALLEST), places[deepest][None]

    @cached_property
    def extent(self) -> float:
        """Radius of the ball about the origin that holds it, m; infinite if it is open."""
        if not self.surface.is_closed:
            return math.inf
        return float(np.sqrt(np.square(self.surface.vertices).dot(_ONES)).max())

    @cached_property
    def outline(self) -> Outline:
        """Edges at which it bends out, and their ends."""
        edges = self.surface.sharp_edges
        rows, ends = np.unique(edges, return_inverse=True)
        return Outline(self.surface.vertices[rows], ends.reshape(edges.shape), 0.0)

    def curvature(self, points: Array) -> Array:
        """Second derivatives of the distance of points (P, 3), m: (P, 3, 3), 1/m."""
        gaps, normals, places, along, is_flat = self.surface.foot(points)
        away = (points - places) * np.where(gaps < 0, -1.0, 1.0)[:, None]
        turning = turning_of(away, np.eye(3) - along[:, :, None] * along[:, None])
        is_held = is_flat | ((away * normals).dot(_ONES) < (1 - 1e-9) * np.sqrt((away * away).dot(_ONES)))
        turning[is_held] = 0.0
        return turning * np.where(gaps < 0, -1.0, 1.0)[:, None, None]
