"""The full-order model: M, D, K and the input matrices, whoever assembled them.

The reduction sees a system only through M @ X, D @ X, K @ X, solves, Xᵀ Y summed over the ranks, and eigenpairs.
Blocks of vectors are NumPy arrays that hold the rows of this rank; the rows of the ranks follow one another.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fenics_rom.errors import StructureError
from fenics_rom.scene import Scene

Array = np.ndarray
PROPORTIONAL = 1e-12  # share of D that may be neither M nor K where it counts as α M + β K


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


@dataclass(frozen=True, init=False)
class System:
    """M v̇ + D v + K x = B_i u_i, dx/dt = v, y = Cᵀ x.

    `assemble` makes one from a scene. Anyone's SciPy or NumPy matrices make one, too:

        System(mass=M, damping=D, stiffness=K, contacts={"tip": B}, outputs={"tip": C})

    Attributes:
        mass, damping, stiffness: symmetric; M and K positive definite, D positive semi-definite. kg, N s/m, N/m.
        contacts: contact columns of each contact mode, (rows here, columns).
        actuators: columns of each actuator, which every contact mode has after its own, (rows here, columns).
        outputs: C of each named output, (rows here, 3 points); any number of columns where there is no mesh.
        algebra: solves, sums and eigenpairs for these matrices.
        rayleigh: (α, β) where D = α M + β K, else None.
        body: nodes and surface; without nodes where there is no mesh.
        scene: the scene it was assembled from, if it was.
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
    scene: Scene | None
    warnings: tuple[str, ...]

    def __init__(
        self,
        *,
        mass: Any,
        damping: Any,
        stiffness: Any,
        contacts: Mapping[str, Any],
        actuators: Mapping[str, Any] | None = None,
        outputs: Mapping[str, Any] | None = None,
        algebra: Algebra | None = None,
        rayleigh: tuple[float, float] | None = None,
        body: Body | None = None,
        scene: Scene | None = None,
        warnings: tuple[str, ...] = (),
    ):
        """Takes what `assemble` has put together as it is (then `algebra` is given), and checks anything else.

        Raises:
            StructureError: matrices or columns that do not fit or lack structure, with the measured number.
        """
        if algebra is None:
            from fenics_rom.reduction.matrix_algebra import MatrixAlgebra, checked_columns, checked_matrix

            mass = checked_matrix(mass, "mass", None, definite=True)
            size = mass.shape[0]
            stiffness = checked_matrix(stiffness, "stiffness", size, definite=True)
            damping = checked_matrix(damping, "damping", size, definite=False)
            algebra = MatrixAlgebra(size)
            contacts = checked_columns(contacts, "contacts", size)
            actuators = checked_columns(actuators or {}, "actuators", size)
            outputs = checked_columns(outputs or {}, "outputs", size)
            rayleigh = rayleigh or _rayleigh(mass, damping, stiffness, size)
            body = body or Body(np.empty((0, 3)), np.empty((0, 3), dtype=int), np.arange(size), np.empty(0))
        if not contacts:
            raise StructureError("contacts: at least one contact mode is needed")
        given = locals()
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, given[name])

    @property
    def size(self) -> int:
        """Number n of free displacement degrees of freedom."""
        return len(self.body.free)

    def input_matrix(self, contact: str) -> Array:
        """B_i: the contact columns, then the actuator columns, (rows here, p_i)."""
        return np.hstack([self.contacts[contact], *self.actuators.values()])


def _rayleigh(M: Any, D: Any, K: Any, size: int) -> tuple[float, float] | None:
    """(α, β) of D = α M + β K, or None where D is anything else; told by products with a few vectors."""
    probes = np.random.default_rng(0).standard_normal((size, 4))
    Mz, Dz, Kz = M @ probes, D @ probes, K @ probes
    columns = np.stack([Mz.ravel() / np.linalg.norm(Mz), Kz.ravel() / np.linalg.norm(Kz)], axis=1)
    weights, *_ = np.linalg.lstsq(columns, Dz.ravel(), rcond=None)
    if np.linalg.norm(columns @ weights - Dz.ravel()) > PROPORTIONAL * np.linalg.norm(Dz):
        return None
    α, β = weights[0] / np.linalg.norm(Mz), weights[1] / np.linalg.norm(Kz)
    return (float(max(α, 0.0)), float(max(β, 0.0)))
