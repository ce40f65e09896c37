"""Forces that follow the body: pressure on the moved surface, tendons through moved points, and rigid bars.

And those of driven supports, which stay as they are, but are asked the same.
"""

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.cell_kinds import tabulate
from fenics_rom.fem.facets import facet_nodes
from fenics_rom.fem.nodes import Nodes, rim_edges
from fenics_rom.mechanics.readings import swept_volume
from fenics_rom.mechanics.tendon import (
    cable_length,
    measure_segments,
    sum_end_forces,
    turning_angles,
    unit_tension_forces,
)


class PressureLoad:
    """1 Pa on faces with outward triangles (F, 3): -∫ n dA of the moved ones.

    That is what the enclosed volume changes by with each node.
    """

    def __init__(self, nodes: Nodes, triangles: Array):
        self._facet_nodes, _ = facet_nodes(nodes, triangles)
        self._rest = nodes.coordinates
        self._triangles, self._nodes = triangles, nodes
        degree, facet = 2 if len(nodes.edges) else 1, nodes.kind.facet
        # Of a shape function times n, of a quadrilateral along each axis.
        exact = 3 * degree - 2 if facet == "triangle" else 3 * degree - 1
        self._shapes, self._shape_gradients, self._weights = tabulate(facet, degree, exact)

    def force(self, u: Array) -> Array:
        """Of a unit input, (N, 3), at displacements (N, 3)."""
        x_ξ, x_η = self._tangents(self._rest + u)
        return self._assemble(np.cross(x_ξ, x_η))

    def jvp(self, u: Array, du: Array) -> Array:
        """Its change (N, 3) with a change (N, 3) of displacements (N, 3)."""
        x_ξ, x_η = self._tangents(self._rest + u)
        dx_ξ, dx_η = self._tangents(du)
        return self._assemble(np.cross(dx_ξ, x_η) + np.cross(x_ξ, dx_η))

    def stiffness(self, u: Array) -> scipy.sparse.csr_matrix:
        """-∂force/∂u (3N, 3N) at displacements (N, 3), of which the symmetric part: all of it on a closed surface."""
        x_ξ, x_η = self._tangents(self._rest + u)
        shapes, slopes = self._weights[:, None] * self._shapes, self._shape_gradients
        blocks = np.einsum("qa,qb,fqji->faibj", shapes, slopes[..., 0], np.cross(np.eye(3), x_η[..., None, :]))
        blocks -= np.einsum("qa,qb,fqji->faibj", shapes, slopes[..., 1], np.cross(np.eye(3), x_ξ[..., None, :]))
        places = (3 * self._facet_nodes[..., None] + np.arange(3)).reshape(len(blocks), -1)
        rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
        entries = blocks.reshape(rows.shape).ravel(), (rows.ravel(), columns.ravel())
        matrix = scipy.sparse.coo_matrix(entries, shape=(u.size, u.size)).tocsr()
        return (matrix + matrix.T) / 2

    def stroke(self, u: Array) -> float:
        """What its force does work along, m or m³, at displacements (N, 3)."""
        return swept_volume(lambda x: self.force(x.reshape(-1, 3)).ravel(), u.ravel())

    def rim(self) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """What makes points and pieces (G, 3) of the surface's edge of the places of nodes, (G, N) each.

        It runs counter-clockwise, seen from outside; a closed surface has none.
        """
        ends, count = rim_edges(self._triangles), len(self._rest)
        is_bent = bool(len(self._nodes.edges))
        ξ, weights = np.polynomial.legendre.leggauss(3 if is_bent else 2)  # |y|² dy has the degree 5, or 2
        ξ, weights = (1 + ξ) / 2, weights / 2
        shapes, slopes, on = np.stack([1 - ξ, ξ]), np.stack([-np.ones_like(ξ), np.ones_like(ξ)]), ends
        if is_bent:
            on = np.hstack([ends, self._nodes.on_edges(ends)[:, None]]) if len(ends) else np.empty((0, 3), int)
            shapes = np.stack([(1 - ξ) * (1 - 2 * ξ), ξ * (2 * ξ - 1), 4 * ξ * (1 - ξ)])
            slopes = np.stack([4 * ξ - 3, 4 * ξ - 1, 4 - 8 * ξ])
        rows = np.broadcast_to(np.arange(len(on) * len(ξ)).reshape(len(on), 1, len(ξ)), (len(on), len(shapes), len(ξ)))
        columns = np.broadcast_to(on[:, :, None], rows.shape)

        def matrix(values: Array) -> scipy.sparse.csr_matrix:
            entries = np.broadcast_to(values, rows.shape).ravel(), (rows.ravel(), columns.ravel())
            return scipy.sparse.coo_matrix(entries, shape=(len(on) * len(ξ), count)).tocsr()

        return matrix(shapes), matrix(weights * slopes)

    def _tangents(self, x: Array) -> Array:
        """∂x/∂ξ and ∂x/∂η, (2, F, Q, 3), of the surface that runs through places (N, 3)."""
        return np.einsum("qat,fai->tfqi", self._shape_gradients, x[self._facet_nodes])

    def _assemble(self, normals: Array) -> Array:
        """-∫ n N_a of each node (N, 3) from normals times area (F, Q, 3)."""
        forces = np.zeros_like(self._rest)
        terms = np.einsum("q,qa,fqi->fai", self._weights, self._shapes, normals)
        np.add.at(forces, self._facet_nodes, -terms)
        return forces


