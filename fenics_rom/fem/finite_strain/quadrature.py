"""∇ of displacements at the quadrature points of straight tetrahedra, as a sparse matrix, and the forces of stresses.

Degree 1 has one point in a cell and degree 2 has four (Keast, 1986): exact for products of two gradients, so that small
strains meet the linear stiffness.
"""

from typing import Any

import numpy as np
import scipy.sparse

from fenics_rom.fem.nodes import CELL_EDGES, Nodes

Array = np.ndarray

NEAR, FAR = (5 + 3 * 5**0.5) / 20, (5 - 5**0.5) / 20  # barycentric coordinates of the four points
PLACES = {1: np.full((1, 4), 0.25), 2: FAR + (NEAR - FAR) * np.eye(4)}  # (Q, 4) of the points in a cell


class Points:
    """The quadrature points of the cells of this rank: those of a cell follow one another.

    Args:
        nodes: all nodes.
        degree: of the displacements.
        comm: an mpi4py communicator, whose ranks share the cells.

    Attributes:
        cells: (C here,) which cells of the mesh file.
        of_cells: (C here, A) nodes of each.
        shape_gradients: (C here, Q, A, 3), ∂N_a/∂X_j, 1/m.
        weights: (P here,), m³.
        count: N of the nodes of the mesh.
    """

    def __init__(self, nodes: Nodes, degree: int, comm: Any):
        self.cells = np.array_split(np.arange(len(nodes.cells)), comm.size)[comm.rank]
        corners = nodes.cells[self.cells]
        self.of_cells = np.hstack([corners, nodes.on_edges(corners[:, CELL_EDGES])]) if degree == 2 else corners
        edges = nodes.coordinates[corners[:, 1:]] - nodes.coordinates[corners[:, :1]]  # (C, 3, 3)
        inner = np.linalg.inv(edges).transpose(0, 2, 1)
        ends = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)  # ∇ of barycentric coordinates
        places = PLACES[degree]
        self.shape_gradients = np.stack([_shape_gradients(place, ends, degree) for place in places], axis=1)
        volumes = np.linalg.det(edges) / 6
        self.weights = np.repeat(volumes / len(places), len(places))
        self._comm, self.count = comm, len(nodes.coordinates)
        self._gradient = self._matrix()
        self._gradientᵀ = self._gradient.T.tocsr()

    def _matrix(self) -> scipy.sparse.csr_matrix:
        """∂/∂X_j at the points of a scalar field, (3 P here, N), the points of j = 0 first."""
        C, Q, A, _ = self.shape_gradients.shape
        values = self.shape_gradients.reshape(C * Q, A, 3).transpose(2, 0, 1)
        columns = np.broadcast_to(np.repeat(self.of_cells, Q, axis=0), values.shape)
        ends = np.arange(0, values.size + 1, A)
        return scipy.sparse.csr_matrix((values.ravel(), columns.ravel(), ends), shape=(3 * C * Q, self.count))

    def gradients(self, u: Array) -> Array:
        """H (3, 3, P here) of displacements of all nodes (N, 3), H[i, j] = ∂u_i/∂X_j."""
        return np.stack([(self._gradient @ column).reshape(3, -1) for column in u.T])

    def gradients_of(self, fields: Array) -> Array:
        """H (3, 3, P here, k) of k displacement fields of all nodes, (N, 3, k)."""
        H = np.empty((3, 3, len(self.weights), fields.shape[2]))
        for i in range(3):
            H[i] = (self._gradient @ fields[:, i]).reshape(3, -1, fields.shape[2])
        return H

    def forces(self, first: Array) -> Array:
        """∫ P : ∇δ on all nodes (N, 3), N, of first Piola-Kirchhoff stresses (3, 3, P here), Pa; summed over ranks."""
        weighted = (first * self.weights).reshape(3, -1)
        here = np.stack([self._gradientᵀ @ row for row in weighted], axis=1)
        return self.summed(here)

    def integral(self, density: Array) -> float:
        """∫ of a density (P here,) over the body; the same bits on every rank."""
        here = np.array([self.weights @ density])
        return float(self.summed(here)[0])

    def summed(self, here: Array) -> Array:
        """The sum over the ranks, on every rank."""
        if self._comm.size == 1:
            return here
        total = np.empty_like(here)
        self._comm.Allreduce(here, total)
        return total


def _shape_gradients(place: Array, ends: Array, degree: int) -> Array:
    """∇ of the shape functions (C, A, 3) at barycentric coordinates (4,), which have the gradients `ends` (C, 4, 3)."""
    if degree == 1:
        return ends
    i, j = CELL_EDGES.T
    at_corners = (4 * place - 1)[:, None] * ends
    on_edges = 4 * (place[i, None] * ends[:, j] + place[j, None] * ends[:, i])
    return np.concatenate([at_corners, on_edges], axis=1)
