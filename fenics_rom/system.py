"""The full-order model: M, D, K and the input matrices, whoever assembled them.

The reduction sees a system only through M @ X, D @ X, K @ X, solves, Xᵀ Y summed over the ranks, and eigenpairs.
Blocks of vectors are NumPy arrays that hold the rows of this rank; the rows of the ranks follow one another.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from fenics_rom.scene import Scene

Array = np.ndarray


class Operator(Protocol):
    """A symmetric n × n matrix."""

    def __matmul__(self, block: Array) -> Array:
        """Product with a block, (rows here, k) to (rows here, k)."""


class Factor(Protocol):
    """A kept factorisation of a symmetric positive definite matrix."""

    def solve(self, block: Array) -> Array:
        """Solution for a block of right-hand sides, (rows here, k) to (rows here, k)."""

    def close(self) -> None:
        """Gives the memory back."""


class Algebra(Protocol):
    """What the ranks do together."""

    def inner(self, left: Array, right: Array) -> Array:
        """leftᵀ right, summed over the ranks; the same bits on every rank."""

    def gather(self, block: Array) -> Array:
        """All rows of a block, on every rank."""

    def rows(self) -> slice:
        """Which rows are held here."""

    def factor(self, *terms: tuple[float, Any]) -> Factor:
        """Factorisation of a sum of coefficient times operator."""

    def eigenpairs(self, mass: Any, stiffness: Any, count: int) -> tuple[Array, Array]:
        """The lowest eigenvalues γ (count,) of K v = γ M v, and M-orthonormal eigenvectors (rows here, count)."""


@dataclass(frozen=True)
class Body:
    """Where the degrees of freedom are: canonical nodes, the same on every rank.

    Attributes:
        nodes: (N, 3), m.
        triangles: (F, 3), outward surface triangles between nodes.
        free: (n,), which of the 3 N displacement components are free, ascending.
        node_mass: (N,), kg; the diagonal of M scaled to the mass of the body (Hinton, Rock & Zienkiewicz 1976).
    """

    nodes: Array
    triangles: Array
    free: Array
    node_mass: Array


@dataclass(frozen=True)
class System:
    """M v̇ + D v + K x = B_i u_i, x = v's integral, y = Cᵀ x.

    Attributes:
        mass, damping, stiffness: symmetric; M and K positive definite, D positive semi-definite. kg, N s/m, N/m.
        contacts: contact columns of each contact mode, (rows here, columns).
        actuators: columns of each actuator, which every contact mode has after its own, (rows here, columns).
        outputs: C of each named output, (rows here, 3 points).
        algebra: solves, sums and eigenpairs for these matrices.
        rayleigh: (α, β) where D = α M + β K, else None.
        body: nodes and surface.
        scene: the scene it was assembled from.
        warnings: what the user should know about this model.
    """

    mass: Operator
    damping: Operator
    stiffness: Operator
    contacts: Mapping[str, Array]
    actuators: Mapping[str, Array]
    outputs: Mapping[str, Array]
    algebra: Algebra
    rayleigh: tuple[float, float] | None
    body: Body
    scene: Scene
    warnings: tuple[str, ...] = field(default=())

    @property
    def size(self) -> int:
        """Number n of free displacement degrees of freedom."""
        return len(self.body.free)

    def input_matrix(self, contact: str) -> Array:
        """B_i: the contact columns, then the actuator columns, (rows here, p_i)."""
        return np.hstack([self.contacts[contact], *self.actuators.values()])
