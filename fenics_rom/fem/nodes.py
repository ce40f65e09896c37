"""Canonical nodes: a numbering that depends on the mesh file alone, not on the ranks or the dolfinx release.

Vertices first, in the order of the file; then, for degree 2, the nodes between two vertices, in the order of these:
in the middle of edges, and of faces and cells of hexahedra (`cell_kinds`). Where the file bends second-order cells they
are there. All weights of patches and outputs are computed in it with NumPy; the same on every rank.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_rom.fem.cell_kinds import TETRAHEDRON, CellKind, tabulate
from fenics_rom.fem.chambers import Hollow, inner_facets
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.mesh_quality import triangle_keys

STRAIGHT = 1e-6  # share of the body's length that the middle of an edge may be off, as files hold few digits


@dataclass(frozen=True)
class Nodes:
    """The nodes of a Lagrange space of degree 1 or 2."""

    coordinates: np.ndarray  # (N, 3), m
    keys: np.ndarray  # (N, 2) mesh points that a node belongs to: (point, -1) or the two that it is between
    cells: np.ndarray  # (C, V) vertices of each cell
    cell_nodes: np.ndarray  # (C, A) all nodes of each cell, in basix' order
    edges: np.ndarray  # (N - vertices, 2) the two vertices that each other is between, sorted; empty for degree 1
    surface: np.ndarray  # (F, 3) outward triangles of the boundary, between vertices; all first halves, then all others
    owner: np.ndarray  # (F,) the cell of each
    mesh: Mesh  # where they come from
    is_curved: bool = False  # whether nodes between vertices are off the middles

    @property
    def kind(self) -> CellKind:
        """Of the cells."""
        return self.mesh.kind

    @property
    def degree(self) -> int:
        """Of the space."""
        return 2 if len(self.edges) else 1

    @property
    def is_straight(self) -> bool:
        """Whether cells are tetrahedra with straight edges, whose gradients do not vary and whose faces are flat."""
        return self.kind is TETRAHEDRON and not self.is_curved

    def on_edges(self, ends: np.ndarray) -> np.ndarray:
        """Nodes between two canonical vertices, (..., 2) to (...)."""
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
    def facet_centroids(self) -> np.ndarray:
        """(F, 3), m, of the faces of cells that the triangles of the surface are, or are halves of."""
        corners = self.coordinates[self.surface]
        if self.kind.facet == "triangle":
            return corners.mean(axis=1)
        first, second = np.split(corners, 2)
        centroids = (first.sum(axis=1) + second[:, 1]) / 4
        return np.concatenate([centroids, centroids])

    def whole_facets(self, chosen: np.ndarray) -> np.ndarray:
        """Which triangles of the surface (F,) are chosen, of quadrilaterals those of which both halves are."""
        return chosen if self.kind.facet == "triangle" else np.tile(np.logical_and(*np.split(chosen, 2)), 2)

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
    kind = mesh.kind
    used, cells = np.unique(mesh.cells, return_inverse=True)
    cells = cells.reshape(mesh.cells.shape)
    keys = np.stack([used, np.full(len(used), -1)], axis=1)
    coordinates, cell_nodes, is_curved = mesh.points[used], cells, False
    edges = np.empty((0, 2), dtype=np.int64)
    if degree == 2:
        pairs = kind.middles(cells)
        edges, number = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
        number = number.reshape(pairs.shape[:2])
        keys = np.concatenate([keys, used[edges]])
        cell_nodes = np.hstack([cells, len(used) + number])
        straight, bent = middle_places(mesh, used, cells, edges, number)
        is_curved = float(np.abs(bent - straight).max(initial=0.0)) > STRAIGHT * np.ptp(coordinates, axis=0).max()
        coordinates = np.concatenate([coordinates, bent if is_curved else straight])
    triangles, owner = kind.triangles(cells)  # of positively oriented cells they point outward
    faces = np.sort(cells[:, kind.faces].reshape(len(owner), -1), axis=1)
    _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
    outer = first[count == 1]
    surface, owner = triangles[:, outer].reshape(-1, 3), np.tile(owner[outer], len(triangles))
    return Nodes(coordinates, keys, cells, cell_nodes, edges, surface, owner, mesh, is_curved)


def middle_places(
    mesh: Mesh, used: np.ndarray, cells: np.ndarray, edges: np.ndarray, number: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where nodes between vertices are if edges are straight, (E, 3), m, and where the file has them.

    Where it has no nodes on faces and in cells of hexahedra, they are where the 20 that it has put them.

    Args:
        mesh: as read.
        used: (W,) mesh points of the vertices.
        cells: (C, V) vertices.
        edges: (E, 2) vertices of each node.
        number: (C, M) which node each cell has in each of its middles.
    """
    kind, corners = mesh.kind, mesh.points[used][cells]
    of_corners = np.round(8 * kind.shapes(1, kind.middle_corners)[0]) / 8  # halves, quarters and eighths, exactly
    straight = np.empty((len(edges), 3))
    straight[number] = of_corners @ corners
    if not len(mesh.edges):
        return straight, straight
    row = np.full(len(mesh.points), -1, dtype=np.int64)
    row[used] = np.arange(len(used))
    given = np.column_stack([np.sort(row[mesh.edges[:, :2]], axis=1), mesh.edges[:, 2]])
    keys, of_given = edges @ np.array([len(used), 1]), given[:, :2] @ np.array([len(used), 1])
    place = np.minimum(np.searchsorted(keys, of_given), len(keys) - 1)
    found = keys[place] == of_given  # diagonals that no node is on are not
    bent, is_given = straight.copy(), np.zeros(len(edges), dtype=bool)
    bent[place[found]], is_given[place[found]] = mesh.points[given[found, 2]], True
    if kind.facet == "quadrilateral" and not is_given[number].all():
        on_edges = (bent - straight)[number[:, : len(kind.edges)]]
        inner = number[:, len(kind.edges) :]
        moved = straight[inner] + kind.serendipity @ on_edges
        lacking = ~is_given[inner]
        bent[inner[lacking]] = moved[lacking]
    return straight, bent


def face_keys(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """One number for each triangle, whatever the order of its vertices."""
    return triangle_keys(triangles, len(nodes.coordinates) + 1)


def area_vectors(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """Outward normals (F, 3) of triangles, twice as long as their areas, m²."""
    a, b, c = (nodes.coordinates[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def triangle_areas(nodes: Nodes, triangles: np.ndarray) -> np.ndarray:
    """(F,), m², of curved cells through all nodes."""
    if not nodes.is_curved:
        return np.linalg.norm(area_vectors(nodes, triangles), axis=1) / 2
    _, slopes, weights = tabulate("triangle", 2, 4)
    bent = np.hstack([triangles, np.roll(nodes.triangle_edges(triangles), -1, axis=1)])
    tangents = np.einsum("qat,fai->tfqi", slopes, nodes.coordinates[bent])
    areas: np.ndarray = np.linalg.norm(np.cross(*tangents), axis=2) @ weights
    return areas


def rim_edges(triangles: np.ndarray) -> np.ndarray:
    """Edges (r, 2) of a surface (F, 3) that one triangle alone has, in its sense; of a closed surface none."""
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    count = triangles.max(initial=0) + 1
    rim: np.ndarray = sides[~np.isin(sides[:, 0] * count + sides[:, 1], sides[:, 1] * count + sides[:, 0])]
    return rim


def facets_and_cells(nodes: Nodes, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangles of the surface some are, in its order, and the cell that each is on."""
    row = np.flatnonzero(np.isin(face_keys(nodes, nodes.surface), face_keys(nodes, facets)))
    return row, nodes.owner[row]
