"""Where the degrees of freedom of a model are."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fenics_rom.system.protocols import Array


@dataclass(frozen=True)
class Body:
    """Where the degrees of freedom are: canonical nodes, the same on every rank.

    Attributes:
        nodes: (N, 3), m.
        triangles: (F, 3), outward surface triangles between nodes.
        free: (n,), which of the 3 N displacement components are free, ascending.
        node_mass: (N,), kg; the diagonal of M scaled to the mass of the body (Hinton, Rock & Zienkiewicz 1976).
        contact_surfaces: nodes (any,) of the surface of each contact mode.
    """

    nodes: Array
    triangles: Array
    free: Array
    node_mass: Array
    contact_surfaces: Mapping[str, Array] = field(default_factory=dict)


def body_without_mesh(size: int) -> Body:
    """The body of a model of matrices alone, all of whose unknowns are free."""
    return Body(np.empty((0, 3)), np.empty((0, 3), dtype=int), np.arange(size), np.empty(0))
