"""∇ of displacements at the quadrature points of straight tetrahedra, as a sparse matrix, and the forces of stresses.

The rules are exact for products of two gradients, so that small strains meet the linear stiffness.
"""

from functools import cached_property
from typing import Any

import basix
import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.mesh_quality import CELL_EDGES
from fenics_rom.fem.nodes import Nodes


def tabulate(cell: str, degree: int, quadrature_degree: int) -> tuple[Array, Array, Array]:
    """Shape functions of a reference cell at the points of a rule that is exact for a degree.

    Args:
        cell: "triangle" or "tetrahedron"; basix has its mid-side nodes opposite to vertex 0, 1, 2 and on `CELL_EDGES`.
        degree: of the Lagrange element.
        quadrature_degree: of polynomials that the rule integrates exactly (Xiao & Gimbutas, 2010).

    Returns:
        Values (Q, A), gradients (Q, A, d), and weights (Q,) whose sum is the volume of the reference cell.
    """
    shape = getattr(basix.CellType, cell)
    points, weights = basix.make_quadrature(shape, quadrature_degree)
    element = basix.create_element(basix.ElementFamily.P, shape, degree, basix.LagrangeVariant.equispaced)
    table = element.tabulate(1, points)[..., 0]
    return table[0], table[1:].transpose(1, 2, 0), weights


class QuadraturePoints:
    """The quadrature points of the cells of this rank: those of a cell follow one another.

    Args:
        nodes: all nodes.
        degree: of the displacements.
        comm: an mpi4py communicator, whose ranks share the cells.
        selective: whether the middle of each cell follows its points, for changes of volume alone (Hughes, 1980): one
            condition for each cell does not lock nearly incompressible material.

    Attributes:
        cells: (C here,) which cells of the mesh file.
        cell_nodes: (C here, A) nodes of each.
        shape_gradients: (C here, Q, A, 3), ∂N_a/∂X_j, 1/m.
        weights: (P here,), m³; of the points in the middle and of the others alone their sum is the volume.
        gradient_matrix: sparse (3 P here, N), ∂/∂X_j of a scalar field, the points of j = 0 first, 1/m.
        node_count: N of the mesh.
    """

    def __init__(self, nodes: Nodes, degree: int, comm: Any, selective: bool = False):
        self.cells = np.array_split(np.arange(len(nodes.cells)), comm.size)[comm.rank]
        corners = nodes.cells[self.cells]
        self.cell_nodes = np.hstack([corners, nodes.on_edges(corners[:, CELL_EDGES])]) if degree == 2 else corners
        edges = nodes.coordinates[corners[:, 1:]] - nodes.coordinates[corners[:, :1]]  # ∂X_j/∂ξ_k (C, k, j)
        _, reference_gradients, reference_weights = tabulate("tetrahedron", degree, 2 * (degree - 1))
        if selective:
            _, in_the_middle, volume = tabulate("tetrahedron", degree, 1)
            reference_gradients = np.concatenate([reference_gradients, in_the_middle])
            reference_weights = np.concatenate([reference_weights, volume])
        self._selective = selective
        self.shape_gradients = np.einsum("cjk,qak->cqaj", np.linalg.inv(edges), reference_gradients)
        self.weights = np.outer(np.linalg.det(edges), reference_weights).ravel()
        self._comm, self.node_count = comm, len(nodes.coordinates)
        self.gradient_matrix = self._gradient_matrix()
        self._divergence = (self.gradient_matrix.T @ scipy.sparse.diags(np.tile(self.weights, 3))).tocsr()

    def _gradient_matrix(self) -> scipy.sparse.csr_matrix:
        """∂/∂X_j at the points of a scalar field, (3 P here, N), the points of j = 0 first."""
        C, Q, A, _ = self.shape_gradients.shape
        values = self.shape_gradients.reshape(C * Q, A, 3).transpose(2, 0, 1)
        columns = np.broadcast_to(np.repeat(self.cell_nodes, Q, axis=0), values.shape)
        row_starts = np.arange(0, values.size + 1, A)
        shape = (3 * C * Q, self.node_count)
        return scipy.sparse.csr_matrix((values.ravel(), columns.ravel(), row_starts), shape=shape)

    def of_cells(self, values: Array) -> Array:
        """Values of the cells here (C here,) at their points, (P here,)."""
        return np.repeat(values, self.shape_gradients.shape[1])

    def shared_moduli(self, first_lame: Array, shear: Array) -> tuple[Array, Array]:
        """λ and μ (P here,) as the points have them: where the middle of a cell has a point, it has all of λ alone."""
        if not self._selective:
            return first_lame, shear
        middle = np.arange(len(self.weights)) % self.shape_gradients.shape[1] == self.shape_gradients.shape[1] - 1
        return np.where(middle, first_lame, 0.0), np.where(middle, 0.0, shear)

    def gradients(self, u: Array) -> Array:
        """H (3, 3, P here, ...) of displacements of all nodes (N, 3, ...), H[i, j] = ∂u_i/∂X_j."""
        shape = 3, len(self.weights), *u.shape[2:]
        return np.stack([(self.gradient_matrix @ u[:, i]).reshape(shape) for i in range(3)])  # faster than all at once

    @cached_property
    def _nodal_shares(self) -> scipy.sparse.csr_matrix:
        """(N, P here): which part of the volume around each node every point here has."""
        C, Q, A, _ = self.shape_gradients.shape
        points = np.repeat(np.arange(C * Q), A)
        entries = self.weights[points], (np.repeat(self.cell_nodes, Q, axis=0).ravel(), points)
        volumes = scipy.sparse.coo_matrix(entries, shape=(self.node_count, C * Q)).tocsr()
        around = self.sum_over_ranks(np.asarray(volumes.sum(axis=1))[:, 0])
        return scipy.sparse.diags(1 / np.where(around > 0, around, 1.0)) @ volumes

    def nodal_means(self, values: Array) -> Array:
        """Means (N, any) of values at the points here (P here, any), of the cells around each node."""
        return self.sum_over_ranks(self._nodal_shares @ values)

    def internal_force(self, P: Array) -> Array:
        """∫ P : ∇δ on all nodes (N, 3), N, of first Piola-Kirchhoff stresses (3, 3, P here), Pa; summed over ranks."""
        return self.sum_over_ranks(np.stack([self._divergence @ row.ravel() for row in P], axis=1))

    def integrate(self, density: Array) -> float:
        """∫ of a density (P here,) over the body; the same bits on every rank."""
        return float(self.sum_over_ranks(np.array([self.weights @ density]))[0])

    def sum_over_ranks(self, share: Array) -> Array:
        """The sum of what the ranks have, on every rank."""
        if self._comm.size == 1:
            return share
        total = np.empty_like(share)
        self._comm.Allreduce(share, total)
        return total
