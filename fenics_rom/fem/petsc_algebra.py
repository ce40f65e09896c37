"""What the ranks do together with PETSc matrices: sums, solves and eigenpairs."""

import math
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.direct import ComplexFactor, CostlyFactor, MemoryShortage, PetscFactor
from fenics_rom.fem.eigenpairs import lowest_eigenpairs
from fenics_rom.fem.iterative import METHOD_NAME, IterativeFactor
from fenics_rom.fem.petsc_matrix import PetscMatrix, combination, fix_dofs
from fenics_rom.fem.ranks import run_on_rank_0
from fenics_rom.system.protocols import DENSE_SHARE, NO_DOFS, USUAL_COLUMNS, Value

EIGEN_RESIDUAL = 1e-6  # largest accepted |K v - γ M v| / |K v|
EIGEN_ROUND_OFF = 100 * float(np.finfo(float).eps)  # share of |K| |v|: of a thin body K v is round-off
EIGEN_ORTHONORMALITY = 1e-9  # largest accepted |Vᵀ M V - I|
OPERATIONS = 400  # of iterations, for each entry of a matrix and each column: 30 of them, with multigrid
SOLVERS = ("auto", "direct", "iterative")


def require_real(scalar: type) -> None:
    """Refuses a PETSc of complex numbers: energies and MUMPS' symmetric definite factors are real here."""
    if np.issubdtype(scalar, np.complexfloating):
        raise SolverError(
            "PETSc is the complex-valued build; fenics_rom needs the real one "
            "(on Debian: unset PETSC_DIR and SLEPC_DIR, or point them to the -real packages)"
        )


