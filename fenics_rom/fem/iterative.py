"""Solves without a factorisation: conjugate gradients with algebraic multigrid, of many right-hand sides at once."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.column_products import advance, divide, dots, padded_width, turn
from fenics_rom.fem.direct import LESS, MAX_MEMORY_SHARE
from fenics_rom.fem.memory import needed_and_free_bytes
from fenics_rom.fem.multigrid import Multigrid
from fenics_rom.fem.options import FACTOR_PREFIX
from fenics_rom.fem.ranked_blocks import RankedBlocks
from fenics_rom.system.columns import apply_to_complex
from fenics_rom.system.protocols import EXACT

MAX_ITERATIONS = 5000
STALLED = 500  # iterations in which the largest residual does not halve
COLUMNS_AT_ONCE = 16  # a block of the matrix is read once for them; four such blocks of columns are there at a time
# Bytes of an entry of the matrix, for blocks of it and of the levels while these are made; of an unknown, for columns.
BYTES_PER_ENTRY, BYTES_PER_UNKNOWN = 45, 900
METHOD_NAME = "conjugate gradients with algebraic multigrid"


class IterativeFactor:
    """What a factor of a symmetric positive definite matrix does, in little memory.

    Multigrid takes rigid body modes from the near-nullspace of the matrix; where it has none, solves take longer. The
    matrix may be destroyed: blocks of it are kept, in double precision, and of multigrid in single.

    Args:
        mat: the matrix.
        notice: as of Factor.
        coefficients: of the matrices whose sum it is, for messages.

    Attributes:
        iterations: of the last solve.

    Raises:
        SolverError: there is less memory than it needs, about, or there are no levels of such a matrix.
    """

    def __init__(self, mat: PETSc.Mat, notice: str, coefficients: Sequence[float] = (1.0,)):
        self.notice, self.iterations = notice, 0
        self._comm, self._size, self._coefficients = mat.comm.tompi4py(), mat.getSize()[0], coefficients
        estimate = (
            BYTES_PER_ENTRY * mat.getInfo(PETSc.Mat.InfoType.LOCAL)["nz_used"]
            + BYTES_PER_UNKNOWN * mat.getLocalSize()[0]
        )
        needed, free = needed_and_free_bytes(self._comm, estimate)
        if needed > MAX_MEMORY_SHARE * free:
            raise SolverError(
                f"{notice}; but for {self._size:,} unknowns these need about {needed / 1e9:.3g} GB on this machine and "
                f"{free / 1e9:.3g} GB are free: choose {LESS}"
            )
        options = PETSc.Options(FACTOR_PREFIX)
        self._least = options.getReal("ksp_rtol", 0.0)
        self._most = options.getInt("ksp_max_it", MAX_ITERATIONS)
        self._tells = options.hasName("ksp_monitor")
        try:
            self._multigrid = Multigrid(mat)
        except PETSc.Error as error:
            raise SolverError(
                f"multigrid could not be set up for {self._size:,} unknowns: PETSc error {error.ierr}; "
                "is the matrix symmetric positive definite?"
            ) from error
        except SolverError as error:
            raise SolverError(
                f"multigrid could not be set up for {self._size:,} unknowns: {error}; "
                "is the matrix symmetric positive definite?"
            ) from error
        self._matrix = RankedBlocks.of(mat, float)

    def solve(self, block: Array, accuracy: float = EXACT) -> Array:
        """Solution for local rows (rows here, k), real or complex, from zero.

        Raises:
            SolverError: the iterations did not converge.
        """
        if np.iscomplexobj(block):
            return apply_to_complex(lambda columns: self.solve(columns, accuracy), block)
        result = np.empty(block.shape)
        for first in range(0, block.shape[1], COLUMNS_AT_ONCE):
            some = block[:, first : first + COLUMNS_AT_ONCE]
            columns = np.zeros((len(some), padded_width(some.shape[1])))
            columns[:, : some.shape[1]] = some
            solved = self._solve(columns, max(accuracy, self._least))
            result[:, first : first + some.shape[1]] = solved[:, : some.shape[1]]
        return result

    def apply(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solution for one right-hand side."""
        solution.array[:] = self.solve(right.array_r[:, None])[:, 0]

    def _solve(self, r: Array, accuracy: float) -> Array:
        """Each column by itself, side by side; r is overwritten.

        β is Polak's and Ribière's, as multigrid in single precision is not the same operator to the last bit.
        """
        x, p, q = (np.zeros_like(r) for _ in range(3))
        scaled = np.empty(r.shape, dtype=np.float32)
        lengths = np.sqrt(self._sums(dots(r, r)))
        given, allowed, best = lengths, None, (0, np.inf)
        α, before = np.zeros_like(lengths), np.ones_like(lengths)
        for iteration in range(self._most + 1):
            scale = np.where(lengths > 0, lengths, 1.0)
            divide(r, scale, scaled)
            z = self._multigrid.solve(scaled)
            products = self._sums(np.concatenate([dots(r, z), dots(q, z)]))
            rz, qz = scale * products[: len(lengths)], scale * products[len(lengths) :]
            sizes = np.sqrt(np.maximum(rz, 0.0))
            allowed = accuracy * sizes if allowed is None else allowed
            if not (np.isfinite(rz).all() and (rz >= 0).all()):
                raise self._failure(
                    "DIVERGED_NAN" if not np.isfinite(rz).all() else "DIVERGED_INDEFINITE_PC", iteration, sizes, given
                )
            off = float(np.divide(sizes, allowed, out=np.zeros_like(sizes), where=allowed > 0).max()) * accuracy
            if self._tells and self._comm.rank == 0:
                print(f"{iteration:5d} preconditioned residual {off:.3e} of the first, {r.shape[1]} columns")
            self.iterations = iteration
            if off <= accuracy:
                return x
            if off < best[1] / 2:
                best = iteration, off
            elif iteration - best[0] > STALLED:
                raise self._failure("DIVERGED_ITS, as it stagnates,", iteration, sizes, given)
            if iteration == self._most:
                break
            β = -np.divide(α * qz, before, out=np.zeros_like(rz), where=before > 0)
            turn(β, z, scale, p)
            self._matrix.times(p, q)
            energy = self._sums(dots(p, q))
            if not (energy >= 0).all():
                raise self._failure("DIVERGED_INDEFINITE_MAT", iteration, sizes, given)
            α = np.divide(rz, energy, out=np.zeros_like(rz), where=energy > 0)
            lengths, before = np.sqrt(self._sums(advance(α, p, q, x, r))), rz
        raise self._failure("DIVERGED_ITS", iteration, sizes, given)

    def _sums(self, values: Array) -> Array:
        """Of the ranks, the same bits on each."""
        total: Array = self._comm.allreduce(values)
        return total

    def _failure(self, reason: str, iterations: int, residuals: Array, given: Array) -> SolverError:
        of = ", ".join(f"{c:.3g}" for c in self._coefficients)
        sum_of = "" if len(self._coefficients) == 1 else f" (a sum of matrices times {of})"
        return SolverError(
            f"{METHOD_NAME} did not solve for {self._size:,} unknowns{sum_of}: {reason} after {iterations} iterations "
            f"with a preconditioned residual of {residuals.max():.1e}, right-hand side {given.max():.1e}; is the "
            f"matrix symmetric positive definite? Flat cells and materials of very different stiffness do this, too; "
            f'try solver = "direct" (-{FACTOR_PREFIX}ksp_monitor shows more)'
        )

    def close(self) -> None:
        """Frees the levels and the matrix."""
        del self._multigrid, self._matrix
