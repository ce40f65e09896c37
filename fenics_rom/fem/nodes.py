"""Canonical nodes: a numbering that depends on the mesh file alone, not on the ranks or the dolfinx release.

Vertices first, in the order of the file; then, for degree 2, the mid-points of the edges, in the order of their
vertices. All weights of patches and outputs are computed in it with NumPy; the same on every rank.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.mesh_quality import CELL_EDGES, CELL_FACES
from fenics_rom.mechanics.surface_points import mean_turning_maps
from fenics_rom.scene.places import Facing, Near, Patch, Place, Plane
from fenics_rom.system.body import Unknowns

SAME_PLANE = 1e-6  # share of the body's length that corners of triangles may be off a plane


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
    count = len(nodes.coordinates) + 1
    return np.sort(triangles, axis=1) @ np.array([count * count, count, 1])


def surface_triangles(nodes: Nodes, name: str) -> np.ndarray:
    """Outward triangles of a named surface, between canonical vertices; refuses one that is not on the boundary."""
    given, boundary = face_keys(nodes, nodes.vertices(nodes.mesh.surface(name))), face_keys(nodes, nodes.surface)
    order = np.argsort(boundary)
    position = np.minimum(np.searchsorted(boundary[order], given), len(order) - 1)
    _refuse_stray(nodes, name, boundary[order][position] != given, "on the boundary of the body")
    return nodes.surface[np.unique(order[position])]


def _refuse_stray(nodes: Nodes, name: str, is_stray: np.ndarray, allowed: str) -> None:
    if is_stray.any():
        count = f"{is_stray.sum()} of its {len(is_stray)} triangles"
        raise MeshError(f"{nodes.mesh.source}: surface {name!r}: {count} are not {allowed}")


def _near_triangles(nodes: Nodes, near: Near, where: str) -> np.ndarray:
    centroids = nodes.coordinates[nodes.surface].mean(axis=1)
    distance = np.linalg.norm(centroids - near.point, axis=1)
    chosen = distance <= near.radius
    if not chosen.any():
        raise SceneError(
            f"{where}.near.radius = {near.radius:g}: no surface triangle has its centroid that close to "
            f"{list(near.point)}; the nearest is {distance.min():.4g} m away"
        )
    return nodes.surface[chosen]


def _plane_triangles(nodes: Nodes, plane: Plane, where: str) -> np.ndarray:
    reach = plane.distance or SAME_PLANE * float(np.ptp(nodes.coordinates, axis=0).max())
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    off = np.abs((nodes.coordinates[nodes.surface] - plane.point) @ normal).max(axis=1)
    if not (off <= reach).any():
        raise SceneError(
            f"{where}.plane: no surface triangle is within {reach:.3g} m of the plane through {list(plane.point)} with "
            f"normal {list(plane.normal)}; the nearest has a corner {off.min():.4g} m off"
        )
    return nodes.surface[off <= reach]


def _facing_triangles(nodes: Nodes, facing: Facing, where: str) -> np.ndarray:
    normals, direction = _twice_area_vectors(nodes, nodes.surface), np.array(facing.direction)
    cosine = normals @ direction / (np.linalg.norm(normals, axis=1) * np.linalg.norm(direction))
    angles = np.arccos(np.clip(cosine, -1.0, 1.0))
    if not (angles <= facing.angle).any():
        raise SceneError(
            f"{where}.facing.angle = {facing.angle:g}: no surface triangle looks that close to "
            f"{list(facing.direction)}; the nearest is {angles.min():.4g} rad off"
        )
    return nodes.surface[angles <= facing.angle]


def clamped_nodes(nodes: Nodes, name: str) -> np.ndarray:
    """All nodes of a named surface, inside the body or on its boundary; refuses one that is not of faces of cells."""
    triangles = nodes.vertices(nodes.mesh.surface(name))
    faces = nodes.cells[:, CELL_FACES].reshape(-1, 3)
    is_stray = ~np.isin(face_keys(nodes, triangles), face_keys(nodes, faces))
    _refuse_stray(nodes, name, is_stray, "faces of the tetrahedra")
    return np.unique(nodes.triangle_nodes(triangles))


def _twice_area_vectors(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """Outward normals (F, 3) of twice the area, m²."""
    a, b, c = (nodes.coordinates[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def triangle_areas(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """(F,), m²."""
    return np.linalg.norm(_twice_area_vectors(nodes, triangles), axis=1) / 2


def _load_weights(nodes: Nodes, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integral of each node's shape function over each flat triangle: nodes (F, 3) and weights (F, 1), m².

    Degree 1: a third of the area at each vertex. Degree 2: nothing at the vertices, a third at each mid-side node.
    """
    carriers = nodes.triangle_edges(triangles) if len(nodes.edges) else triangles
    return carriers, triangle_areas(nodes, triangles)[:, None] / 3


