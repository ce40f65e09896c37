"""Where obstacles can touch a body: its nodes, and points between them where an obstacle would pass through."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError, check_known
from fenics_rom.mechanics.triangles import covering_radius, triangles_among

if TYPE_CHECKING:
    from fenics_rom.mechanics.body_faces import BodyFaces
    from fenics_rom.mechanics.own_surface import OwnSurface

NEARNESS = 0.05  # of the size of the contact surfaces: an obstacle that far away begins to matter
MOST_BETWEEN = 700  # with more than these every step is slow; a finer mesh, or a smaller contact surface, is better
HYSTERESIS = 1e-3  # of it: by so much another contact mode must be closer, so that two do not take turns


@dataclass(frozen=True)
class PointsBetween:
    """Points of the surface between nodes; what they do is interpolated, and forces on them spread, alike."""

    nodes: Array  # (B, c) of the facet that each lies on
    weights: Array  # (B, c) shape functions there
    gap: float  # largest distance, m, that is left from a point of the contact surfaces to the nearest that can touch


class ContactPoints:
    """All points that obstacles can touch, and which contact mode is the one that is touched.

    Args:
        nodes_of: nodes (P_i,) of each contact mode that can move.
        surfaces: all nodes of the surface of each contact mode.
        coordinates: of all nodes at rest, (N, 3), m.
        between: points between nodes, if there are some.

    Attributes:
        nodes: (P - B,) ascending, each once; the first of the points.
        coordinates: of all points at rest, (P, 3), m.
    """

    def __init__(
        self,
        nodes_of: Mapping[str, Array],
        surfaces: Mapping[str, Array],
        coordinates: Array,
        between: PointsBetween | None = None,
    ):
        self.nodes = np.unique(np.concatenate(list(nodes_of.values())))
        self.coordinates = coordinates[self.nodes]
        self._names, self._between = list(nodes_of), between
        self._members = [np.searchsorted(self.nodes, nodes) for nodes in nodes_of.values()]
        if between is not None:
            places = np.einsum("bc,bcx->bx", between.weights, coordinates[between.nodes])
            self.coordinates = np.concatenate([self.coordinates, places])
            for k, name in enumerate(nodes_of):
                on_surface = (np.isin(between.nodes, surfaces[name]) | (between.weights == 0)).all(axis=1)
                self._members[k] = np.concatenate([self._members[k], len(self.nodes) + np.flatnonzero(on_surface)])
        self._size = float(np.linalg.norm(np.ptp(self.coordinates, axis=0)))

    def columns(self, of_nodes: Callable[[Array], Array]) -> Array:
        """Columns (rows, 3 P) of the points' components, from what gives those of nodes (s,), (rows, 3 s)."""
        columns = of_nodes(self.nodes)
        if self._between is None:
            return columns
        corners = zip(self._between.nodes.T, self._between.weights.T, strict=True)
        return np.hstack([columns, sum(of_nodes(nodes) * np.repeat(weights, 3) for nodes, weights in corners)])

    def weights(self) -> tuple[Array, Array, Array]:
        """What points are of nodes: numbers of points (t,), nodes (t,) and their weights (t,); a node is of itself."""
        own = np.arange(len(self.nodes))
        if self._between is None:
            return own, self.nodes, np.ones(len(own))
        corners, weights = self._between.nodes, self._between.weights
        points = np.repeat(len(own) + np.arange(len(corners)), corners.shape[1])
        parts = (own, points), (self.nodes, corners.ravel()), (np.ones(len(own)), weights.ravel())
        point, node, weight = map(np.concatenate, parts)
        return point, node, weight

    def on_nodes(self, values: Array, nodes: Array) -> Array:
        """Of values that belong to points as forces do (P, ...), those on nodes of the body (s,), (s, ...).

        0 on nodes that cannot be touched.
        """
        point, node, weight = self.weights()
        order = np.argsort(nodes)
        row = order[np.minimum(np.searchsorted(nodes, node, sorter=order), len(nodes) - 1)]
        there, on_nodes = nodes[row] == node, np.zeros((len(nodes), *values.shape[1:]))
        np.add.at(on_nodes, row[there], (values[point[there]].T * weight[there]).T)
        return on_nodes

    def nearest(self, gaps: Array, active: str) -> str:
        """The contact mode to be in, from the smallest gap of each point (P,), m, and the one that is active."""
        closest = [gaps[members].min(initial=np.inf) for members in self._members]
        best = int(np.argmin(closest))
        near = closest[best] < NEARNESS * self._size
        closer = closest[best] < closest[self._names.index(active)] - HYSTERESIS * self._size
        return self._names[best] if near and closer else active

    def nearest_modes(self, gaps: Array, active: Array) -> Array:
        """The same of B bodies, whose gaps are (P, B) and whose contact modes have the numbers `active` (B,)."""
        closest = np.stack([gaps[members].min(axis=0, initial=np.inf) for members in self._members])
        best, bodies = closest.argmin(axis=0), np.arange(len(active))
        near = closest[best, bodies] < NEARNESS * self._size
        closer = closest[best, bodies] < closest[active, bodies] - HYSTERESIS * self._size
        return np.where(near & closer, best, active)

    def own_surface(self, names: Sequence[str], triangles: Array) -> "OwnSurface | None":
        """The surface of some contact modes, by their names, that touches itself; None without names.

        Args:
            names: of the modes.
            triangles: of the surface of the body, between all nodes, (F, 3).

        Raises:
            SceneError: there is no such contact mode, or one has no area.
        """
        if not names:
            return None
        from fenics_rom.mechanics.own_surface import OwnSurface  # here, as few bodies touch themselves

        where, own = "effects.contact.self_contact: ", dict[str, Array]()
        surface_of = np.full(len(self.coordinates), "", dtype=object)
        for name in names:
            check_known("contact mode", name, self._names, SceneError, where)
            own[name] = members = self._members[self._names.index(name)]
            if not len(triangles_among(self.nodes[members[members < len(self.nodes)]], triangles)):
                raise SceneError(
                    f"{where}{name!r}: its contact points are no corners of triangles: use contact modes whose "
                    "surfaces have areas"
                )
            surface_of[members] = name
        touching = np.unique(np.concatenate(list(own.values())))
        nodes = touching[touching < len(self.nodes)]
        among = nodes[triangles_among(self.nodes[nodes], triangles)]
        return OwnSurface(self.coordinates, among, touching, surface_of.tolist())

    def faces(self, triangles: Array) -> "BodyFaces":
        """Those between contact points, of the triangles (F, 3) of the body's surface; SceneError where none is."""
        from fenics_rom.mechanics.body_faces import BodyFaces  # here, as few scenes have obstacles that meet them

        return BodyFaces(self.coordinates, triangles_among(self.nodes, triangles))

    def describe_passing(self, radii: Mapping[str, float], triangles: Array, coordinates: Array) -> str:
        """What to say of obstacles that fit between the points; empty where none does.

        Args:
            radii: of what passes where they do, by name, m (see `smallest_radius`).
            triangles: of the surface, between all nodes, (F, 3).
            coordinates: of all nodes at rest, (N, 3), m.
        """
        if not radii or min(radii.values()) == np.inf:
            return ""
        if self._between is not None:
            gap = self._between.gap
        else:
            touched = np.isin(triangles, self.nodes).all(axis=1)
            gap = covering_radius(coordinates[triangles[touched]]).max(initial=0.0)
        name, radius = min(radii.items(), key=lambda item: item[1])
        if radius >= gap:
            return ""
        return (
            f"contact: obstacle {name!r} is {2 * radius:.3g} m across, and the contact points leave gaps of "
            f"{2 * gap:.3g} m that it passes through; effects.contact.points = 'faces' is the cure, or a mesh of "
            f"{radius:.3g} m at the contact surface; in a world, or for gradients, points = 'surface', where "
            f"{MOST_BETWEEN} points do"
        )
