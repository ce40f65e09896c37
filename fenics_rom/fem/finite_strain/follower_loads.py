"""Forces that follow the body: pressure on the moved surface, and tendons through moved points."""

from typing import Protocol

import numpy as np

from fenics_rom.fem.nodes import Nodes
from fenics_rom.mechanics.tendon import measure_segments, sum_end_forces, unit_tension_forces

Array = np.ndarray

# Points (Q, 3) and weights (Q,) of a triangle: for degree 1 its middle; six for products of degree 4 (Dunavant, 1985).
_A, _B = 0.445948490915965, 0.091576213509771
_SIX = np.array([np.roll([1 - 2 * c, c, c], k) for c in (_A, _B) for k in range(3)])
TRIANGLE = {
    1: (np.full((1, 3), 1 / 3), np.array([0.5])),
    2: (_SIX, np.repeat([0.223381589678011, 0.109951743655322], 3) / 2),
}


class Follower(Protocol):
    """A force that depends on the displacement."""

    def force(self, u: Array) -> Array:
        """Of a unit input, (N, 3), at displacements (N, 3)."""

    def changed(self, u: Array, du: Array) -> Array:
        """Its change (N, 3) with a change (N, 3) of displacements (N, 3)."""


class Pressure:
    """1 Pa on a surface: -∫ n dA on the moved one, exactly the change of the enclosed volume with each node.

    Args:
        nodes: all nodes.
        triangles: (F, 3) outward, between vertices.
    """

    def __init__(self, nodes: Nodes, triangles: Array):
        degree = 2 if len(nodes.edges) else 1
        self._on = np.hstack([triangles, nodes.triangle_edges(triangles)]) if degree == 2 else triangles
        self._rest = nodes.coordinates
        places, self._weights = TRIANGLE[degree]
        self._shapes, self._shape_gradients = _shapes(places, degree)

    def force(self, u: Array) -> Array:
        """As in Follower."""
        along, across = self._tangents(self._rest + u)
        return self._spread(np.cross(along, across))

    def changed(self, u: Array, du: Array) -> Array:
        """As in Follower."""
        along, across = self._tangents(self._rest + u)
        d_along, d_across = self._tangents(du)
        return self._spread(np.cross(d_along, across) + np.cross(along, d_across))

    def _tangents(self, places: Array) -> Array:
        """Two tangents (2, F, Q, 3) of the surface that runs through places (N, 3)."""
        return np.einsum("qat,fai->tfqi", self._shape_gradients, places[self._on])

    def _spread(self, normals: Array) -> Array:
        """-∫ n N_a of each node (N, 3) from normals times area (F, Q, 3)."""
        forces = np.zeros_like(self._rest)
        np.add.at(forces, self._on, -np.einsum("q,qa,fqi->fai", self._weights, self._shapes, normals))
        return forces


class Tendon:
    """A tension of 1 N in a cable through points of the body: -∂ℓ/∂x of its length ℓ.

    Args:
        points: (K, 3), m, at rest.
        shapes: (K, N) shape functions there.
    """

    def __init__(self, points: Array, shapes: Array):
        self.points, self.shapes = points, shapes

    def force(self, u: Array) -> Array:
        """As in Follower."""
        return self.shapes.T @ unit_tension_forces(self.points + self.shapes @ u)

    def changed(self, u: Array, du: Array) -> Array:
        """As in Follower."""
        pieces, lengths = measure_segments(self.points + self.shapes @ u)
        directions, change = pieces / lengths, np.diff(self.shapes @ du, axis=0)
        along = np.einsum("ki,ki->k", directions, change)[:, None]
        return self.shapes.T @ sum_end_forces((change - along * directions) / lengths)


def _shapes(places: Array, degree: int) -> tuple[Array, Array]:
    """Shape functions (Q, A) of a triangle and their gradients (Q, A, 2) at barycentric coordinates (Q, 3)."""
    ends = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    if degree == 1:
        return places, np.broadcast_to(ends, (len(places), 3, 2))
    i, j = np.array([0, 1, 2]), np.array([1, 2, 0])
    values = np.hstack([places * (2 * places - 1), 4 * places[:, i] * places[:, j]])
    at_corners = (4 * places - 1)[:, :, None] * ends
    on_edges = 4 * (places[:, i, None] * ends[j] + places[:, j, None] * ends[i])
    return values, np.concatenate([at_corners, on_edges], axis=1)
