"""The symmetric positive definite matrix that stands for a step's consistent tangent where it is solved with.

It is that tangent at the start of the step, made definite: with the moduli of small strains and without the stresses.

    A = a M + b D_c + c K_s + ∫ (c + d β) ∇δ : C : ∇v   in the frame of the deformed body.

A Krylov method makes up for the rest; contact needs W = S A⁻¹ Sᵀ to be symmetric.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_rom.fem.finite_strain.quadrature import Points
from fenics_rom.fem.finite_strain.stresses import UNIT, Material
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.mechanics.hyperelastic import VOIGT_PAIRS, VOIGT_SHEAR

Array = np.ndarray
AT_ONCE = 4096  # cells


@dataclass(frozen=True)
class Weights:
    """Coefficients: `mass` a, 1/s; `external_damping` b; `stiffness` c, s; `viscosity` d."""

    mass: float
    external_damping: float
    stiffness: float
    viscosity: float


class StepMatrix:
    """Assembles it, again and again in the same pattern.

    Args:
        points: of the cells of this rank.
        material: theirs.
        free: (n,) free displacement components; either all or none of a node.
        rows: of this rank among them.
        constant: M, D_c and K_s; None: zero.
    """

    def __init__(
        self,
        points: Points,
        material: Material,
        free: Array,
        rows: slice,
        constant: tuple[PetscMatrix, PetscMatrix | None, PetscMatrix | None],
    ):
        self._points, self._material, self._constant = points, material, constant
        self._free, self._rows, self._comm = free, rows, constant[0].mat.comm
        number = np.full(points.count, -1)  # of a free node
        number[free[::3] // 3] = np.arange(len(free) // 3)
        of_cells = number[points.of_cells]
        row, column = np.broadcast_arrays(of_cells[:, :, None], of_cells[:, None, :])
        self._both_free = (row >= 0) & (column >= 0)
        count, row, column = len(free) // 3, row[self._both_free], column[self._both_free]
        pairs, slots = np.unique(row * count + column, return_inverse=True)
        blocks = np.ones(len(slots)), (slots.ravel(), np.arange(len(slots)))
        self._sums = scipy.sparse.csr_matrix(blocks, shape=(len(pairs), len(slots)))
        self._columns, self._starts = pairs % count, np.searchsorted(pairs, count * np.arange(count + 1))

    def assembled(self, H: Array, weights: Weights) -> PETSc.Mat:
        """The matrix at displacement gradients (3, 3, P here); every rank must call it."""
        m, (C, Q, A, _) = self._material, self._points.shape_gradients.shape
        D = self._points.weights * (weights.stiffness + weights.viscosity * m.viscosity) * m.linear_moduli
        F, blocks = UNIT + H, np.empty((C, A, A, 3, 3))
        for first in range(0, C, AT_ONCE):
            cells, at = slice(first, first + AT_ONCE), slice(first * Q, (first + AT_ONCE) * Q)
            blocks[cells] = _blocks(self._points.shape_gradients[cells], F[:, :, at], D[:, :, at])
        sums = (self._sums @ blocks[self._both_free].reshape(-1, 9)).reshape(-1, 3, 3)
        total = scipy.sparse.bsr_matrix((sums, self._columns, self._starts), shape=2 * (len(self._free),)).tocsr()
        return self._with_constants(self._exchanged(total), weights)

    def _exchanged(self, total: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """The rows of this rank (rows here, n), of all ranks' parts."""
        comm = self._comm.tompi4py()
        if comm.size == 1:
            return total
        rows = comm.allgather(self._rows)
        return sum(comm.alltoall([total[there] for there in rows]))

    def _with_constants(self, here: scipy.sparse.csr_matrix, weights: Weights) -> PETSc.Mat:
        here.sort_indices()
        local, size = here.shape
        csr = (here.indptr.astype(PETSc.IntType), here.indices.astype(PETSc.IntType), here.data)
        matrix = PETSc.Mat().createAIJ(((local, size), (local, size)), csr=csr, comm=self._comm)
        coefficients = weights.mass, weights.external_damping, weights.stiffness
        for coefficient, term in zip(coefficients, self._constant, strict=True):
            if term is not None and coefficient:
                matrix.axpy(coefficient, term.mat, structure=PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
        return matrix


def _blocks(shape_gradients: Array, F: Array, D: Array) -> Array:
    """Blocks (C, A, A, 3, 3) of each cell from shape functions' gradients (C, Q, A, 3), F and weighted moduli D."""
    C, Q, A, _ = shape_gradients.shape
    F, D = (values.reshape(*values.shape[:2], C, Q).transpose(2, 3, 0, 1) for values in (F, D))
    both = np.einsum("cqki,cqaj->cqijak", F, shape_gradients)  # F_ki ∂N_a/∂X_j
    i, j = VOIGT_PAIRS.T
    rates = (both[:, :, i, j] + both[:, :, j, i]) * (VOIGT_SHEAR / 2)[:, :, None]  # ∂E/∂(a, k)
    rates = rates.reshape(C, Q, 6, 3 * A)
    stressed = (D @ rates).reshape(C, 6 * Q, 3 * A)
    K = rates.reshape(C, 6 * Q, 3 * A).transpose(0, 2, 1) @ stressed
    return K.reshape(C, A, 3, A, 3).transpose(0, 1, 3, 2, 4)
