"""Matrices that Abaqus has written of a body (`*MATRIX GENERATE`, `*MATRIX OUTPUT`), with the input file they are of.

A line of FORMAT=MATRIX INPUT, which is the default, names the node and the degree of freedom of a row, those of a
column, and an entry: "7,1, 12,3, -2.5e6"; one of FORMAT=COORDINATE a row, a column and an entry, with three rows for
each node in the order of their numbers. Of a symmetric matrix there is one half, or both. What `*BOUNDARY` holds has
1e36 on the diagonal.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import StructureError, check_known
from fenics_rom.fem.abaqus_file import AbaqusFile, solid_shape

HELD = 1e35  # on the diagonal, what is held
UNITS = {"m-kg-s": (1.0, 1.0), "mm-t-s": (1e-3, 1e3)}  # m of a length; kg, N/m and N s/m of what matrices hold
LINES_AT_ONCE = 100_000  # of a file, as words take ten times the memory of numbers
Edges = tuple[tuple[int, int], ...]
# Of solids, by their number of corners: faces, outward, and edges, whose middles follow the corners in their nodes.
FACES: dict[int, tuple[tuple[int, ...], ...]] = {
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    6: ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
EDGES: dict[int, Edges] = {
    4: ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    6: ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    8: (*((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)), *((0, 4), (1, 5), (2, 6), (3, 7))),
}


@dataclass(frozen=True)
class AbaqusBody:
    """What belongs together of a body's files.

    Attributes:
        matrices: by name, (3 N, 3 N), kg, N s/m, N/m.
        nodes: (N, 3), m, in the order of their numbers.
        triangles: (F, 3) outward, of its surface, between nodes.
        sets: rows of `nodes` of each set of nodes.
    """

    matrices: Mapping[str, scipy.sparse.csr_matrix]
    nodes: Array
    triangles: Array
    sets: Mapping[str, Array]

    def columns_of(self, name: str, where: str) -> Array:
        """Three columns (3 N, 3) of a set of nodes: a force spread evenly over them, or their mean displacement."""
        check_known("set of nodes", name, self.sets, StructureError, f"{where}: ")
        weights = np.bincount(self.sets[name], minlength=len(self.nodes)) / len(self.sets[name])
        return np.kron(weights[:, None], np.eye(3))


def read_abaqus_body(file: Path, matrices: Mapping[str, str | PathLike[str]], units: str) -> AbaqusBody:
    """The body of an input file and of its matrices.

    Args:
        file: `.inp`.
        matrices: their files by name.
        units: of all these files, one of UNITS.

    Raises:
        MeshError: the input file cannot be read.
        StructureError: a matrix cannot be read, or is of other nodes, or holds what is held.
    """
    check_known("system of units", units, UNITS, StructureError, "units: ")
    length, worth = UNITS[units]
    content = AbaqusFile(file)
    tables = {name: _read_table(Path(given)) for name, given in matrices.items()}
    numbers = _nodes_of_rows(content, tables, matrices)
    row_of = {number: row for row, number in enumerate(numbers)}
    return AbaqusBody(
        {name: worth * _assemble(table, row_of, str(matrices[name])) for name, table in tables.items()},
        length * np.array([content.nodes[number] for number in numbers]),
        _surface(content, row_of),
        {
            name: np.array(sorted({row_of[node] for node in nodes if node in row_of}))
            for name, nodes in content.node_sets.items()
            if any(node in row_of for node in nodes)
        },
    )


def _read_table(file: Path) -> Array:
    """Lines of a matrix: (entries, 5), or (entries, 3) of coordinates."""
    try:
        lines = file.read_text(encoding="latin-1").replace(",", " ").splitlines()
    except OSError as error:
        raise StructureError(f"{file}: cannot be read: {error.strerror or error}") from error
    entries = [line for line in lines if line.strip() and not line.startswith("*")]
    if not entries:
        raise StructureError(f"{file}: holds no entries")
    parts = [entries[k : k + LINES_AT_ONCE] for k in range(0, len(entries), LINES_AT_ONCE)]
    try:
        table = np.concatenate([np.array([line.split() for line in part], dtype=float) for part in parts])
    except ValueError as error:
        raise StructureError(
            f"{file}: cannot be read as a matrix of Abaqus: {error}; use *Matrix output with format=MATRIX "
            "INPUT and COORDINATE"
        ) from error
    if table.shape[1] not in (3, 5):
        raise StructureError(
            f"{file}: has {table.shape[1]} numbers in a line; use node, degree of freedom, node, degree of "
            "freedom and entry, or row, column and entry"
        )
    places = table[:, :-1]
    if not np.isfinite(table).all() or (places != np.round(places)).any():
        raise StructureError(f"{file}: holds nodes or rows that are no whole numbers, or entries that are not finite")
    return table


def _nodes_of_rows(
    content: AbaqusFile, tables: Mapping[str, Array], files: Mapping[str, str | PathLike[str]]
) -> list[int]:
    """Numbers of the nodes that have rows, ascending."""
    named: set[int] = set()
    rows = 0
    for name, table in tables.items():
        if table.shape[1] == 3:
            rows = max(rows, int(table[:, :2].max()))
            continue
        named |= {int(number) for number in np.unique(table[:, [0, 2]])}
        others = sorted(named - content.nodes.keys())
        if others:
            raise StructureError(
                f"{files[name]}: names nodes that {content.file} does not hold, {others[0]} for one (below 1 are "
                "Abaqus' own, of constraints); use matrices of the same file, of solids without constraints"
            )
        kinds = np.unique(table[:, [1, 3]])
        if not np.isin(kinds, [1, 2, 3]).all():
            raise StructureError(f"{files[name]}: has degree of freedom {kinds.max():.0f}; use 1, 2 or 3")
    if not rows:
        return sorted(named)
    of_solids = {node for _, nodes in content.solids.values() for node in nodes}
    for candidates in (of_solids, content.nodes.keys()):
        if 3 * len(candidates) == rows:
            return sorted(candidates)
    raise StructureError(
        f"{content.file}: has {len(of_solids)} nodes of solids and {len(content.nodes)} in all, but the matrices have "
        f"{rows} rows; use three for each node, or format=MATRIX INPUT, which says which row is which"
    )


def _assemble(table: Array, row_of: Mapping[int, int], file: str) -> scipy.sparse.csr_matrix:
    """The whole matrix, (3 N, 3 N), of the lines of one half or both."""
    values, size = table[:, -1], 3 * len(row_of)
    if table.shape[1] == 3:
        rows, columns = table[:, :2].astype(int).T - 1
    else:
        nodes = [np.array([row_of[int(number)] for number in numbers]) for numbers in table[:, [0, 2]].T]
        rows, columns = (3 * of + table[:, k].astype(int) - 1 for of, k in zip(nodes, (1, 3), strict=True))
    if rows.min() < 0 or columns.min() < 0:
        raise StructureError(f"{file}: rows and columns count from 1")
    places = rows * size + columns
    unique, count = np.unique(places, return_counts=True)
    if len(unique) < len(places):
        twice = int(unique[count.argmax()])
        raise StructureError(f"{file}: has row {twice // size + 1}, column {twice % size + 1} twice")
    held = np.flatnonzero((rows == columns) & (values >= HELD))
    if len(held):
        raise StructureError(
            f"{file}: holds {len(held)} degrees of freedom, row {rows[held[0]] + 1} for one: {values[held[0]]:.0e} on "
            "the diagonal; use matrices without *Boundary, or without the nodes that do not move"
        )
    matrix = scipy.sparse.csr_matrix((values, (rows, columns)), shape=(size, size))
    if not ((rows > columns).any() and (rows < columns).any()):
        matrix = matrix + matrix.T - scipy.sparse.diags(matrix.diagonal())
    return matrix.tocsr()


def _surface(content: AbaqusFile, row_of: Mapping[int, int]) -> Array:
    """Outward triangles of the faces of solids that no other has, through the middles of edges where there are some."""
    faces: list[tuple[int, ...]] = []
    middles: dict[tuple[int, int], int] = {}
    for kind, nodes in content.solids.values():
        corners = solid_shape(kind)
        if corners is None:
            continue
        for edge, middle in zip(EDGES[corners], nodes[corners:], strict=False):
            middles[_sorted_pair(nodes[edge[0]], nodes[edge[1]])] = middle
        faces += [tuple(nodes[k] for k in face) for face in FACES[corners]]
    seen = Counter(map(frozenset, faces))
    triangles: list[tuple[int, ...]] = []
    for face in faces:
        if seen[frozenset(face)] > 1 or not set(face) <= row_of.keys():
            continue
        around = [middles.get(_sorted_pair(*pair)) for pair in zip(face, face[1:] + face[:1], strict=True)]
        between = [node for node in around if node is not None]
        if len(between) == len(face):
            triangles += [(a, b, c) for a, b, c in zip(face, between, between[-1:] + between[:-1], strict=True)]
            face = tuple(between)
        triangles += [(face[0], face[k], face[k + 1]) for k in range(1, len(face) - 1)]
    return np.array([[row_of[node] for node in corners] for corners in triangles], dtype=int).reshape(-1, 3)


def _sorted_pair(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)