def mean_over(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """Weights (N,) whose product with nodal values is their mean over a surface."""
    carriers, weight = _load_weights(nodes, triangles)
    mean = np.zeros(len(nodes.coordinates))
    np.add.at(mean, carriers, weight)
    return mean / mean.sum()


def patch_triangles(nodes: Nodes, patch: Place, where: str) -> np.ndarray:
    """Outward triangles of a patch, between canonical vertices."""
    if patch.near is not None:
        return _near_triangles(nodes, patch.near, where)
    if patch.plane is not None:
        return _plane_triangles(nodes, patch.plane, where)
    if patch.facing is not None:
        return _facing_triangles(nodes, patch.facing, where)
    return surface_triangles(nodes, str(patch.surface))


def patch_nodes(nodes: Nodes, patch: Place, where: str) -> np.ndarray:
    """All nodes of a patch, ascending."""
    return np.unique(nodes.triangle_nodes(patch_triangles(nodes, patch, where)))


def patch_area(nodes: Nodes, patch: Place, where: str) -> float:
    """Area of a patch, m²."""
    return 3 * float(_load_weights(nodes, patch_triangles(nodes, patch, where))[1].sum())


def surface_mass(nodes: Nodes, triangles: np.ndarray) -> scipy.sparse.csr_matrix:
    """∫ φ_i φ_j over flat triangles, as a share of their area, (N, N)."""
    area = triangle_areas(nodes, triangles)
    if len(nodes.edges):
        opposite = -4 * np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
        element = np.block([[7 * np.eye(3) - 1, opposite], [opposite.T, 16 * (np.eye(3) + 1)]]) / 180
    else:
        element = (np.eye(3) + 1) / 12
    ends = nodes.triangle_nodes(triangles)
    rows, columns = (np.repeat(ends, len(element), axis=1), np.tile(ends, len(element)))
    values = (area / area.sum())[:, None] * element.ravel()
    entries = values.ravel(), (rows.ravel(), columns.ravel())
    return scipy.sparse.csr_matrix(entries, shape=2 * (len(nodes.coordinates),))


def patch_columns(nodes: Nodes, patch: Patch, unknowns: Unknowns, where: str) -> np.ndarray:
    """Columns of the input matrix of a patch, on the components of all nodes, (3 N, columns).

    Refuses a patch that cannot move; messages call it `where`.
    """
    triangles = patch_triangles(nodes, patch, where)
    if patch.force == "normal":
        columns = _inward_pressure(nodes, triangles).reshape(-1, 1)
    elif patch.force == "resultant":
        columns = np.kron(mean_over(nodes, triangles)[:, None], np.eye(3))
    elif patch.force == "wrench":
        columns = wrench_columns(nodes.coordinates, mean_over(nodes, triangles))
    else:
        touched_nodes = patch_nodes(nodes, patch, where)
        components = np.intersect1d(3 * touched_nodes[:, None] + np.arange(3), unknowns.free)
        columns = np.zeros((3 * len(nodes.coordinates), len(components)))
        columns[components, np.arange(len(components))] = 1.0
    if not np.any(unknowns.restrict(columns)):
        raise SceneError(f"{where}: the whole patch is clamped, so no force on it can move the body")
    return columns


def wrench_columns(coordinates: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Nodal forces (3 N, 6) of unit forces, and of unit moments about the mean place, of weights (N,) whose sum is 1.

    See mechanics/surface_points.py; moments in N m.
    """
    turning = mean_turning_maps(coordinates - weights @ coordinates, weights)
    return np.hstack([np.kron(weights[:, None], np.eye(3)), turning.swapaxes(1, 2).reshape(-1, 3)])


def _inward_pressure(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """Nodal forces (N, 3) of a total of 1 N."""
    carriers, weight = _load_weights(nodes, triangles)
    inward = -_twice_area_vectors(nodes, triangles)
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    force = np.zeros((len(nodes.coordinates), 3))
    np.add.at(force, carriers, (weight * inward)[:, None, :])
    return force / (3 * weight.sum())


def shape_functions(nodes: Nodes, point: np.ndarray, where: str) -> np.ndarray:
    """Values (N,) of all shape functions at a point.

    A point just outside (a marker on a curved surface that the mesh cuts off) is read at the nearest cell.
    """
    corners = nodes.coordinates[nodes.cells]
    edges = np.transpose(corners[:, 1:] - corners[:, :1], (0, 2, 1))
    inner = np.linalg.solve(edges, (point - corners[:, 0])[:, :, None])[:, :, 0]
    barycentric = np.column_stack([1 - inner.sum(axis=1), inner])
    clipped = np.clip(barycentric, 0, None)
    clipped /= clipped.sum(axis=1)[:, None]
    distance = np.linalg.norm(np.einsum("ci,cij->cj", clipped, corners) - point, axis=1)
    cell = distance.argmin()
    size = np.linalg.norm(np.ptp(nodes.coordinates, axis=0))
    if distance[cell] > 0.01 * size:
        raise SceneError(
            f"{where}: point {point.tolist()} is {distance[cell]:.3g} m outside the body; "
            f"allowed is 1 % of its size, {0.01 * size:.3g} m (mesh.scale says in which unit the mesh is)"
        )
    values = np.zeros(len(nodes.coordinates))
    vertices, λ = nodes.cells[cell], clipped[cell]
    if len(nodes.edges) == 0:
        values[vertices] = λ
    else:
        values[vertices] = λ * (2 * λ - 1)
        i, j = CELL_EDGES.T
        values[nodes.on_edges(vertices[CELL_EDGES])] = 4 * λ[i] * λ[j]
    return values
