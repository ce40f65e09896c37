"""∇ of displacements at the quadrature points of straight tetrahedra, as a sparse matrix, and the forces of stresses.

The rules are exact for products of two gradients, so that small strains meet the linear stiffness.
"""

from functools import cached_property
from typing import Any

import basix
import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.embedded import NOTHING_EMBEDDED, EmbeddedPoints
from fenics_rom.fem.mesh_quality import CELL_EDGES
from fenics_rom.fem.nodes import Nodes, shape_gradients


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
        embedded: points on surfaces and lines in it, which follow all those of cells; they have no volume.
        selective: whether the middle of each cell follows its points, for changes of volume alone (Hughes, 1980): one
            condition for each cell does not lock nearly incompressible material.

    Attributes:
        cells: (C here,) which cells of the mesh file.
        cell_nodes: (C here, A) nodes of each.
        shape_gradients: (C here, Q, A, 3), ∂N_a/∂X_j, 1/m, but of embedded points.
        barycentric: (P here, 4) coordinates of all points in their cells.
        embedded_gradients, embedded_in: of embedded points (E here, A, 3), and their cells as rows of `cells`.
        weights: (P here,), m³; of the points in the middle and of the others alone their sum is the volume.
        gradient_matrix: sparse (3 P here, N), ∂/∂X_j of a scalar field, the points of j = 0 first, 1/m.
        node_count: N of the mesh.
    """

    def __init__(
        self, nodes: Nodes, degree: int, comm: Any, selective: bool = False, embedded: EmbeddedPoints | None = None
    ):
        self.cells = np.array_split(np.arange(len(nodes.cells)), comm.size)[comm.rank]
        corners = nodes.cells[self.cells]
        self.cell_nodes = np.hstack([corners, nodes.on_edges(corners[:, CELL_EDGES])]) if degree == 2 else corners
        edges = nodes.coordinates[corners[:, 1:]] - nodes.coordinates[corners[:, :1]]  # ∂X_j/∂ξ_k (C, k, j)
        _, reference_gradients, reference_weights = tabulate("tetrahedron", degree, 2 * (degree - 1))
        reference = tabulate("tetrahedron", 1, 2 * (degree - 1))[0]
        if selective:
            _, in_the_middle, volume = tabulate("tetrahedron", degree, 1)
            reference_gradients = np.concatenate([reference_gradients, in_the_middle])
            reference_weights = np.concatenate([reference_weights, volume])
            reference = np.concatenate([reference, np.full((1, 4), 1 / 4)])
        self._selective = selective
        self.shape_gradients = np.einsum("cjk,qak->cqaj", np.linalg.inv(edges), reference_gradients)
        self.embedded = NOTHING_EMBEDDED if embedded is None else embedded.of_cells(self.cells)
        self.barycentric = np.concatenate([np.tile(reference, (len(corners), 1)), self.embedded.barycentric])
        self.embedded_gradients = shape_gradients(nodes, self.embedded.cells, self.embedded.barycentric)
        self.embedded_in = self.embedded.cells - self.cells[:1].sum()
        volumes = np.outer(np.linalg.det(edges), reference_weights).ravel()
        self.weights = np.concatenate([volumes, self.embedded.weights])
        self._comm, self.node_count = comm, len(nodes.coordinates)
        self.gradient_matrix = self._gradient_matrix()
        self._divergence = (self.gradient_matrix.T @ scipy.sparse.diags(np.tile(self.weights, 3))).tocsr()

    def _gradient_matrix(self) -> scipy.sparse.csr_matrix:
        """∂/∂X_j at the points of a scalar field, (3 P here, N), the points of j = 0 first."""
        C, Q, A, _ = self.shape_gradients.shape
        gradients = np.concatenate([self.shape_gradients.reshape(C * Q, A, 3), self.embedded_gradients])
        values = gradients.transpose(2, 0, 1)
        columns = np.broadcast_to(self.of_cells(self.cell_nodes), values.shape)
        row_starts = np.arange(0, values.size + 1, A)
        shape = (3 * len(self.weights), self.node_count)
        return scipy.sparse.csr_matrix((values.ravel(), columns.ravel(), row_starts), shape=shape)

    def of_cells(self, values: Array) -> Array:
        """Values of the cells here (C here, ...) at their points, (P here, ...)."""
        at_points = np.repeat(values, self.shape_gradients.shape[1], axis=0)
        return np.concatenate([at_points, values[self.embedded_in]])

    def shared_moduli(self, first_lame: Array, shear: Array) -> tuple[Array, Array]:
        """λ and μ (P here,) as the points have them: where the middle of a cell has a point, it has all of λ alone.

        What is embedded has neither.
        """
        shares = np.where(self.is_middle, [[1.0], [0.0]], [[0.0 if self._selective else 1.0], [1.0]])
        shares[:, len(shares[0]) - len(self.embedded_in) :] = 0.0
        return shares[0] * first_lame, shares[1] * shear

    @property
    def is_middle(self) -> Array:
        """(P here,): whether a point is in the middle of a cell for changes of volume alone."""
        C, Q, _, _ = self.shape_gradients.shape
        middle = np.zeros(len(self.weights), dtype=bool)
        middle[: C * Q] = self._selective & (np.arange(C * Q) % Q == Q - 1)
        return middle

    def gradients(self, u: Array) -> Array:
        """H (3, 3, P here, ...) of displacements of all nodes (N, 3, ...), H[i, j] = ∂u_i/∂X_j."""
        shape = 3, len(self.weights), *u.shape[2:]
        return np.stack([(self.gradient_matrix @ u[:, i]).reshape(shape) for i in range(3)])  # faster than all at once

    @cached_property
    def _nodal_shares(self) -> scipy.sparse.csr_matrix:
        """(N, P here): which part of the volume around each node every point here has."""
        C, Q, A, _ = self.shape_gradients.shape
        points = np.repeat(np.arange(C * Q), A)
        entries = self.weights[: C * Q][points], (np.repeat(self.cell_nodes, Q, axis=0).ravel(), points)
        volumes = scipy.sparse.coo_matrix(entries, shape=(self.node_count, C * Q)).tocsr()
        around = self.sum_over_ranks(np.asarray(volumes.sum(axis=1))[:, 0])
        shares = scipy.sparse.diags(1 / np.where(around > 0, around, 1.0)) @ volumes
        of_embedded = scipy.sparse.csr_matrix((self.node_count, len(self.embedded_in)))
        return scipy.sparse.hstack([shares, of_embedded], format="csr")

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
