"""Matrices that do the same to each axis, such as a mass: A ⊗ I₃, of a matrix A of nodes, which is a ninth of them."""

from typing import Any

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.fem.ranked_blocks import RankedBlocks


class NodalMatrix(PetscMatrix):
    """A ⊗ I₃ whose products with many columns are those of A, to round-off."""

    def __init__(self, mat: PETSc.Mat, of_nodes: RankedBlocks):
        super().__init__(mat)
        self._of_nodes = of_nodes

    def __matmul__(self, block: Array) -> Array:
        """Product with local rows (rows here, k)."""
        if block.shape[1] == 1:  # as steps have it
            return super().__matmul__(block)
        product = self._of_nodes.times(np.ascontiguousarray(block).reshape(self._of_nodes.rows, -1))
        return product.reshape(block.shape)


def by_nodes(matrix: PetscMatrix) -> PetscMatrix:
    """The same matrix, as a NodalMatrix if it is one to the last bit; every rank must call it."""
    mat = matrix.mat
    start, columns, values = mat.getValuesCSR()
    (here, _), (_, size) = mat.getSizes()
    is_whole = not (here % 3 or size % 3)
    of_nodes: Any = None
    if is_whole:
        A = scipy.sparse.csr_matrix((values, columns, start), shape=(here, size))
        of_nodes = A[::3, ::3]
        is_whole = (scipy.sparse.kron(of_nodes, scipy.sparse.identity(3)) - A).count_nonzero() == 0
    comm = mat.comm.tompi4py()
    if not comm.allreduce(is_whole, min):
        return matrix
    first, own = mat.getOwnershipRangeColumn()[0] // 3, here // 3
    return NodalMatrix(mat, RankedBlocks(comm, of_nodes, (first, own), 1))
