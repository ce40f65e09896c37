"""Where the degrees of freedom of a model are."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.mechanics.body_facts import CellQuality
from fenics_rom.mechanics.contact_points import PointsBetween


@dataclass(frozen=True)
class Unknowns:
    """Which of the displacement components of all nodes are unknowns; supports hold the others, or tie them to these.

    A node on a plane that is oblique to the axes keeps two unknowns, and its third component follows them.

    Attributes:
        components: number of displacement components, 3 N.
        free: (n,) which of them are unknowns, ascending.
        tied: (s,) which of them follow unknowns, ascending.
        weights: (s, n) of the unknowns in the tied components; None where nothing is tied.
    """

    components: int
    free: Array
    tied: Array = field(default_factory=lambda: np.empty(0, dtype=int))
    weights: scipy.sparse.csr_array | None = None

    @cached_property
    def moving(self) -> Array:
        """The components that can move, ascending: unknowns and tied ones."""
        return np.union1d(self.free, self.tied)

    @cached_property
    def node_shares(self) -> scipy.sparse.csr_array | None:
        """z (N, nodes) with Z = z ⊗ I₃, where unknowns are all components of some nodes, and others follow these.

        So M and S of all nodes, m ⊗ I₃, stay such matrices. None: components are held or follow by themselves.
        """
        if len(self.free) % 3 or (self.free.reshape(-1, 3) - self.free[::3, None] != np.arange(3)).any():
            return None
        shares = self.matrix[::3, ::3]
        alike = scipy.sparse.kron(shares, np.eye(3), format="csr")
        return scipy.sparse.csr_array(shares) if abs(alike - self.matrix).max() == 0 else None

    def expand(self, x: Array) -> Array:
        """The displacement of all components (3 N, columns) from unknowns (n, columns)."""
        field = np.zeros((self.components, *x.shape[1:]))
        field[self.free] = x
        if self.weights is not None:
            field[self.tied] = self.weights @ x
        return field

    def restrict(self, forces: Array) -> Array:
        """The forces on unknowns (n, columns) that do the work of forces on all components (3 N, columns)."""
        on_unknowns: Array = forces[self.free]
        if self.weights is not None:
            on_unknowns = on_unknowns + self._shares @ forces[self.tied]
        return on_unknowns

    @cached_property
    def _shares(self) -> scipy.sparse.csr_array:
        """(n, s) of the unknowns in forces on tied components."""
        assert self.weights is not None
        return self.weights.T.tocsr()

    @cached_property
    def matrix(self) -> scipy.sparse.csr_array:
        """Z (3 N, n) of `expand`."""
        n = len(self.free)
        Z = scipy.sparse.coo_array((np.ones(n), (self.free, np.arange(n))), shape=(self.components, n)).tocsr()
        if self.weights is not None:
            s = len(self.tied)
            at = scipy.sparse.coo_array((np.ones(s), (self.tied, np.arange(s))), shape=(self.components, s))
            Z = (Z + at.tocsr() @ self.weights).tocsr()
        return Z


@dataclass(frozen=True)
class Body:
    """Where the degrees of freedom are: canonical nodes, the same on every rank.

    Attributes:
        nodes: (N, 3), m.
        triangles: (F, 3), outward surface triangles between nodes.
        unknowns: which of the 3 N displacement components are unknowns.
        node_mass: (N,), kg; the diagonal of M scaled to the mass of the body (Hinton, Rock & Zienkiewicz 1976).
        contact_surfaces: nodes (any,) of the surface of each contact mode.
        cells: how many there are, and how good; None: nobody knows.
        points_between: that obstacles can touch beside nodes; None where none passes between these.
        weight: (N,), kg, what weighs at each node: ∫ρ of its shape function, and what is fixed to the body; None where
            no scene says.
        surfaces: nodes (any,) of other surfaces that have names, where there is contact: of groups of the mesh, and of
            places of the scene.
    """

    nodes: Array
    triangles: Array
    unknowns: Unknowns
    node_mass: Array
    contact_surfaces: Mapping[str, Array] = field(default_factory=dict)
    cells: CellQuality | None = None
    points_between: PointsBetween | None = None
    weight: Array | None = None
    surfaces: Mapping[str, Array] = field(default_factory=dict)

    @property
    def free(self) -> Array:
        """(n,) which displacement components are unknowns, ascending."""
        return self.unknowns.free


def body_without_mesh(size: int) -> Body:
    """The body of a model of matrices alone, all of whose components are unknowns."""
    return Body(np.empty((0, 3)), np.empty((0, 3), dtype=int), Unknowns(size, np.arange(size)), np.empty(0))
