"""The motions of a mesh that strain nothing and leave clamped nodes where they are."""

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from fenics_rom.fem.nodes import Nodes
from fenics_rom.system.body import Unknowns
from fenics_rom.system.rigid_modes import rigid_fields

FIXED_TOLERANCE = 1e-9  # share of how held components would move, above which a motion is refused, and not by round-off


def rigid_motions(nodes: Nodes, node_mass: np.ndarray, unknowns: Unknowns) -> np.ndarray:
    """Rigid motions of each connected part of the mesh, on the unknowns, (n, ρ).

    Of the three translations and the three rotations about the part's centre of mass those combinations that the
    supports allow: all six where nothing is clamped, one rotation where a line is, none where the part is held.
    `node_mass` (N,) in kg.
    """
    count, part = _parts(nodes)
    columns = [np.empty((3 * len(part), 0))]
    for number in range(count):
        part_nodes = np.flatnonzero(part == number)
        fields = rigid_fields(nodes.coordinates[part_nodes], node_mass[part_nodes])
        motions = np.zeros((len(part), 3, 6))
        motions[part_nodes] = fields.reshape(-1, 3, 6)
        motions = motions.reshape(-1, 6)
        held = np.setdiff1d((3 * part_nodes[:, None] + np.arange(3)).ravel(), unknowns.free)
        refused = motions[held] - unknowns.expand(motions[unknowns.free])[held]
        if len(refused):  # by rigid surfaces none are: all of it is round-off
            _, sizes, combinations = np.linalg.svd(np.linalg.qr(refused, mode="r"))
            count_refused = np.count_nonzero(sizes > FIXED_TOLERANCE * np.linalg.norm(motions[held]))
            motions = motions @ combinations[count_refused:].T
        columns.append(motions)
    return np.hstack(columns)[unknowns.free]


def _parts(nodes: Nodes) -> tuple[int, np.ndarray]:
    """Number of connected parts, and that of each node, (N,)."""
    cells, vertices = nodes.cells, int(nodes.cells.max()) + 1
    start, end = np.repeat(cells[:, 0], cells.shape[1] - 1), cells[:, 1:].ravel()
    graph = scipy.sparse.coo_array((np.ones(len(start)), (start, end)), shape=(vertices, vertices))
    count, part = connected_components(graph, directed=False)
    node_part = np.empty(len(nodes.coordinates), dtype=int)
    node_part[nodes.cell_nodes] = part[cells[:, :1]]
    return count, node_part
