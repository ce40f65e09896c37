"""Canonical nodes: a numbering that depends on the mesh file alone, not on the ranks or the dolfinx release.

Vertices first, in the order of the file; then, for degree 2, the mid-points of the edges, in the order of their
vertices. All weights of patches and outputs are computed in it with NumPy; the same on every rank.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse

from fenics_rom.errors import SceneError
from fenics_rom.fem.chambers import Hollow, inner_facets
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.mesh_quality import CELL_EDGES, CELL_FACES, triangle_keys


@dataclass(frozen=True)
class Nodes:
    """The nodes of a Lagrange space of degree 1 or 2."""

    coordinates: np.ndarray  # (N, 3), m
    keys: np.ndarray  # (N, 2) mesh points that a node belongs to: (point, -1) or the two ends of its edge
    cells: np.ndarray  # (C, 4) vertices of each cell
    edges: np.ndarray  # (N - vertices, 2) ends of each edge in canonical vertices, sorted; empty for degree 1
    surface: np.ndarray  # (F, 3) outward triangles of the boundary, between vertices
    mesh: Mesh  # where they come from

    def on_edges(self, ends: np.ndarray) -> np.ndarray:
        """Nodes at the mid-points of edges given by their canonical vertices, (..., 2) to (...)."""
        ends = np.sort(ends, axis=-1)
        count = len(self.coordinates)
        rows = np.searchsorted(self.edges[:, 0] * count + self.edges[:, 1], ends[..., 0] * count + ends[..., 1])
        return len(self.coordinates) - len(self.edges) + rows

    def triangle_edges(self, triangles: np.ndarray) -> np.ndarray:
        """Mid-side nodes of triangles, (F, 3): of the sides 01, 12, 20."""
        return self.on_edges(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2))

    def triangle_nodes(self, triangles: np.ndarray) -> np.ndarray:
        """All nodes of triangles, (F, 3) or (F, 6): their vertices, then those of `triangle_edges`."""
        return np.hstack([triangles, self.triangle_edges(triangles)]) if len(self.edges) else triangles

    def vertices(self, points: np.ndarray) -> np.ndarray:
        """Canonical vertices of mesh points, -1 for points of no cell."""
        row = np.full(len(self.mesh.points), -1, dtype=np.int64)
        used = self.keys[self.keys[:, 1] < 0, 0]
        row[used] = np.arange(len(used))
        return row[points]

    @cached_property
    def chambers(self) -> tuple[np.ndarray, list[Hollow]]:
        """Which triangles of the surface are the walls of chambers, (F,), and all hollows."""
        return inner_facets(self.coordinates, self.surface)

    def drawn_triangles(self) -> np.ndarray:
        """Surface triangles through all nodes: each split in four for degree 2."""
        if len(self.edges) == 0:
            return self.surface
        (a, b, c), (ab, bc, ca) = self.surface.T, self.triangle_edges(self.surface).T
        return np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def canonical_nodes(mesh: Mesh, degree: int) -> Nodes:
    """Numbers the nodes of a mesh."""
    used, cells = np.unique(mesh.cells, return_inverse=True)
    cells = cells.reshape(-1, 4)
    keys = np.stack([used, np.full(len(used), -1)], axis=1)
    coordinates = mesh.points[used]
    edges = np.empty((0, 2), dtype=np.int64)
    if degree == 2:
        edges = np.unique(np.sort(cells[:, CELL_EDGES], axis=2).reshape(-1, 2), axis=0)
        keys = np.concatenate([keys, used[edges]])
        coordinates = np.concatenate([coordinates, coordinates[edges].mean(axis=1)])
    faces = cells[:, CELL_FACES].reshape(-1, 3)  # of positively oriented cells they point outward
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return Nodes(coordinates, keys, cells, edges, faces[first[count == 1]], mesh)


def face_keys(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """One number for each triangle, whatever the order of its vertices."""
    return triangle_keys(triangles, len(nodes.coordinates) + 1)


def area_vectors(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """Outward normals (F, 3) of triangles, twice as long as their areas, m²."""
    a, b, c = (nodes.coordinates[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def triangle_areas(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """(F,), m²."""
    return np.linalg.norm(area_vectors(nodes, triangles), axis=1) / 2


def rim_edges(triangles: np.ndarray) -> np.ndarray:
    """Edges (r, 2) of a surface (F, 3) that one triangle alone has, in its sense; of a closed surface none."""
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    count = triangles.max(initial=0) + 1
    rim: np.ndarray = sides[~np.isin(sides[:, 0] * count + sides[:, 1], sides[:, 1] * count + sides[:, 0])]
    return rim


def load_weights(nodes: Nodes, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integral of each node's shape function over each flat triangle: nodes (F, 3) and weights (F, 1), m².

    Degree 1: a third of the area at each vertex. Degree 2: nothing at the vertices, a third at each mid-side node.
    """
    carriers = nodes.triangle_edges(triangles) if len(nodes.edges) else triangles
    return carriers, triangle_areas(nodes, triangles)[:, None] / 3


