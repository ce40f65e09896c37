"""SciPy and NumPy matrices as the reduction sees them, on one process."""

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from fenics_rom.errors import SolverError
from fenics_rom.system.protocols import DENSE_SHARE, EXACT, NO_DOFS, USUAL_COLUMNS, Value


class MatrixFactor:
    """Factor of a symmetric matrix, kept: real ones must be positive definite, complex ones only regular."""

    notice = ""

    def __init__(self, matrix: Any):
        self._solve: Callable[[Array], Array]
        is_complex = np.issubdtype(matrix.dtype, np.complexfloating)
        try:
            self._solve = _complex_solution(matrix) if is_complex else _definite_solution(matrix)
        except (RuntimeError, np.linalg.LinAlgError) as error:  # singular, or a pivot that is not positive
            lack = "singular" if is_complex else "not positive definite"
            raise SolverError(f"a matrix of {matrix.shape[0]} unknowns could not be factored: {lack}") from error
        self._numbers = complex if is_complex else float

    def solve(self, block: Array, accuracy: float = EXACT) -> Array:
        """Solution for a block of right-hand sides (n, k), complex where the matrix or the block is."""
        if np.iscomplexobj(block) and self._numbers is float:
            return self.solve(block.real) + 1j * self.solve(block.imag)
        return self._solve(np.ascontiguousarray(block, dtype=self._numbers))

    def close(self) -> None:
        """Nothing to give back."""


def _definite_solution(matrix: Any) -> Callable[[Array], Array]:
    """Solves with a real matrix, by Cholesky where it is dense, by SuperLU where it is sparse."""
    if not scipy.sparse.issparse(matrix):
        cholesky = scipy.linalg.cho_factor(matrix)
        return lambda block: scipy.linalg.cho_solve(cholesky, block)
    # No pivoting, and an ordering for AᵀA's pattern: then the pivots' signs are those of the eigenvalues.
    factor = _symmetric_superlu(matrix, pivoting=0.0)
    if not (factor.U.diagonal() > 0).all():
        raise np.linalg.LinAlgError("a pivot that is not positive")
    return factor.solve


def _complex_solution(matrix: Any) -> Callable[[Array], Array]:
    """Solves with a complex matrix, by LU with pivoting: its pivots have no signs that could vouch for stability."""
    if scipy.sparse.issparse(matrix):
        return _symmetric_superlu(matrix, pivoting=0.1).solve
    lu, pivots, zero_pivot = scipy.linalg.lapack.zgetrf(matrix)  # lu_factor would only warn of a zero pivot
    if zero_pivot:
        raise np.linalg.LinAlgError(f"pivot {zero_pivot} is zero")
    return lambda block: scipy.linalg.lapack.zgetrs(lu, pivots, block)[0]


def _symmetric_superlu(matrix: Any, pivoting: float) -> Any:
    """Sparse LU of a symmetric pattern; the diagonal is left for pivots that are more than 1/pivoting times it."""
    options = {"SymmetricMode": True, "DiagPivotThresh": pivoting}
    return scipy.sparse.linalg.splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options=options)


class MatrixAlgebra:
    """Sums, solves and eigenpairs of SciPy and NumPy matrices."""

    def __init__(self, size: int):
        self._size = size

    def rows(self) -> slice:
        """All of them."""
        return slice(0, self._size)

    def row_offset(self, count: int) -> int:
        """Nothing is before them."""
        return 0

    def inner(self, left: Array, right: Array) -> Array:
        """Left transposed times right."""
        return left.T @ right

    def gather(self, block: Array) -> Array:
        """The block itself."""
        return block

    def broadcast(self, compute: Callable[[], Value]) -> Value:
        """What is computed."""
        return compute()

    def maximum(self, values: ArrayLike) -> Array:
        """The values themselves."""
        return np.asarray(values)

    def total(self, values: ArrayLike) -> Array:
        """The values themselves."""
        return np.asarray(values)

    def factor(
        self,
        *terms: tuple[complex, Any],
        solver: str = "auto",
        fixed_dofs: Array = NO_DOFS,
        columns: int = USUAL_COLUMNS,
    ) -> MatrixFactor:
        """Factorisation of a sum of coefficient times matrix, `fixed_dofs` held; complex as soon as one coefficient is.

        Raises:
            SolverError: it could not be done, or an iterative solver was asked for.
        """
        if solver == "iterative":
            raise SolverError("solver = 'iterative' goes with PETSc matrices; SciPy and NumPy ones are factored")
        (first, start), *others = [(c, matrix) for c, matrix in terms if c != 0.0]
        total = first * start
        for coefficient, matrix in others:
            total = total + coefficient * matrix
        return MatrixFactor(with_fixed_dofs(total, fixed_dofs))

    def eigenpairs(
        self, mass: Any, stiffness: Any, count: int, factor: MatrixFactor | None = None
    ) -> tuple[Array, Array]:
        """The lowest γ of K v = γ M v, ascending, and M-orthonormal v; a kept factor of K saves another one.

        Raises:
            SolverError: not enough pairs converged.
        """
        if DENSE_SHARE * count > self._size:
            identity = np.eye(self._size)
            γ, V = scipy.linalg.eigh(stiffness @ identity, mass @ identity)
            return γ[:count], V[:, :count]
        inverse = None
        if factor is not None:
            single = scipy.sparse.linalg.LinearOperator
            inverse = single((self._size,) * 2, lambda column: factor.solve(column.reshape(-1, 1))[:, 0])
        try:
            γ, V = scipy.sparse.linalg.eigsh(stiffness, count, mass, sigma=0.0, OPinv=inverse)
        except (scipy.sparse.linalg.ArpackError, RuntimeError) as error:
            raise SolverError(f"ARPACK could not find {count} eigenpairs: {error}") from error
        order = np.argsort(γ)
        return γ[order], V[:, order]


def with_fixed_dofs(matrix: Any, fixed_dofs: Array) -> Any:
    """The matrix with some degrees of freedom held: their rows and columns zero but for the diagonal."""
    if not len(fixed_dofs):
        return matrix
    moves = np.ones(matrix.shape[0])
    moves[fixed_dofs] = 0.0
    diagonal = matrix.diagonal() * (1 - moves)
    if scipy.sparse.issparse(matrix):
        mask = scipy.sparse.diags(moves)
        return mask @ matrix @ mask + scipy.sparse.diags(diagonal)
    return moves[:, None] * matrix * moves + np.diag(diagonal)