class PetscAlgebra:
    """Sums, solves and eigenpairs of PETSc matrices on one communicator."""

    def __init__(self, comm: Any, row_range: tuple[int, int]):
        self.comm = comm
        self._rows = slice(*row_range)

    def rows(self) -> slice:
        """Rows of this rank."""
        return self._rows

    def row_offset(self, count: int) -> int:
        """Number of rows on the ranks before this one, of a block with `count` rows here."""
        return sum(self.comm.allgather(count)[: self.comm.rank])

    def inner(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """leftᵀ right over all ranks. Summed on rank 0 and sent, so that every rank decides on the same bits."""
        part = np.asarray(left.T @ right, order="C")
        total = np.empty_like(part)
        self.comm.Reduce(part, total)  # as it is: `reduce` and `bcast` pickle, which took a fifth of a time step
        self.comm.Bcast(total)
        return total

    def gather(self, block: np.ndarray) -> np.ndarray:
        """All rows of a block."""
        if self.comm.size == 1:
            return np.array(block, order="C")
        return np.concatenate(self.comm.allgather(np.ascontiguousarray(block)))

    def broadcast(self, compute: Callable[[], Value]) -> Value:
        """What rank 0 computes, or raises, on every rank."""
        return run_on_rank_0(self.comm, compute)

    def maximum(self, values: ArrayLike) -> np.ndarray:
        """The largest of each entry over the ranks."""
        return np.max(self.comm.allgather(values), axis=0)

    def total(self, values: ArrayLike) -> np.ndarray:
        """Sum of each entry over the ranks."""
        return np.sum(self.comm.allgather(values), axis=0)

    def factor(
        self,
        *terms: tuple[complex, Any],
        solver: str = "auto",
        fixed_dofs: np.ndarray = NO_DOFS,
        columns: int = USUAL_COLUMNS,
    ) -> PetscFactor | ComplexFactor | IterativeFactor:
        """See Algebra; with real coefficients the sum is positive definite or refused, with complex ones only regular.

        Args:
            terms: coefficients and matrices.
            solver: "direct": MUMPS. "iterative": conjugate gradients with algebraic multigrid, which cannot tell for
                sure whether the matrix is positive definite; real coefficients only. "auto": direct where the factor
                fits into the memory and takes no more operations than iterations for so many columns; else iterative,
                and `notice` of the result says why.
            fixed_dofs, columns: see Algebra.

        Raises:
            SolverError: what was asked for cannot be had, or the factor does not fit into the memory.
        """
        if solver not in SOLVERS:
            raise SolverError(f"solver: {solver!r} was given; use one of {', '.join(map(repr, SOLVERS))}")
        real = [(float(np.real(coefficient)), a) for coefficient, a in terms]
        if any(np.iscomplexobj(coefficient) for coefficient, _ in terms):
            if solver == "iterative":
                raise SolverError("solver = 'iterative' is for real coefficients; complex ones were given")
            imaginary = [(float(np.imag(coefficient)), a) for coefficient, a in terms]
            return ComplexFactor(combination(*real), combination(*imaginary))
        if solver == "iterative":
            return _iterative(real, fixed_dofs, f"{METHOD_NAME}, as asked for")
        total = fix_dofs(combination(*real), fixed_dofs)
        most = math.inf if solver == "direct" else OPERATIONS * columns * total.getInfo()["nz_used"]
        try:
            return PetscFactor(total, most=most)
        except (MemoryShortage, CostlyFactor) as error:
            if solver == "direct":
                raise
            notice = f"{error.shortage}: {METHOD_NAME} were used"
        return _iterative(real, fixed_dofs, notice)

    def eigenpairs(
        self, mass: PetscMatrix, stiffness: PetscMatrix, count: int, factor: Any = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """See Algebra, paper (10)-(11); without a factor of K one is made (a direct one) and closed again.

        Raises:
            SolverError: not enough pairs converged, or they do not satisfy their equation.
        """
        if DENSE_SHARE * count > mass.size:
            γ, vectors = self._all_eigenpairs(mass, stiffness)
        elif factor is not None:
            γ, vectors = lowest_eigenpairs(mass, stiffness, factor, count)
        else:
            with closing(self.factor((1.0, stiffness), solver="direct")) as made:
                γ, vectors = lowest_eigenpairs(mass, stiffness, made, count)
        γ, vectors = γ[:count], vectors[:, :count]
        self._check_eigenpairs(mass, stiffness, γ, vectors)
        return γ, vectors

    def _all_eigenpairs(self, mass: PetscMatrix, stiffness: PetscMatrix) -> tuple[np.ndarray, np.ndarray]:
        identity = np.eye(mass.size)[self._rows]
        dense_m, dense_k = self.gather(mass @ identity), self.gather(stiffness @ identity)
        γ, vectors = self.broadcast(lambda: scipy.linalg.eigh(dense_k, dense_m))
        return γ, vectors[self._rows]

    def _check_eigenpairs(self, mass: PetscMatrix, stiffness: PetscMatrix, γ: np.ndarray, vectors: np.ndarray) -> None:
        mv, kv = mass @ vectors, stiffness @ vectors
        residual, products, lengths = (np.sqrt(np.diag(self.inner(x, x))) for x in (kv - γ * mv, kv, vectors))
        round_off = EIGEN_ROUND_OFF * stiffness.mat.norm(PETSc.NormType.INFINITY) * lengths
        norms = np.where(residual <= round_off, 0.0, residual / products)
        deviation = np.abs(self.inner(vectors, mv) - np.eye(len(γ))).max()
        if not (norms.max() <= EIGEN_RESIDUAL and deviation <= EIGEN_ORTHONORMALITY):  # so that NaN is refused too
            raise SolverError(
                f"eigenvectors are not accurate enough: |K v - γ M v| / |K v| = {norms.max():.1e} "
                f"(at most {EIGEN_RESIDUAL:g}), |Vᵀ M V - I| = {deviation:.1e} (at most {EIGEN_ORTHONORMALITY:g}); "
                "materials of very different stiffness and flat cells do this: see `info` for the cells"
            )


def _iterative(terms: list[tuple[float, Any]], fixed_dofs: np.ndarray, notice: str) -> IterativeFactor:
    """Of a sum of coefficient times matrix, which is there only until blocks of it are made."""
    (first, matrix), *others = terms
    if first == 1.0 and not others and not len(fixed_dofs) and isinstance(matrix, PetscMatrix):
        return IterativeFactor(matrix.mat, notice)
    total = fix_dofs(combination(*terms), fixed_dofs)
    try:
        return IterativeFactor(total, notice, [coefficient for coefficient, _ in terms])
    finally:
        total.destroy()