def mean_over(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """Weights (N,) whose product with nodal values is their mean over a surface."""
    carriers, weight = load_weights(nodes, triangles)
    mean = np.zeros(len(nodes.coordinates))
    np.add.at(mean, carriers, weight)
    return mean / mean.sum()


def surface_mass(nodes: Nodes, triangles: np.ndarray, weights: np.ndarray | None = None) -> scipy.sparse.csr_matrix:
    """∫ w φ_i φ_j over flat triangles, as a share of their area, (N, N); w (F,) is 1 unless given."""
    area = triangle_areas(nodes, triangles)
    share = area / area.sum() * (1.0 if weights is None else weights)
    if len(nodes.edges):
        opposite = -4 * np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
        element = np.block([[7 * np.eye(3) - 1, opposite], [opposite.T, 16 * (np.eye(3) + 1)]]) / 180
    else:
        element = (np.eye(3) + 1) / 12
    ends = nodes.triangle_nodes(triangles)
    rows, columns = (np.repeat(ends, len(element), axis=1), np.tile(ends, len(element)))
    values = share[:, None] * element.ravel()
    entries = values.ravel(), (rows.ravel(), columns.ravel())
    return scipy.sparse.csr_matrix(entries, shape=2 * (len(nodes.coordinates),))


def cell_at(nodes: Nodes, point: np.ndarray, where: str) -> tuple[int, np.ndarray]:
    """The cell in which a point is, and its barycentric coordinates (4,) there.

    A point just outside (a marker on a curved surface that the mesh cuts off) is taken to the nearest cell.

    Raises:
        SceneError: it is farther outside.
    """
    corners = nodes.coordinates[nodes.cells]
    edges = np.transpose(corners[:, 1:] - corners[:, :1], (0, 2, 1))
    inner = np.linalg.solve(edges, (point - corners[:, 0])[:, :, None])[:, :, 0]
    barycentric = np.column_stack([1 - inner.sum(axis=1), inner])
    clipped = np.clip(barycentric, 0, None)
    clipped /= clipped.sum(axis=1)[:, None]
    distance = np.linalg.norm(np.einsum("ci,cij->cj", clipped, corners) - point, axis=1)
    cell = int(distance.argmin())
    size = np.linalg.norm(np.ptp(nodes.coordinates, axis=0))
    if distance[cell] > 0.01 * size:
        raise SceneError(
            f"{where}: point {point.tolist()} is {distance[cell]:.3g} m outside the body; "
            f"allowed is 1 % of its size, {0.01 * size:.3g} m (mesh.scale says in which unit the mesh is)"
        )
    return cell, clipped[cell]


def shape_functions(nodes: Nodes, point: np.ndarray, where: str) -> np.ndarray:
    """Values (N,) of all shape functions at a point; SceneError as of `cell_at`."""
    values = np.zeros(len(nodes.coordinates))
    cell, λ = cell_at(nodes, point, where)
    vertices = nodes.cells[cell]
    if len(nodes.edges) == 0:
        values[vertices] = λ
    else:
        values[vertices] = λ * (2 * λ - 1)
        i, j = CELL_EDGES.T
        values[nodes.on_edges(vertices[CELL_EDGES])] = 4 * λ[i] * λ[j]
    return values


def facets_and_cells(nodes: Nodes, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which facets of the boundary some are, in its order, and the cell that each is a face of."""
    row = np.flatnonzero(np.isin(face_keys(nodes, nodes.surface), face_keys(nodes, facets)))
    of_cells = face_keys(nodes, nodes.cells[:, CELL_FACES].reshape(-1, 3))
    order = np.argsort(of_cells)
    face = order[np.searchsorted(of_cells[order], face_keys(nodes, nodes.surface[row]))]
    return row, face // len(CELL_FACES)


def shape_gradients(nodes: Nodes, cells: np.ndarray, λ: np.ndarray) -> np.ndarray:
    """∂N_a/∂X_j (P, A, 3), 1/m, at barycentric coordinates λ (P, 4) of cells (P,)."""
    corners = nodes.coordinates[nodes.cells[cells]]
    inner = np.linalg.inv(corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    of_λ = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)  # ∂λ_v/∂X_j (P, 4, 3)
    if not len(nodes.edges):
        return of_λ
    i, j = CELL_EDGES.T
    at_vertices = (4 * λ - 1)[:, :, None] * of_λ
    on_edges = 4 * (λ[:, i, None] * of_λ[:, j] + λ[:, j, None] * of_λ[:, i])
    return np.concatenate([at_vertices, on_edges], axis=1)
