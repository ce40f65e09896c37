"""What the reduction asks of a backend: products, solves, eigenpairs and sums over the ranks.

Blocks of vectors are NumPy arrays that hold the rows of this rank; the rows of the ranks follow one another.
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.slack import Push

Value = TypeVar("Value")
NO_DOFS = np.empty(0, dtype=int)
USUAL_COLUMNS = 250  # of a reduction of two contact modes
EXACT = 1e-14  # of iterations, as of residuals that they leave: solutions are as good as a factor's then
DENSE_SHARE = 3  # beyond a third of all eigenpairs, LAPACK on whole matrices is the better eigensolver


class Operator(Protocol):
    """A symmetric n × n matrix."""

    def __matmul__(self, block: Array) -> Array:
        """Product with a real or complex block, (rows here, k) to (rows here, k)."""


class Factor(Protocol):
    """Solves with a symmetric matrix, again and again: a kept factorisation, or an iterative solver.

    Attributes:
        notice: what the user should know of how it solves; empty where there is nothing to say.
    """

    notice: str

    def solve(self, block: Array, accuracy: float = EXACT) -> Array:
        """Solution for a real or complex block of right-hand sides, (rows here, k) to (rows here, k).

        An iterative solver may leave `accuracy` of the energy of a solution; a factor gives it whole.
        """

    def close(self) -> None:
        """Gives the memory back."""


class Algebra(Protocol):
    """What the ranks do together."""

    def rows(self) -> slice:
        """Which rows are held here."""

    def row_offset(self, count: int) -> int:
        """Number of rows on the ranks before this one, of a block with `count` rows here."""

    def inner(self, left: Array, right: Array) -> Array:
        """leftᵀ right, summed over the ranks; the same bits on every rank."""

    def gather(self, block: Array) -> Array:
        """All rows of a block, on every rank."""

    def broadcast(self, compute: Callable[[], Value]) -> Value:
        """What the first rank computes, or raises; the same bits on every rank."""

    def maximum(self, values: ArrayLike) -> Array:
        """The largest of each entry over the ranks, on every rank."""

    def total(self, values: ArrayLike) -> Array:
        """Sum of each entry over the ranks, on every rank."""

    def factor(
        self,
        *terms: tuple[complex, Any],
        solver: str = "auto",
        fixed_dofs: Array = NO_DOFS,
        columns: int = USUAL_COLUMNS,
    ) -> Factor:
        """Factorisation of a sum of coefficient times operator; complex as soon as one coefficient is.

        The degrees of freedom `fixed_dofs` are held where they are; only with real coefficients. How many `columns`
        will be solved for, about, helps to choose the solver.
        """

    def eigenpairs(self, mass: Any, stiffness: Any, count: int, factor: Any = None) -> tuple[Array, Array]:
        """The lowest eigenvalues γ (count,) of K v = γ M v, and M-orthonormal eigenvectors (rows here, count).

        A kept `factor` of K saves another one.
        """


class Deformation(Protocol):
    """How a full-order body deforms largely: a potential ∫ W(E) in place of ½ xᵀ K x, and what steps it.

    Attributes:
        law: of the material, as `hyperelastic` has them.
        weights: volumes that the quadrature points of this rank stand for, (P here,), m³.
        first_lame, shear: λ and μ there, (P here,), Pa.
        material: of all that: a law, λ and μ, and fibres.
        viscosity: β there, (P here,), s: of the stress β (2μ Ė + λ (C⁻¹:Ė) C⁻¹); see `mechanics.point_material`.
        spring: K_s of springs to ground, N/m; None: no springs, or a moving frame has them.
        external_damping: D_c, damping that does not strain: α M and dashpots, N s/m, these unless a moving frame has
            them; None: nothing.
    """

    law: str
    weights: Array
    first_lame: Array
    shear: Array
    material: PointMaterial
    viscosity: Array
    spring: Operator | None
    external_damping: Operator | None

    @property
    def tendons(self) -> Mapping[str, tuple[Array, Array]]:
        """Points (K, 3), m, and shapes (rows here, 3K): the moved points are points + (shapesᵀ x).reshape(K, 3)."""

    @property
    def bars(self) -> Mapping[str, tuple[Array, Array]]:
        """The same of the two ends of each rigid bar."""

    @property
    def rims(self) -> Mapping[str, tuple[Array, Array, Array, Array]]:
        """Of pressures points and pieces of the surface's edge, (G, 3) each, m, and their shapes (rows here, 3G)."""

    def gradients(self, columns: Array) -> Array:
        """Displacement gradients [i, j] = ∂u_i/∂X_j of columns (rows here, k) at the points, (3, 3, P here, k)."""

    def force(self, x: Array) -> Array:
        """∂/∂x of ∫ W(E), (rows here,), N, at a displacement (rows here,), m."""

    def stepper(self, dt: float, environment: Any = None, *, ledger: bool = True, system: Any = None) -> Any:
        """What steps the body at full order from rest, see mechanics.step.

        Under the inputs of a system; where None those of the one that it was made of.
        """

    def stepper_in_frame(self, dt: float, environment: Any, *, ledger: bool = True, system: Any = None) -> Any:
        """The same of a body whose frame moves, and loads turn with it."""

    def follower(self, x: Array) -> dict[str, Array]:
        """Force (rows here, 1) of 1 Pa or 1 N of each pressure and tendon at a displacement (rows here,), m."""


class Embedded(Protocol):
    """Membranes and cables of a body, which push where it presses them."""

    def pushes(self, displacement: Array, time: float) -> Mapping[str, Push]:
        """How hard each pushes where nodes are displaced by (N, 3), m, at a time, s, by name; of those that do."""
