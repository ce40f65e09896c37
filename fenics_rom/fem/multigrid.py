"""Algebraic multigrid for many right-hand sides at once, in single precision.

PETSc's GAMG makes the levels: smoothed aggregation with rigid body motions (Vaněk, Mandel & Brezina 1996; Adams,
Brezina, Hu & Tuminaro 2003). They are kept as blocks, and PETSc's own are freed. A V-cycle is a symmetric, definite
operator: Chebyshev polynomials of degree 2 smooth, before and after, and the coarsest level is solved.
"""

import numpy as np
from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.options import FACTOR_PREFIX, default_options
from fenics_rom.fem.ranked_blocks import RankedBlocks

# Couplings below the threshold join no aggregate. The coarsest level is solved with a dense inverse on every rank.
OPTIONS = {"pc_gamg_threshold": "0.01", "pc_gamg_coarse_eq_limit": "800"}
LOWEST, HIGHEST = 0.1, 1.1  # of the largest eigenvalue of D⁻¹A, as it is estimated: what is smoothed
PROBES, PROBE_STEPS = 8, 12  # columns, and products, that the estimate takes
NO_STIFFNESS = 1e-10  # of the largest entry of a diagonal: rows with less are of motions that an aggregate has not


class Multigrid:
    """A⁻¹ approximately, of a symmetric definite matrix, which is not kept."""

    def __init__(self, mat: PETSc.Mat):
        preconditioner = PETSc.PC().create(mat.comm)
        preconditioner.setOptionsPrefix(FACTOR_PREFIX)
        preconditioner.setOperators(mat)
        preconditioner.setType("gamg")
        try:
            with default_options(FACTOR_PREFIX, OPTIONS):
                preconditioner.setFromOptions()
                preconditioner.setUp()
            self._levels = [
                _Level(*_parts_of(preconditioner, number)) for number in range(preconditioner.getMGLevels() - 1, 0, -1)
            ]
            self._coarsest = _Coarsest(*_parts_of(preconditioner, 0))
        finally:
            preconditioner.destroy()

    def solve(self, b: Array) -> Array:
        """One V-cycle for columns (rows here, k), in single precision; what it gives the next call writes over."""
        return self._cycle(0, b)

    def _cycle(self, number: int, b: Array) -> Array:
        if number == len(self._levels):
            return self._coarsest.solve(b)
        level = self._levels[number]
        one, two, three = level.workspace(b.shape[1])
        level.smooth_from_zero(b, one, two)
        level.operator.residual(two, one, b)
        coarser = self._cycle(number + 1, level.prolongation.transposed_times(one))
        level.prolongation.add_times(coarser, two)
        level.smooth(b, two, three, one)
        return one


def _parts_of(preconditioner: PETSc.PC, number: int) -> list[PETSc.Mat]:
    """The operator of a level, and but for the coarsest, 0, its interpolation: for the caller to destroy.

    What is left to Python to free, PETSc keeps for good on several ranks.
    """
    solver = preconditioner.getMGSmoother(number) if number else preconditioner.getMGCoarseSolve()
    operator, other = solver.getOperators()
    other.destroy()
    solver.destroy()
    return [operator, preconditioner.getMGInterpolation(number)] if number else [operator]


class _Level:
    """An operator, and the way to and from the next coarser one."""

    def __init__(self, mat: PETSc.Mat, prolongation: PETSc.Mat):
        comm = mat.comm.tompi4py()
        self.operator = RankedBlocks.of(mat, np.float32)
        self.prolongation = RankedBlocks.of(prolongation, np.float32)
        vector = mat.getDiagonal()
        diagonal, largest = vector.array.copy(), vector.max()[1]
        vector.destroy()
        if not largest > 0:
            raise SolverError("multigrid: the diagonal of a matrix is not positive")
        there = diagonal > NO_STIFFNESS * largest
        mat.destroy()
        prolongation.destroy()
        self._inverse = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=there).astype(np.float32)
        highest = self._largest_eigenvalue(comm)
        middle, half = (HIGHEST + LOWEST) * highest / 2, (HIGHEST - LOWEST) * highest / 2
        next_ratio = 1 / (2 * middle / half - half / middle)
        self._first, self._kept, self._share = 1 / middle, next_ratio * half / middle, 2 * next_ratio / half
        self._workspace = np.empty((3, 0, 0), dtype=np.float32)

    def workspace(self, columns: int) -> Array:
        """Three blocks (rows here, k) that are kept, as to ask for memory anew takes a fifth of a cycle."""
        if self._workspace.shape[2] != columns:
            self._workspace = np.empty((3, self.operator.rows, columns), dtype=np.float32)
        return self._workspace

    def smooth_from_zero(self, b: Array, first: Array, x: Array) -> None:
        """Two steps of Chebyshev's iteration from zero, to x."""
        np.multiply(b, (np.float32(self._first) * self._inverse)[:, None], out=first)
        self.operator.relaxed(first, x, b, self._inverse, first, (1 + self._kept, 0.0, self._share))

    def smooth(self, b: Array, before: Array, first: Array, x: Array) -> None:
        """Two steps of it from `before`, to x."""
        self.operator.relaxed(before, first, b, self._inverse, before, (1.0, 0.0, self._first))
        self.operator.relaxed(first, x, b, self._inverse, before, (1 + self._kept, -self._kept, self._share))

    def _largest_eigenvalue(self, comm: object) -> float:
        """Of D⁻¹A, by Ritz values of a few columns that were multiplied with it."""
        root = np.sqrt(self._inverse)[:, None]
        offset = sum(comm.allgather(len(root))[: comm.rank])  # type: ignore[attr-defined]
        x = np.random.default_rng(offset).standard_normal((len(root), PROBES)).astype(np.float32)
        product = x
        for _ in range(PROBE_STEPS):
            x = product / np.sqrt(_total(comm, np.sum(product.astype(float) ** 2, axis=0))).astype(np.float32)
            product = root * self.operator.times(np.ascontiguousarray(root * x))
        gram, projected = _total(comm, x.T.astype(float) @ x), _total(comm, x.T.astype(float) @ product)
        w, E = np.linalg.eigh(gram)
        E = E[:, w > 1e-6 * w[-1]] / np.sqrt(w[w > 1e-6 * w[-1]])
        return float(np.linalg.eigvalsh(E.T @ (projected + projected.T) @ E / 2)[-1])


class _Coarsest:
    """The dense inverse of the coarsest level, the same on every rank."""

    def __init__(self, mat: PETSc.Mat):
        self._comm = mat.comm.tompi4py()
        start, column, values = mat.getValuesCSR()
        rows = np.zeros((len(start) - 1, mat.getSize()[1]))
        rows[np.repeat(np.arange(len(rows)), np.diff(start)), column] = values
        A = np.concatenate(self._comm.allgather(rows))
        self._rows = slice(*mat.getOwnershipRange())
        mat.destroy()
        w, E = np.linalg.eigh((A + A.T) / 2)
        if not w[-1] > 0:
            raise SolverError("multigrid: the coarsest matrix is not positive definite")
        some = w > NO_STIFFNESS * w[-1]
        self._inverse = (E[self._rows][:, some] / w[some] @ E[:, some].T).astype(np.float32)

    def solve(self, b: Array) -> Array:
        """The solution for columns (rows here, k)."""
        whole = b if self._comm.size == 1 else np.concatenate(self._comm.allgather(b))
        return np.ascontiguousarray(self._inverse @ whole)


def _total(comm: object, values: Array) -> Array:
    """The sum over the ranks, the same bits on every rank."""
    total: Array = comm.allreduce(values)  # type: ignore[attr-defined]
    return total
