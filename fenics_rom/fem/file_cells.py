"""Cells as files hold them, of several shapes, with nodes on edges and faces; and as they are computed.

Elements are of tetrahedra or of hexahedra (`cell_kinds`). A mesh of anything else is cut: each cell is divided from
its least vertex into tetrahedra, each quadrilateral along the diagonal at its least vertex, which is the same for both
of its cells (Dompierre et al., 1999). Curved sides stay curved: in the middle of a diagonal is the node of the face, or
the place that the cell's shape functions give.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import MeshError
from fenics_rom.fem.cell_kinds import HEXAHEDRON, TETRAHEDRON, CellKind, halves, tetrahedra_from_least
from fenics_rom.fem.mesh_arrays import NO_EDGES, MeshArrays
from fenics_rom.fem.mesh_quality import CELL_EDGES, CELL_FACES, triangle_keys

ALLOWED = "tetrahedra of 4 or 10 nodes, pyramids of 5, 13 or 14, prisms of 6, 15 or 18, hexahedra of 8, 20 or 27"


class Shape(NamedTuple):
    """Of cells in the order of VTK and Abaqus: corners, then nodes on edges, on quadrilaterals, and in the middle."""

    names: tuple[str, str]  # of one, and of several
    corners: int
    parts: int  # tetrahedra that it is cut into
    edges: Array  # (E, 2) corners
    quadrilaterals: Array  # (Q, 4) corners around each
    triangles: Array  # (T, 3)
    through: Array  # (D, 2) corners of the diagonals through the middle


def _shape(names: str, parts: int, edges: str, quadrilaterals: str, triangles: str, through: str = "") -> Shape:
    rows = [
        np.array([[*map(int, word)] for word in words.split()], dtype=int).reshape(-1, count)
        for words, count in ((edges, 2), (quadrilaterals, 4), (triangles, 3), (through, 2))
    ]
    one, several = names.split()
    return Shape((one, several), rows[0].max() + 1, parts, *rows)


TETRAHEDRAL = _shape("tetrahedron tetrahedra", 1, "01 12 02 03 13 23", "", "012 013 123 023")
PYRAMID = _shape("pyramid pyramids", 2, "01 12 23 30 04 14 24 34", "0123", "014 124 234 304")
PRISM = _shape("prism prisms", 3, "01 12 20 34 45 53 03 14 25", "0143 1254 2035", "012 345")
HEXAHEDRAL = _shape(
    "hexahedron hexahedra", 6, "01 12 23 30 45 56 67 74 04 15 26 37", "0374 1265 0154 3267 0123 4567", "", "06 17 24 35"
)
SHAPES = {4: TETRAHEDRAL, 10: TETRAHEDRAL, 5: PYRAMID, 13: PYRAMID, 14: PYRAMID, 6: PRISM, 15: PRISM, 18: PRISM}
SHAPES |= {8: HEXAHEDRAL, 20: HEXAHEDRAL, 27: HEXAHEDRAL}  # by the number of nodes
CUT = {5: PYRAMID, 6: PRISM, 8: HEXAHEDRAL}  # by that of corners


class Computable(NamedTuple):
    """Cells of one kind."""

    points: Array  # (N, 3), those of the file first
    cells: Array  # (C, V)
    kind: CellKind
    edges: Array  # (E, 3) two ends, and the node between
    origin: Array  # (C,) the cell of the file that each is, or is of
    notes: tuple[str, ...]

    def rows(self, of_file: Array) -> Array:
        """Which cells those of a file are, by the numbers of these."""
        return np.flatnonzero(np.isin(self.origin, of_file))

    def arrays(
        self, surfaces: Mapping[str, Array], regions: Mapping[str, Array], vectors: Mapping[str, Array]
    ) -> MeshArrays:
        """With what the file has besides, of these cells."""
        return MeshArrays(self.points, self.cells, surfaces, regions, self.edges, self.notes, vectors, self.kind)


def computable(points: Array, held: Sequence[Array], file: Path) -> Computable:
    """Cells of one kind in place of those of a file.

    Args:
        points: (N, 3).
        held: nodes (C, any) of the cells of each kind, in VTK's order.
        file: for messages.

    Raises:
        MeshError: cells that are cut have a node twice, or triangles beside them are cut along the other diagonal.
    """
    shapes = [SHAPES[nodes.shape[1]] for nodes in held]
    for kind, only in ((TETRAHEDRON, TETRAHEDRAL), (HEXAHEDRON, HEXAHEDRAL)):
        if all(shape is only for shape in shapes):
            cells = np.concatenate([NO_EDGES.reshape(0, only.corners), *(of[:, kind.from_vtk] for of in held)])
            edges = np.concatenate([NO_EDGES, *map(edges_of, held)])
            return Computable(points, cells, kind, edges, np.arange(len(cells)), ())
    corners = [nodes[:, : shape.corners] for nodes, shape in zip(held, shapes, strict=True)]
    parts, origins, unique, first = [], [], dict.fromkeys(CUT, 0), 0
    for of, shape in zip(corners, shapes, strict=True):
        _check_nodes(of, shape, file)
        tetrahedra, origin = tetrahedra_from_least(of, [*shape.quadrilaterals, *shape.triangles])
        parts.append(tetrahedra)
        origins.append(first + origin)
        first += len(of)
        if shape.corners in CUT:
            unique[shape.corners] += len(np.unique(np.sort(of, axis=1), axis=0))
    cells = np.concatenate(parts)
    _check_diagonals(points, held, cells, file)
    points, edges = _with_middles(points, held, cells)
    said = " and ".join(f"{count} {CUT[size].names[count > 1]}" for size, count in unique.items() if count)
    made = sum(count * CUT[size].parts for size, count in unique.items())
    note = f"{said} were cut into {made} tetrahedra: cells are computed if all are tetrahedra, or all hexahedra"
    return Computable(points, cells, TETRAHEDRON, edges, np.concatenate(origins), (note,))


def edges_of(nodes: Array) -> Array:
    """Two corners and the node between them, (E, 3), of the nodes (C, any) of cells of one kind.

    The node on a quadrilateral is between the ends of both diagonals, that in a hexahedron of all four.
    """
    shape = SHAPES[nodes.shape[1]]
    count, faces = nodes.shape[1] - shape.corners, shape.quadrilaterals
    if not count:
        return NO_EDGES
    ends = [shape.edges]
    between = [np.arange(len(shape.edges))]
    if count > len(shape.edges):
        ends += [faces[:, [0, 2]], faces[:, [1, 3]], shape.through]
        on_faces = len(shape.edges) + np.arange(len(faces))
        between += [on_faces, on_faces, np.full(len(shape.through), count - 1)]
    rows = np.column_stack([np.concatenate(ends), shape.corners + np.concatenate(between)])
    return nodes[:, rows].reshape(-1, 3)


def _with_middles(points: Array, held: Sequence[Array], cells: Array) -> tuple[Array, Array]:
    """Points and nodes on the edges of tetrahedra; those that second-order cells lack on diagonals are new ones."""
    given, lacking, places = [NO_EDGES], [NO_EDGES[:, :2]], [points[:0]]
    for nodes in held:
        given.append(edges_of(nodes))
        shape = SHAPES[nodes.shape[1]]
        if nodes.shape[1] == shape.corners + len(shape.edges):
            for corners, diagonals, dimension in (
                *((face, face[[[0, 2], [1, 3]]], 2) for face in shape.quadrilaterals),
                *[(np.arange(shape.corners), shape.through, 3)] * bool(len(shape.through)),
            ):
                is_around = np.isin(shape.edges, corners).all(axis=1)
                of_edges = points[nodes[:, shape.corners + np.flatnonzero(is_around)]].mean(axis=1)
                middle = dimension * of_edges - (dimension - 1) * points[nodes[:, corners]].mean(axis=1)
                lacking.append(nodes[:, diagonals].reshape(-1, 2))
                places.append(np.repeat(middle, len(diagonals), axis=0))
    along = np.array([len(points), 1])
    of_cells = np.unique(np.sort(cells[:, CELL_EDGES].reshape(-1, 2), axis=1) @ along)
    edges, ends = np.concatenate(given), np.sort(np.concatenate(lacking), axis=1)
    edges = edges[np.isin(np.sort(edges[:, :2], axis=1) @ along, of_cells)]
    keys, first = np.unique(ends @ along, return_index=True)
    first = first[np.isin(keys, of_cells)]
    new = np.column_stack([ends[first], len(points) + np.arange(len(first))])
    return np.vstack([points, np.concatenate(places)[first]]), np.concatenate([edges, new])


def _check_nodes(corners: Array, shape: Shape, file: Path) -> None:
    twice = (np.diff(np.sort(corners, axis=1), axis=1) == 0).any(axis=1)
    if twice.any():
        raise MeshError(
            f"mesh file {file}: {twice.sum()} of {len(corners)} {shape.names[1]} have a node twice, e.g. number "
            f"{twice.argmax()} of them; those are not computed: mesh with tetrahedra there"
        )


def _check_diagonals(points: Array, held: Sequence[Array], cells: Array, file: Path) -> None:
    """Refuses triangles that are halves of a quadrilateral along the diagonal that it is not cut along."""
    around = np.concatenate([nodes[:, SHAPES[nodes.shape[1]].quadrilaterals].reshape(-1, 4) for nodes in held])
    first, second = halves(around)
    others = np.concatenate(
        [np.column_stack([first[:, :2], second[:, 1]]), np.column_stack([first[:, 1:], second[:, 1]])]
    )
    keys, of_cells = triangle_keys(others, len(points)), triangle_keys(cells[:, CELL_FACES].reshape(-1, 3), len(points))
    meeting = np.flatnonzero(np.isin(keys, of_cells))
    if len(meeting):
        at = points[others[meeting[0]]].mean(axis=0).round(6).tolist()
        raise MeshError(
            f"mesh file {file}: {len(meeting)} triangles are halves of quadrilaterals, e.g. the one around {at}, along "
            "another diagonal than that from the least node, where these are cut; put pyramids between, or mesh with "
            "tetrahedra alone"
        )
