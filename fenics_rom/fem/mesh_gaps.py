"""Where cells of a mesh may be missing: nodes and triangles without cells, small holes, cells joined along edges."""

from collections.abc import Iterator

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from scipy.sparse.csgraph import connected_components

from fenics_rom.fem.mesh_arrays import MeshArrays
from fenics_rom.fem.mesh_quality import CELL_FACES, Faces, triangle_keys

FEW_CELLS = 5  # missing together; one face each to the next leaves a hole of two triangles more for each


def describe_gaps(mesh: MeshArrays, points: Array, cells: Array, faces: Faces) -> Iterator[str]:
    """What to say of a mesh of which cells may be missing.

    Args:
        mesh: what the file holds.
        points: of it, (N, 3), m.
        cells: of it, (C, 4), each once.
        faces: of these cells.
    """
    is_used = np.zeros(len(points), dtype=bool)
    is_used[cells] = True
    is_used[mesh.edges] = True
    unused = np.flatnonzero(~is_used)
    if len(unused):
        yield (
            f"{len(unused)} of {len(points)} nodes belong to no cell, e.g. the one at {_place(points[unused[0]])}: "
            "they are left out; in a file that was cut, their cells are missing"
        )
    of_cells = triangle_keys(cells[:, CELL_FACES].reshape(-1, 3), len(points))
    for name, triangles in mesh.surfaces.items():
        is_stray = ~np.isin(triangle_keys(triangles, len(points)), of_cells)
        if is_stray.any() and not is_stray.all():  # all of them: a surface of something else
            at = points[triangles[is_stray][0]].mean(axis=0)
            yield (
                f"surface {name!r}: {is_stray.sum()} of its {len(triangles)} triangles are no faces of cells, e.g. the "
                f"one around {_place(at)}: cells are missing there, or the surface is of another mesh"
            )
    label, volume, count = closed_surfaces(points, faces)
    holes = np.flatnonzero((volume < 0) & (count <= 2 * FEW_CELLS + 2))
    if len(holes):
        hole = holes[0]
        at = _place(points[faces.outside[label == hole]].mean(axis=(0, 1)))
        yield (
            f"{len(holes)} holes inside the body are as small as a few cells, e.g. one of {-volume[hole]:.3g} m³, of "
            f"{count[hole]} triangles, around {at}: unless they are cavities, cells are missing in the file"
        )
    ends, shares, _ = _edges_of_surface(points, faces)
    pinched = ends[shares > 2]
    if len(pinched):
        at = _place(points[pinched[0]].mean(axis=0))
        yield (
            f"{len(pinched)} edges of the surface are between more than two triangles, e.g. the one around {at}: cells "
            "meet there along the edge alone, as where cells are missing"
        )


def _edges_of_surface(points: Array, faces: Faces) -> tuple[Array, Array, Array]:
    """Ends (E, 2) of the edges of the surface, how many triangles each has (E,), and the first two of them (E, 2)."""
    ends = np.sort(faces.outside[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = ends @ np.array([len(points), 1])
    order = np.argsort(keys, kind="stable")
    _, first, shares = np.unique(keys[order], return_index=True, return_counts=True)
    second = np.minimum(first + 1, len(order) - 1)
    return ends[order[first]], shares, np.stack([order[first], order[second]], axis=1) // 3


def closed_surfaces(points: Array, faces: Faces) -> tuple[Array, Array, Array]:
    """Pieces of the surface that hang together by edges of two triangles, so that a hole on an edge is one by itself.

    Returns:
        The piece (F,) of each triangle; the volume (P,) that each encloses, m³, negative of a cavity; and the number of
        its triangles (P,). A piece that is not closed by itself has volume 0.
    """
    triangles = faces.outside
    _, shares, sides = _edges_of_surface(points, faces)
    one, other = sides[shares == 2].T
    graph = scipy.sparse.coo_array((np.ones(len(one)), (one, other)), shape=2 * (len(triangles),))
    pieces, label = connected_components(graph, directed=False)
    corners = points[triangles] - points[triangles].mean(axis=(0, 1))
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    within = np.linalg.det(corners) / 6

    def summed(values: Array) -> Array:
        return np.bincount(label, weights=values, minlength=pieces)

    open_area = np.linalg.norm([summed(area[:, axis]) for axis in range(3)], axis=0)
    is_closed = open_area <= 1e-9 * summed(np.linalg.norm(area, axis=1))
    return label, np.where(is_closed, summed(within), 0.0), np.bincount(label, minlength=pieces)


def _place(point: Array) -> list[float]:
    return [float(x) for x in point.round(6)]