class TendonPull:
    """A tension of 1 N in a cable through points (K, 3) at rest, shape functions (K, N): -∂ℓ/∂x of its length ℓ."""

    def __init__(self, points: Array, shapes: Array):
        self.points, self.shapes = points, scipy.sparse.csr_matrix(shapes)

    def force(self, u: Array) -> Array:
        """As of PressureLoad."""
        return self.shapes.T @ unit_tension_forces(self.points + self.shapes @ u)

    def jvp(self, u: Array, du: Array) -> Array:
        """As of PressureLoad."""
        pieces, lengths = measure_segments(self.points + self.shapes @ u)
        directions, change = pieces / lengths, np.diff(self.shapes @ du, axis=0)
        elongation = np.einsum("ki,ki->k", directions, change)[:, None]
        return self.shapes.T @ sum_end_forces((change - elongation * directions) / lengths)

    def stiffness(self, u: Array) -> scipy.sparse.csr_matrix:
        """As of PressureLoad; symmetric."""
        pieces, lengths = measure_segments(self.points + self.shapes @ u)
        directions = pieces / lengths
        across = (np.eye(3) - directions[:, :, None] * directions[:, None, :]) / lengths[:, :, None]
        differences = scipy.sparse.kron(self.shapes[1:] - self.shapes[:-1], np.eye(3)).tocsr()
        middle = scipy.sparse.bsr_matrix((across, np.arange(len(across)), np.arange(len(across) + 1)))
        return (differences.T @ middle @ differences).tocsr()

    def stroke(self, u: Array) -> float:
        """As of PressureLoad."""
        return cable_length(self.points) - cable_length(self.points + self.shapes @ u)

    def angles(self, u: Array) -> Array:
        """By which it turns at each guide (K - 2,), rad, at displacements (N, 3)."""
        return turning_angles(self.points + self.shapes @ u)

    def up_to(self, guide: int) -> "TendonPull":
        """From its anchor to a guide, the first of which is 1."""
        return TendonPull(self.points[: guide + 1], self.shapes[: guide + 1])


class RigidBar:
    """A tension of 1 N in a bar of length ℓ between two nodes, which puts x / ℓ on them where they are apart by x.

    It does its work along s = (ℓ² - |x|²) / 2ℓ, which is quadratic: what s changes by in a step is what the force in
    its middle says, so that a bar whose s stays 0 does no work, and is ℓ long at the ends of steps.

    Args:
        places: of the nodes at rest, (2, 3), m.
        ends: these nodes.
        count: of all nodes.
    """

    def __init__(self, places: Array, ends: list[int], count: int):
        self.points, self._ends = places, ends
        self.length = cable_length(places)
        unit = scipy.sparse.coo_matrix(([1.0, 1.0], ([0, 1], ends)), shape=(2, count))
        self.shapes = unit.tocsr()
        stretch = scipy.sparse.csr_matrix([[-1.0, 1.0]]) @ self.shapes
        self._stiffness = scipy.sparse.kron(stretch.T @ stretch / self.length, np.eye(3)).tocsr()

    def force(self, u: Array) -> Array:
        """As of PressureLoad."""
        return self._pulled(self.points + u[self._ends])

    def jvp(self, u: Array, du: Array) -> Array:
        """As of PressureLoad."""
        return self._pulled(du[self._ends])

    def stiffness(self, u: Array) -> scipy.sparse.csr_matrix:
        """As of PressureLoad; symmetric."""
        return self._stiffness

    def stroke(self, u: Array) -> float:
        """As of PressureLoad; s, m."""
        return (self.length**2 - float(np.square(self._apart(u)).sum())) / (2 * self.length)

    def _apart(self, u: Array) -> Array:
        places = self.points + u[self._ends]
        return places[1] - places[0]

    def _pulled(self, ends: Array) -> Array:
        """Forces (N, 3) of ends (2, 3) that are pulled together."""
        forces = np.zeros((self.shapes.shape[1], 3))
        forces[self._ends] = sum_end_forces(np.diff(ends, axis=0) / self.length)
        return forces


class SupportPush:
    """A force of 1 N by which a driven support pushes its nodes: the same wherever they are.

    Args:
        unit: forces (N, 3) on all nodes.
    """

    def __init__(self, unit: Array):
        self._unit, self._none = unit, scipy.sparse.csr_matrix((unit.size, unit.size))

    def force(self, u: Array) -> Array:
        """As of PressureLoad."""
        return self._unit

    def jvp(self, u: Array, du: Array) -> Array:
        """As of PressureLoad."""
        return np.zeros_like(self._unit)

    def stiffness(self, u: Array) -> scipy.sparse.csr_matrix:
        """As of PressureLoad."""
        return self._none

    def stroke(self, u: Array) -> float:
        """How far the support has moved, m."""
        return float((self._unit * u).sum())


FollowerLoad = PressureLoad | TendonPull | RigidBar | SupportPush
