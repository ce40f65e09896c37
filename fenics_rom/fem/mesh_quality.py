"""Whether cells fill a body once, and how good they are."""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from scipy.sparse.csgraph import connected_components

from fenics_rom.errors import MeshError
from fenics_rom.fem.cell_kinds import TETRAHEDRON, CellKind
from fenics_rom.mechanics.body_facts import NEAR_FLAT, quality_of

CELL_EDGES, CELL_FACES = TETRAHEDRON.edges, TETRAHEDRON.faces
OF_CUBE = np.sqrt(3) - 1  # radius ratio of the tetrahedron at a corner of a cube
CLOSED = 1e-9  # share of the volume by which the cells' may differ from what the surface encloses, round-off


def signed_volumes(points: Array, cells: Array) -> Array:
    """Volumes (C,) of tetrahedra, negative where the fourth vertex is behind the first three."""
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def straight_volumes(points: Array, cells: Array, kind: CellKind) -> Array:
    """Signed volumes (C,) of cells (C, V) with straight edges, of the tetrahedra that they are divided into."""
    return signed_volumes(points, kind.tetrahedra(cells)).reshape(len(cells), -1).sum(axis=1)


def radius_ratios(points: Array, cells: Array) -> Array:
    """3 r/R (C,) of the inscribed and the circumscribed sphere, see `CellQuality`.

    r = 3 V/A with the area A of the faces; 24 V R = √((p + q + s)(p + q - s)(p - q + s)(-p + q + s)) with the products
    p, q, s of the lengths of opposite edges.
    """
    volume = np.abs(signed_volumes(points, cells))
    lengths = np.linalg.norm(points[cells[:, CELL_EDGES[:, 0]]] - points[cells[:, CELL_EDGES[:, 1]]], axis=2)
    p, q, s = (lengths[:, e] * lengths[:, 5 - e] for e in range(3))
    a, b, c = (points[cells[:, CELL_FACES[:, k]]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=2).sum(axis=1) / 2
    heron = (p + q + s) * (p + q - s) * (p - q + s) * (q + s - p)
    return 216 * volume**2 / (area * np.sqrt(np.maximum(heron, np.finfo(float).tiny)))


def cell_ratios(points: Array, cells: Array, kind: CellKind) -> Array:
    """Radius ratios (C,) of cells (C, V); of hexahedra the least of the tetrahedra at corners, 1 of a cube."""
    if kind is TETRAHEDRON:
        return radius_ratios(points, cells)
    neighbours = [[*np.setdiff1d(kind.edges[(kind.edges == c).any(axis=1)], c)] for c in range(len(kind.corners))]
    corners = np.column_stack([np.arange(len(kind.corners)), neighbours])
    ratios = radius_ratios(points, cells[:, corners].reshape(-1, 4)).reshape(len(cells), -1) / OF_CUBE
    return np.minimum(ratios.min(axis=1), 1.0)


class Faces(NamedTuple):
    """Faces of cells, and on which side of each other cells are, see `faces_of`."""

    one: Array  # (I,) cells on one side of each face that two have
    other: Array  # (I,) and on the other
    outside: Array  # (F, 3) outward triangles that only one cell has
    owner: Array  # (F,) that cell
    crowded: int  # number of faces that more than two cells have
    sides: Array  # (C,) 1 or -1, -1 of the inverted cells, which have the smaller part of the volume

    def parts(self) -> tuple[int, Array]:
        """Number of parts that hang together by faces, and the part (C,) of each cell."""
        count = len(self.sides)
        graph = scipy.sparse.coo_array((np.ones(len(self.one)), (self.one, self.other)), shape=(count, count))
        return connected_components(graph, directed=False)


def check_filling(points: Array, cells: Array, source: str) -> Faces:
    """Refuses cells that overlap: their volumes add up to more than their surface encloses.

    Args:
        points: (N, 3), m.
        cells: (C, 4), positively oriented.
        source: of the mesh, for messages.

    Raises:
        MeshError: with both volumes, and how many cells are inverted.
    """
    faces = faces_of(points, cells)
    volumes = signed_volumes(points, cells)
    enclosed, filled = volume_within(points[faces.outside]), float(volumes.sum())
    inverted = np.flatnonzero(faces.sides < 0)
    if not faces.crowded and abs(filled - enclosed) <= CLOSED * filled:
        return faces
    flat = quality_of(radius_ratios(points, cells)).near_flat
    where = (
        f", e.g. the one around {points[cells[inverted[0]]].mean(axis=0).round(6).tolist()}" if len(inverted) else ""
    )
    shared = f"; {faces.crowded} faces belong to more than two cells" if faces.crowded else ""
    raise MeshError(
        f"{source}: cells overlap: their volumes add up to {filled:.6g} m³, and the surface encloses {enclosed:.6g} "
        f"m³; {len(inverted)} of {len(cells)} cells are inverted{where}, {flat} are near-flat (radius ratio 3 r/R "
        f"below {NEAR_FLAT:g}){shared}; mesh the body anew, or put back the nodes that were moved through others"
    )


def faces_of(points: Array, cells: Array) -> Faces:
    """Faces of cells, and on which side of each other these are.

    In a mesh that fills a body once, two cells lie on different sides of the face that they share. Where they do not,
    one of them is inverted: turned inside out beside those that it hangs together with.
    """
    faces = cells[:, CELL_FACES].reshape(-1, 3)
    i, j, k = faces.T.astype(np.int64)
    is_even = (j > i) ^ (k > i) ^ (k > j)  # whether sorting the vertices takes an even number of exchanges
    keys = triangle_keys(faces, len(points))
    order = np.argsort(keys, kind="stable")
    _, first, shares = np.unique(keys[order], return_index=True, return_counts=True)
    one, other = order[first[shares == 2]], order[first[shares == 2] + 1]
    folded = is_even[one] == is_even[other]
    sides = np.ones(len(cells))
    if folded.any():
        sides = _sides(one // 4, other // 4, folded, signed_volumes(points, cells))
    outer = order[first[shares == 1]]
    outside = np.where(sides[outer // 4, None] > 0, faces[outer], faces[outer][:, ::-1])
    return Faces(one // 4, other // 4, outside, outer // 4, int((shares > 2).sum()), sides)


def triangle_keys(triangles: Array, count: int) -> Array:
    """One number for each triangle (F, 3) between so many points, whatever the order of its vertices."""
    return np.sort(triangles, axis=1).astype(np.int64) @ np.array([count * count, count, 1])


def _sides(one: Array, other: Array, folded: Array, volumes: Array) -> Array:
    """1 or -1 for each cell, so that cells `one` and `other` differ where their face is `folded`.

    Each cell stands twice in a graph, once for each side; what hangs together in it has compatible sides.
    """
    count = len(volumes)
    beyond = np.where(folded, count, 0)
    start, end = np.concatenate([one, one + count]), np.concatenate([other + beyond, other + count - beyond])
    graph = scipy.sparse.coo_array((np.ones(len(start)), (start, end)), shape=(2 * count, 2 * count))
    _, label = connected_components(graph, directed=False)
    sides = np.where(label[:count] <= label[count:], 1.0, -1.0)
    part = np.minimum(label[:count], label[count:])
    within = np.bincount(part, weights=sides * volumes)
    return sides * np.where(within[part] < 0, -1.0, 1.0)


def volume_within(corners: Array) -> float:
    """Volume that outward triangles of these corners (F, 3, 3), m, enclose, m³: ∫ x·n dA/3 (divergence theorem)."""
    return float(np.linalg.det(corners - corners.mean(axis=(0, 1))).sum()) / 6
