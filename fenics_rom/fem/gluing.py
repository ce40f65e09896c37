"""Nodes that lie on one another made one, so that parts of a body that touch hang together."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fenics_rom.errors import MeshError
from fenics_rom.fem.cell_kinds import TETRAHEDRON
from fenics_rom.fem.cell_overlaps import SAME_PLACE
from fenics_rom.fem.mesh import Mesh, checked_mesh, read_mesh
from fenics_rom.fem.mesh_arrays import MeshArrays
from fenics_rom.fem.mesh_quality import CELL_EDGES, CELL_FACES, triangle_keys
from fenics_rom.fem.msh_writer import write_msh


class Glued(NamedTuple):
    """What gluing came to."""

    mesh: Mesh
    nodes: int  # before
    merged: int  # nodes that are others' now
    inside: dict[str, int]  # triangles of named surfaces that are not on the boundary any more
    unmatched: int  # faces of cells between merged nodes that still are on it

    def __str__(self) -> str:
        said = [f"{self.merged} of {self.nodes} merged with others"]
        said += [f"{count} triangles of {name!r} are inside the body now" for name, count in self.inside.items()]
        if self.unmatched:
            said.append(f"{self.unmatched} faces between merged nodes match no other: cells meet there at nodes alone")
        return "; ".join(said)


def glue_mesh(file: Path, output: Path, tolerance: float | None = None, scale: float = 1.0) -> Glued:
    """Merges nodes of a mesh file, and writes a `.msh` file with the same groups.

    Of nodes within the tolerance of one another, also by way of others, the first in the file stays where it is. Groups
    that have a number in place of a name keep it.

    Args:
        file: of any format that `read_mesh` reads.
        output: `.msh` file, of straight tetrahedra with coordinates in m.
        tolerance: m; None: a millionth of the body's diagonal.
        scale: metres that a unit of the file is worth.

    Raises:
        MeshError: the file cannot be read, the tolerance is as long as edges of cells, or cells overlap when glued.
        FileError: the output cannot be written.
    """
    mesh = read_mesh(file, None, scale)
    if mesh.kind is not TETRAHEDRON:
        raise MeshError(f"mesh file {file}: holds hexahedra; only tetrahedra can be glued")
    used = np.unique(mesh.cells)
    points = mesh.points[used]
    if tolerance is None:
        tolerance = SAME_PLACE * float(np.linalg.norm(np.ptp(points, axis=0)))
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=2 * (len(used),))
    _, label = connected_components(graph, directed=False)
    _, first, size = np.unique(label, return_index=True, return_counts=True)
    kept = np.sort(first)
    place = np.full(len(mesh.points), -1)
    place[used] = np.searchsorted(kept, first[label])
    cells = place[mesh.cells]
    if (cells[:, CELL_EDGES[:, 0]] == cells[:, CELL_EDGES[:, 1]]).any():
        edges = mesh.points[mesh.cells[:, CELL_EDGES]]
        shortest = np.linalg.norm(edges[:, :, 0] - edges[:, :, 1], axis=2).min()
        raise MeshError(
            f"mesh file {file}: {tolerance:g} m merges the ends of edges of cells, the shortest of which "
            f"is {shortest:.3g} m long; use less"
        )
    surfaces = {name: place[triangles] for name, triangles in mesh.surfaces.items()}
    surfaces = {name: triangles[(triangles >= 0).all(axis=1)] for name, triangles in surfaces.items()}
    glued = checked_mesh(MeshArrays(points[kept], cells, surfaces, mesh.regions), file)
    write_msh(output, glued)
    old, new = _boundary(mesh.cells), _boundary(glued.cells)
    is_merged = np.zeros(len(kept), dtype=bool)
    is_merged[np.searchsorted(kept, first[size > 1])] = True
    inside = {name: _count(mesh.surfaces[name], old) - _count(surfaces[name], new) for name in surfaces}
    return Glued(
        glued,
        nodes=len(used),
        merged=len(used) - len(kept),
        inside={name: count for name, count in inside.items() if count > 0},
        unmatched=int(is_merged[new].all(axis=1).sum()),
    )


def _boundary(cells: np.ndarray) -> np.ndarray:
    """Faces (F, 3) that only one cell has."""
    faces = cells[:, CELL_FACES].reshape(-1, 3)
    _, first, count = np.unique(triangle_keys(faces, cells.max() + 1), return_index=True, return_counts=True)
    return faces[first[count == 1]]


def _count(triangles: np.ndarray, among: np.ndarray) -> int:
    """How many of the triangles (F, 3) are among others, whatever the order of their vertices."""
    count = int(max(triangles.max(initial=0), among.max(initial=0))) + 1
    return int(np.isin(triangle_keys(triangles, count), triangle_keys(among, count)).sum())
