"""Matrix-vector products in extended precision, where the terms of a row cancel by more than double can spare."""

import numpy as np
import scipy.sparse
from petsc4py import PETSc


class ExtendedMatrix:
    """A copy of a PETSc matrix's local rows in `numpy.longdouble` (64 bits of mantissa on x86, 113 on ARM)."""

    def __init__(self, mat: PETSc.Mat):
        start, columns, values = mat.getValuesCSR()
        shape = (mat.getLocalSize()[0], mat.getSize()[1])
        self._rows = scipy.sparse.csr_matrix((values.astype(np.longdouble), columns, start), shape=shape)
        self._comm = mat.comm.tompi4py()

    def __matmul__(self, column: np.ndarray) -> np.ndarray:
        """Product with local rows (rows here, 1), rounded to double."""
        x = np.concatenate(self._comm.allgather(column)).astype(np.longdouble)
        return np.asarray(self._rows @ x, dtype=float)
