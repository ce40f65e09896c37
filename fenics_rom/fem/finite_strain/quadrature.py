"""∇ of displacements at the quadrature points of cells, as a sparse matrix, and the forces of stresses.

The rules are those of the linear stiffness, so that small strains meet it.
"""

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.cell_kinds import tabulate
from fenics_rom.fem.cell_points import dilation_points, gradients_at, quadrature_rule, strain_points
from fenics_rom.fem.embedded import NOTHING_EMBEDDED, EmbeddedPoints
from fenics_rom.fem.nodes import Nodes


class QuadraturePoints:
    """The quadrature points of the cells of this rank: those of a cell follow one another.

    Args:
        nodes: all nodes.
        comm: an mpi4py communicator, whose ranks share the cells.
        embedded: points on surfaces and lines in it, which follow all those of cells; they have no volume.
        selective: whether fewer points follow those of each cell, for changes of volume alone (Hughes, 1980): its
            middle, or eight of a hexahedron of degree 2. So few conditions do not lock nearly incompressible material.

    Attributes:
        cells: (C here,) which cells of the mesh file.
        cell_nodes: (C here, A) nodes of each.
        shape_gradients: (C here, Q, A, 3), ∂N_a/∂X_j, 1/m, but of embedded points.
        embedded_gradients, embedded_in: of embedded points (E here, A, 3), and their cells as rows of `cells`.
        weights: (P here,), m³; of the points for changes of volume and of the others alone their sum is the volume.
        gradient_matrix: sparse (3 P here, N), ∂/∂X_j of a scalar field, the points of j = 0 first, 1/m.
        node_count: N of the mesh.
    """

    def __init__(self, nodes: Nodes, comm: Any, selective: bool = False, embedded: EmbeddedPoints | None = None):
        self.cells = np.array_split(np.arange(len(nodes.cells)), comm.size)[comm.rank]
        self.cell_nodes, self._nodes = nodes.cell_nodes[self.cells], nodes
        self.shape_gradients, weights = strain_points(nodes, self.cells)
        self._dilations = 0
        if selective:
            gradients, volumes = dilation_points(nodes, self.shape_gradients, weights)
            self.shape_gradients = np.concatenate([self.shape_gradients, gradients], axis=1)
            weights, self._dilations = np.concatenate([weights, volumes], axis=1), volumes.shape[1]
        self.embedded = NOTHING_EMBEDDED if embedded is None else embedded.of_cells(self.cells)
        self.embedded_gradients = gradients_at(nodes, self.embedded.cells, self.embedded.places)
        self.embedded_in = self.embedded.cells - self.cells[:1].sum()
        self.weights = np.concatenate([weights.ravel(), self.embedded.weights])
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
        """λ and μ (P here,) as the points have them: where some are for changes of volume, they have all of λ alone.

        What is embedded has neither.
        """
        shares = np.where(self.is_dilation, [[1.0], [0.0]], [[0.0 if self._dilations else 1.0], [1.0]])
        shares[:, len(shares[0]) - len(self.embedded_in) :] = 0.0
        return shares[0] * first_lame, shares[1] * shear

    @property
    def is_dilation(self) -> Array:
        """(P here,): whether a point is for changes of volume alone."""
        C, Q, _, _ = self.shape_gradients.shape
        dilation = np.zeros(len(self.weights), dtype=bool)
        dilation[: C * Q] = np.arange(C * Q) % Q >= Q - self._dilations
        return dilation

    @property
    def strain_places(self) -> Array:
        """Where the points (S here, 3) are that have strain and volume, m."""
        values, _, _ = tabulate(self._nodes.kind.name, self._nodes.degree, quadrature_rule(self._nodes)[0])
        places: Array = np.einsum("qa,cai->cqi", values, self._nodes.coordinates[self.cell_nodes]).reshape(-1, 3)
        return places

    def dilation_stiffness(self, moduli: Array) -> scipy.sparse.csr_matrix:
        """∫ λ tr ε tr δε of all displacements (3 N, 3 N), N/m; λ (P here,) is 0 but at points for changes of volume."""
        count = len(self.weights)
        used = np.flatnonzero(moduli)
        blocks = [self.gradient_matrix[j * count + used] for j in range(3)]
        parts = [scipy.sparse.kron(block, np.eye(3)[j : j + 1]) for j, block in enumerate(blocks)]
        divergence = sum(parts[1:], parts[0]).tocsr()
        return (divergence.T @ scipy.sparse.diags((moduli * self.weights)[used]) @ divergence).tocsr()

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
