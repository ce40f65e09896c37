"""What every reader of mesh files gives, before it is checked."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fenics_rom.fem.cell_kinds import TETRAHEDRON, CellKind

NO_EDGES = np.empty((0, 3), dtype=np.int64)


class MeshArrays(NamedTuple):
    """Cells of one kind and groups in the unit of the file, with whatever it has besides."""

    points: np.ndarray  # (N, 3)
    cells: np.ndarray  # (C, V) in the order of their kind, of any orientation, some perhaps several times
    surfaces: Mapping[str, np.ndarray]  # triangles of each named surface, (F, 3) each; quadrilaterals as `halves`
    regions: Mapping[str, np.ndarray]  # cells of each named region, as rows of `cells`
    edges: np.ndarray = NO_EDGES  # (E, 3) of second-order cells: two ends, and the node between
    notes: tuple[str, ...] = ()  # what the user should know
    vectors: Mapping[str, np.ndarray] = MappingProxyType({})  # cell data of three numbers for each of `cells`, (C, 3)
    kind: CellKind = TETRAHEDRON
