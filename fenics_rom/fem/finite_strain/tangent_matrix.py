"""The matrices that a step's linear systems are solved with, of the state that the body is in.

K is the consistent tangent of an equilibrium, with the symmetric part of what follows the body; indefinite beyond a
limit point:

    K = K_s + ∫ F ∇δ : ∂S/∂E : F ∇v + ∇δ S : ∇v - sym ∂force/∂x

A is the tangent of the shape that the body comes to in some steps, made symmetric; where that is not positive definite,
of the shape that it has, with the moduli of small strains and without the stresses.

    A = a M + b D_c + c K_s + ∫ ∇δ : (c C + d β C_v + e C₀) : ∇v   in the frame of the deformed body,

with C_v of viscosity, 2μ + λ C⁻¹ ⊗ C⁻¹, and C₀ of small strains.

Secants and a Krylov method make up for the rest; contact needs W = S A⁻¹ Sᵀ to be symmetric.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.fem.finite_strain.quadrature import QuadraturePoints
from fenics_rom.fem.finite_strain.stresses import IDENTITY, EquilibriumStresses, HyperelasticMaterial, Stresses
from fenics_rom.fem.petsc_matrix import PetscMatrix, combination, from_local_rows
from fenics_rom.mechanics.hyperelastic import strain
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS, VOIGT_SHEAR
from fenics_rom.system.body import Unknowns

CELLS_PER_BATCH = 4096


@dataclass(frozen=True)
class TangentCoefficients:
    """The numbers in A: `mass` a, 1/s; `external_damping` b; `stiffness` c, s; `viscosity` d; `relaxation` e, s."""

    mass: float
    external_damping: float
    stiffness: float
    viscosity: float
    relaxation: float = 0.0


OF_EQUILIBRIUM = TangentCoefficients(mass=0.0, external_damping=0.0, stiffness=1.0, viscosity=0.0)


class TangentMatrix:
    """Assembles A and K, again and again in the same pattern.

    Of the unknowns this rank has `rows`; `constant_terms` are M, D_c and K_s or None.
    """

    def __init__(
        self,
        points: QuadraturePoints,
        material: HyperelasticMaterial,
        unknowns: Unknowns,
        rows: slice,
        constant_terms: tuple[PetscMatrix, PetscMatrix | None, PetscMatrix | None],
    ):
        self._points, self._material, self._constant_terms = points, material, constant_terms
        self._rows, self._comm = rows, constant_terms[0].mat.comm
        self._linear: tuple[TangentCoefficients, PetscMatrix, scipy.sparse.csr_matrix] | None = None
        free_nodes = np.unique(unknowns.moving // 3)
        count = len(free_nodes)
        self._free_components = (3 * free_nodes[:, None] + np.arange(3)).ravel()
        free_number = np.full(points.node_count, -1)
        free_number[free_nodes] = np.arange(count)
        self._size, self._Z = 3 * count, None
        if len(unknowns.free) < self._size:  # some nodes are partly held, or follow others
            self._Z = scipy.sparse.csr_matrix(unknowns.matrix[self._free_components])
        cell_nodes = free_number[points.cell_nodes]
        row, column = np.broadcast_arrays(cell_nodes[:, :, None], cell_nodes[:, None, :])
        self._both_free = (row >= 0) & (column >= 0)
        row, column = row[self._both_free], column[self._both_free]
        pairs, slots = np.unique(row * count + column, return_inverse=True)
        ones = np.ones(len(slots)), (slots.ravel(), np.arange(len(slots)))
        self._sum_cells = scipy.sparse.csr_matrix(ones, shape=(len(pairs), len(slots)))
        self._with_embedded, cells = np.unique(points.embedded_in, return_inverse=True)  # cells
        ones = np.ones(len(cells)), (cells.ravel(), np.arange(len(cells)))
        self._sum_embedded = scipy.sparse.csr_matrix(ones, shape=(len(self._with_embedded), len(cells)))
        self._columns, self._row_starts = pairs % count, np.searchsorted(pairs, count * np.arange(count + 1))

    def linear_part(self, coefficients: TangentCoefficients) -> PetscMatrix:
        """a M + b D_c + c K_s, kept for steps of the same length; every rank must call it."""
        return self._linear_part(coefficients)[0]

    def _linear_part(self, coefficients: TangentCoefficients) -> tuple[PetscMatrix, scipy.sparse.csr_matrix]:
        """The same, and its rows here."""
        if self._linear is None or self._linear[0] != coefficients:
            factors = coefficients.mass, coefficients.external_damping, coefficients.stiffness
            terms = zip(factors, self._constant_terms, strict=True)
            matrix = PetscMatrix(combination(*((factor, term) for factor, term in terms if term is not None)))
            starts, columns, values = matrix.mat.getValuesCSR()
            shape = matrix.local, matrix.size
            self.close()
            self._linear = coefficients, matrix, scipy.sparse.csr_matrix((values, columns, starts), shape=shape)
        return self._linear[1:]

    def close(self) -> None:
        """Gives the memory back."""
        if self._linear is not None:
            self._linear[1].destroy()
            self._linear = None

    def definite(self, H: Array, coefficients: TangentCoefficients) -> PETSc.Mat:
        """A at displacement gradients (3, 3, P here); every rank must call it."""
        D = coefficients.stiffness * self._material.linear_moduli + self._viscous_moduli(strain(H), coefficients)
        return self._assemble(IDENTITY + H, D, coefficients)

    def stressed(
        self, stresses: EquilibriumStresses, coefficients: TangentCoefficients, following: scipy.sparse.csr_matrix
    ) -> PETSc.Mat:
        """A of a state with its moduli and stresses, and the stiffness of what follows (3N, 3N): may be indefinite."""
        c = coefficients
        D = c.stiffness * stresses.moduli + self._viscous_moduli(stresses.E, c)
        return self._assemble(stresses.F, D, c, c.stiffness * stresses.S, c.stiffness * following)

    def _viscous_moduli(self, E: Array, coefficients: TangentCoefficients) -> Array:
        """Of β and of branches, (6, 6, P here), at strains (6, P here)."""
        m, c = self._material, coefficients
        viscous = c.relaxation * m.linear_moduli
        if c.viscosity:
            viscous = viscous + c.viscosity * m.viscosity * m.viscous_slopes(E, np.zeros_like(E))[0]
        return viscous

    def consistent(self, stresses: Stresses, following: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """K where there are these stresses, with the stiffness of what follows (3N, 3N); every rank must call it."""
        return self._assemble(stresses.F, stresses.moduli, OF_EQUILIBRIUM, stresses.S, following)

    def _assemble(
        self,
        F: Array,
        D: Array,
        coefficients: TangentCoefficients,
        S: Array | None = None,
        following: scipy.sparse.csr_matrix | None = None,
    ) -> PETSc.Mat:
        """Of deformation gradients (3, 3, P here), moduli (6, 6, P here), stresses (6, P here) and what follows."""
        (C, Q, A, _), weights = self._points.shape_gradients.shape, self._points.weights
        blocks = np.empty((C, A, A, 3, 3))
        for first in range(0, C, CELLS_PER_BATCH):
            last = min(first + CELLS_PER_BATCH, C)  # embedded points follow those of all cells
            cells, points = slice(first, last), slice(first * Q, last * Q)
            here = self._points.shape_gradients[cells]
            blocks[cells] = _cell_blocks(here, F[:, :, points], weights[points] * D[:, :, points])
            if S is not None:
                blocks[cells] += _stress_blocks(here, weights[points] * S[:, points])
        if len(self._points.embedded_in):
            points, here = slice(C * Q, None), self._points.embedded_gradients[:, None]
            of_points = _cell_blocks(here, F[:, :, points], weights[points] * D[:, :, points])
            if S is not None:
                of_points += _stress_blocks(here, weights[points] * S[:, points])
            summed = self._sum_embedded @ of_points.reshape(len(of_points), -1)
            blocks[self._with_embedded] += summed.reshape(-1, *blocks.shape[1:])
        sums = (self._sum_cells @ blocks[self._both_free].reshape(-1, 9)).reshape(-1, 3, 3)
        bsr = sums, self._columns, self._row_starts
        total = scipy.sparse.bsr_matrix(bsr, shape=(self._size, self._size)).tocsr()
        if following is not None and self._rows.start == 0:  # every rank has all of it
            total = total + following[self._free_components][:, self._free_components]
        if self._Z is not None:
            total = (self._Z.T @ total @ self._Z).tocsr()
        comm = self._comm.tompi4py()
        if comm.size > 1:  # the rows of this rank, of all ranks' parts
            total = sum(comm.alltoall([total[rows] for rows in comm.allgather(self._rows)]))
        total = total + self._linear_part(coefficients)[1]
        total.sort_indices()
        return from_local_rows(total, self._comm)


def _cell_blocks(shape_gradients: Array, F: Array, D: Array) -> Array:
    """Blocks (C, A, A, 3, 3) of each cell from shape functions' gradients (C, Q, A, 3), F and weighted moduli D."""
    C, Q, A, _ = shape_gradients.shape
    F, D = (values.reshape(*values.shape[:2], C, Q).transpose(2, 3, 0, 1) for values in (F, D))
    F_dN = np.einsum("cqki,cqaj->cqijak", F, shape_gradients)  # F_ki ∂N_a/∂X_j
    i, j = VOIGT_PAIRS.T
    B = (F_dN[:, :, i, j] + F_dN[:, :, j, i]) * (VOIGT_SHEAR / 2)[:, :, None]  # ∂E/∂(a, k)
    B = B.reshape(C, Q, 6, 3 * A)
    D_B = (D @ B).reshape(C, 6 * Q, 3 * A)
    K = B.reshape(C, 6 * Q, 3 * A).transpose(0, 2, 1) @ D_B
    return K.reshape(C, A, 3, A, 3).transpose(0, 1, 3, 2, 4)


def _stress_blocks(shape_gradients: Array, S: Array) -> Array:
    """Blocks (C, A, A, 3, 3) of weighted stresses (6, C Q): ∫ ∂N_a/∂X · S ∂N_b/∂X I."""
    C, Q, A, _ = shape_gradients.shape
    S = S[VOIGT_INDEX].reshape(3, 3, C, Q).transpose(2, 3, 0, 1)
    rows = shape_gradients.transpose(0, 2, 1, 3).reshape(C, A, 3 * Q)
    tension = (shape_gradients @ S).transpose(0, 1, 3, 2).reshape(C, 3 * Q, A)
    return (rows @ tension)[:, :, :, None, None] * np.eye(3)
