"""PETSc matrices as the reduction sees them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.system.columns import apply_to_complex, sum_of

CHUNK = 128  # columns that PETSc gets at a time: as fast as all of them, and their copies stay small


class PetscMatrix:
    """A symmetric sparse matrix with its rows spread over the ranks."""

    def __init__(self, mat: PETSc.Mat):
        self.mat = mat
        self.size = mat.getSize()[0]
        self.local = mat.getLocalSize()[0]
        self._vectors = mat.createVecs()

    def __matmul__(self, block: np.ndarray) -> np.ndarray:
        """Product with local rows (rows here, k)."""
        if np.iscomplexobj(block):
            return apply_to_complex(self.__matmul__, block)
        if block.shape[1] == 1:
            return self.apply_to_column(self.mat.mult, block)
        result = np.empty(block.shape)
        for part in column_chunks(block):
            with dense_block(self, block[:, part]) as x:
                y = self.mat.matMult(x)
                result[:, part] = y.getDenseArray()
                y.destroy()
        return result

    def apply_to_column(self, operation: Callable[[PETSc.Vec, PETSc.Vec], None], column: np.ndarray) -> np.ndarray:
        """Result of `operation(x, y)` for one column, in vectors that are kept: this is what a time step does."""
        x, y = self._vectors
        x.array[:] = column[:, 0]
        operation(x, y)
        return y.array[:, None].copy()

    def destroy(self) -> None:
        """Frees the matrix."""
        for part in (*self._vectors, self.mat):
            part.destroy()


class MatrixSum:
    """Sum of coefficient times matrix, such as α M + β K, whose numbers are made only where somebody asks for them."""

    def __init__(self, *terms: tuple[float, PetscMatrix]):
        self.terms = terms

    def __matmul__(self, block: np.ndarray) -> np.ndarray:
        """Product with local rows (rows here, k)."""
        return sum_of(coefficient * (matrix @ block) for coefficient, matrix in self.terms)

    @cached_property
    def mat(self) -> PETSc.Mat:
        """It all in one."""
        return combination(*self.terms)


class ExtendedMatrix:
    """Products in `numpy.longdouble` (64 bits of mantissa on x86, 113 on ARM), where a row's terms cancel."""

    def __init__(self, mat: PETSc.Mat):
        start, columns, values = mat.getValuesCSR()
        shape = (mat.getLocalSize()[0], mat.getSize()[1])
        self._rows = scipy.sparse.csr_matrix((values.astype(np.longdouble), columns, start), shape=shape)
        self._comm = mat.comm.tompi4py()

    def __matmul__(self, column: np.ndarray) -> np.ndarray:
        """Product with local rows (rows here, 1), rounded to double."""
        x = np.concatenate(self._comm.allgather(column)).astype(np.longdouble)
        return np.asarray(self._rows @ x, dtype=float)


class ZeroMatrix:
    """A matrix of zeros (the damping of an undamped body): nothing is stored."""

    def __matmul__(self, block: np.ndarray) -> np.ndarray:
        """Zeros, (rows here, k)."""
        return np.zeros_like(block)


@contextmanager
def dense_block(like: PetscMatrix, block: np.ndarray) -> Iterator[PETSc.Mat]:
    """A block of local rows as a PETSc matrix, for as long as a call needs it."""
    data = np.array(block, dtype=float, order="F")  # PETSc takes no copy, so this one must live as long
    mat = PETSc.Mat().createDense(((like.local, like.size), (None, block.shape[1])), array=data, comm=like.mat.comm)
    mat.setUp()  # without it PETSc 3.18 crashes
    mat.assemble()
    try:
        yield mat
    finally:
        mat.destroy()


def from_local_rows(rows: scipy.sparse.csr_matrix, comm: PETSc.Comm) -> PETSc.Mat:
    """The square matrix of which each rank has some rows (rows here, n)."""
    local, size = rows.shape
    csr = (rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data)
    return PETSc.Mat().createAIJ(((local, size), (local, size)), csr=csr, comm=comm)


def column_chunks(block: np.ndarray) -> list[slice]:
    """The columns of a block, some at a time."""
    return [slice(first, first + CHUNK) for first in range(0, block.shape[1], CHUNK)]


def combination(*terms: tuple[float, Any]) -> PETSc.Mat:
    """Sum of coefficient times PETSc matrix; it knows the near-nullspace that one of them knows."""
    coefficients: dict[PetscMatrix, float] = {}
    for c, term in terms:
        if not isinstance(term, PetscMatrix | MatrixSum | ZeroMatrix):
            raise SolverError(f"a sum of PETSc matrices was asked for with a {type(term).__name__} in it")
        parts = term.terms if isinstance(term, MatrixSum) else [(1.0, term)] if isinstance(term, PetscMatrix) else ()
        for share, matrix in parts:
            coefficients[matrix] = coefficients.get(matrix, 0.0) + c * share
    matrices = [(c, matrix.mat) for matrix, c in coefficients.items()]
    if not matrices:
        raise SolverError("a sum of PETSc matrices was asked for without one")
    (first_coefficient, first), *others = [(c, mat) for c, mat in matrices if c != 0.0] or matrices[:1]
    total = first.copy()
    total.scale(first_coefficient)
    for coefficient, mat in others:
        total.axpy(coefficient, mat, structure=PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
    for _, mat in matrices:
        near = mat.getNearNullSpace()
        if near:
            total.setNearNullSpace(near)
        near.destroy()
    return total


def fix_dofs(mat: PETSc.Mat, fixed_dofs: np.ndarray) -> PETSc.Mat:
    """The matrix itself, with some degrees of freedom fixed: their rows and columns zero but for the diagonal."""
    if len(fixed_dofs):
        diagonal = mat.getDiagonal()
        mean = diagonal.sum() / diagonal.getSize()
        diagonal.destroy()
        start, stop = mat.getOwnershipRange()
        mat.zeroRowsColumns(fixed_dofs[(start <= fixed_dofs) & (fixed_dofs < stop)].astype(PETSc.IntType), diag=mean)
    return mat
