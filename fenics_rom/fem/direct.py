"""Kept factorisations by MUMPS, and by CHOLMOD for time steps."""

import math

import numpy as np
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.memory import needed_and_free_bytes
from fenics_rom.fem.options import FACTOR_PREFIX, default_options
from fenics_rom.fem.petsc_ctypes import cholesky_numeric, cholesky_symbolic, set_factor_prefix
from fenics_rom.fem.petsc_matrix import CHUNK, PetscMatrix, column_chunks, dense_block
from fenics_rom.system.columns import apply_to_complex
from fenics_rom.system.protocols import EXACT

HAS_CHOLMOD = PETSc.Sys.hasExternalPackage("suitesparse")  # PETSc from PyPI has none: MUMPS takes its place
# L Lᵀ, which fails for an indefinite matrix; the simplicial L D Lᵀ that CHOLMOD prefers for small ones does not.
CHOLMOD_OPTIONS = {"mat_cholmod_factor": "SUPERNODAL", "mat_cholmod_print": "0"}
MUMPS_OPTIONS = {"mat_mumps_icntl_27": str(CHUNK)}  # right-hand sides that it takes at once
# Room beyond the estimate, %, that is tried one after the other: pivots that are put off need more than is foreseen.
ROOMS: tuple[dict[str, str], ...] = ({}, {"mat_mumps_icntl_14": "200"}, {"mat_mumps_icntl_14": "1000"})
ROOM_CODES = (-8, -9)  # of INFOG(1), of too little of it
INFOG_NEGATIVE_PIVOTS = 12  # MUMPS factors indefinite matrices without a word
RINFOG_OPERATIONS = 1  # that eliminating takes, as the analysis of the pattern says
INFO_ESTIMATED_MEMORY = 15  # MB on this rank, as the analysis of the pattern says
OUT_OF_MEMORY_CODES = (-8, -9, -13, -17, -19, -20)  # of INFOG(1)
MAX_MEMORY_SHARE = 0.9  # of the free memory that a factor may take; vectors need some, too
LESS = "a coarser mesh or more machines"  # what to choose where nothing fits


class MemoryShortage(SolverError):
    """A factor does not fit; `shortage` says so with numbers, without what to do about it.

    `of_room`: in what MUMPS has set aside, and not in memory.
    """

    def __init__(self, shortage: str, replaceable: bool = True, of_room: bool = False):
        alternative = 'solver = "iterative" (conjugate gradients with algebraic multigrid), ' if replaceable else ""
        super().__init__(f"{shortage}: tried was the direct solver, MUMPS; choose {alternative}{LESS}")
        self.shortage, self.of_room = shortage, of_room


class CostlyFactor(SolverError):
    """A factor would fit, and take more operations than allowed; `shortage` says so with numbers."""

    def __init__(self, shortage: str):
        super().__init__(shortage)
        self.shortage = shortage


class PetscFactor:
    """L Lᵀ of a symmetric matrix, kept, which is refused unless `definite`; or L D Lᵀ. The matrix belongs to it then.

    MUMPS solves many right-hand sides at once and on any number of ranks; CHOLMOD, on one rank, is about three times
    as fast `one_by_one`, which is what time steps have. A PETSc without CHOLMOD has MUMPS for these, too.

    Raises:
        CostlyFactor: MUMPS would need more operations than `most`, by the analysis of the pattern.
        MemoryShortage: there is less memory than the factor needs, by the analysis of its pattern or as it turned out.
        SolverError: the matrix cannot be factored.
    """

    notice = ""

    def __init__(self, mat: PETSc.Mat, one_by_one: bool = False, definite: bool = True, most: float = math.inf):
        self._most = most
        self._solver = "cholmod" if one_by_one and HAS_CHOLMOD and mat.comm.size == 1 else "mumps"
        self._definite = definite
        self._matrix = PetscMatrix(mat)
        mat.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        mat.setOption(PETSc.Mat.Option.SPD, definite)
        set_factor_prefix(mat, FACTOR_PREFIX)
        options = CHOLMOD_OPTIONS if self._solver == "cholmod" else MUMPS_OPTIONS
        for room in ROOMS:
            try:
                with default_options(FACTOR_PREFIX, options | room):
                    self._factorize(mat)
                return
            except SolverError as error:
                self._free()
                if room is ROOMS[-1] or not (isinstance(error, MemoryShortage) and error.of_room):
                    self._matrix.destroy()
                    raise

    def _factorize(self, mat: PETSc.Mat) -> None:
        self._preconditioner = PETSc.PC().create(mat.comm)
        self._preconditioner.setOperators(mat)
        self._preconditioner.setType("cholesky")
        self._preconditioner.setFactorSolverType(self._solver)
        if not np.isfinite(mat.norm()):
            raise self._failure("not all of its numbers are finite")
        self._preconditioner.setFactorSetUpSolverType()
        self._factor = self._preconditioner.getFactorMatrix()
        self._check(cholesky_symbolic(self._factor, mat))
        if self._solver == "mumps":
            estimate = self._factor.getMumpsInfo(INFO_ESTIMATED_MEMORY) * 1e6
            needed, free = needed_and_free_bytes(mat.comm.tompi4py(), estimate)
            if needed > MAX_MEMORY_SHARE * free:
                raise MemoryShortage(
                    f"the factor of a matrix of {self._matrix.size:,} unknowns would need {needed / 1e9:.3g} GB on "
                    f"this machine and {free / 1e9:.3g} GB are free",
                    self._definite,
                )
            operations = self._factor.getMumpsRinfog(RINFOG_OPERATIONS)
            if operations > self._most:
                raise CostlyFactor(
                    f"the factor of a matrix of {self._matrix.size:,} unknowns would take {operations:.2g} operations "
                    f"and {needed / 1e9:.3g} GB on this machine, iterations about {self._most:.2g}"
                )
        self._check(cholesky_numeric(self._factor, mat))
        if self._solver == "mumps" and self._definite and self.negative_pivots > 0:
            raise self._failure("negative pivots")

    def _check(self, error: int) -> None:
        """Raises on every rank what went wrong on one."""
        error = self._matrix.mat.comm.tompi4py().allreduce(abs(error))
        if error:
            raise self._failure(f"PETSc error {error}")
        if self._solver == "mumps":
            code, detail = (self._factor.getMumpsInfog(k) for k in (1, 2))
            status = f"INFOG(1) = {code}, INFOG(2) = {detail}"
            if code in OUT_OF_MEMORY_CODES:
                estimate = self._factor.getMumpsInfog(17) / 1e3
                raise MemoryShortage(
                    f"MUMPS ran out of memory with a matrix of {self._matrix.size:,} unknowns ({status}), whose factor "
                    f"it expected to need {estimate:.3g} GB on all ranks "
                    f"(-{FACTOR_PREFIX}mat_mumps_icntl_14 allows more)",
                    self._definite,
                    of_room=code in ROOM_CODES,
                )
            if code < 0:
                raise self._failure(status)

    def _failure(self, reason: str) -> SolverError:
        kind = "symmetric positive definite" if self._definite else "symmetric and regular"
        return SolverError(
            f"{self._solver} could not factor a matrix of {self._matrix.size} unknowns ({reason}): is it {kind}, "
            "and does its factor fit in memory?"
        )

    def solve(self, block: np.ndarray, accuracy: float = EXACT) -> np.ndarray:
        """Solution for local rows (rows here, k), real or complex."""
        if np.iscomplexobj(block):
            return apply_to_complex(self.solve, block)
        if block.shape[1] == 1:
            return self._matrix.apply_to_column(self.apply, block)
        result = np.empty(block.shape)
        for part in column_chunks(block):
            with dense_block(self._matrix, block[:, part]) as b, dense_block(self._matrix, result[:, part]) as x:
                self._factor.matSolve(b, x)
                result[:, part] = x.getDenseArray()
        return result

    def apply(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solution for one right-hand side."""
        self._factor.solve(right, solution)

    @property
    def negative_pivots(self) -> int:
        """How many there are in L D Lᵀ: as many as negative eigenvalues of the matrix (Sylvester)."""
        return int(self._factor.getMumpsInfog(INFOG_NEGATIVE_PIVOTS))

    def close(self) -> None:
        """Frees the factor; what is left to Python to free, PETSc keeps for good on several ranks."""
        self._free()
        self._matrix.destroy()

    def _free(self) -> None:
        if hasattr(self, "_factor"):
            self._factor.destroy()
        self._preconditioner.destroy()


class ComplexFactor:
    """Factor of A + i B, both symmetric, on a PETSc of real numbers.

    (A + i B)(x + i y) = f + i g is [A, -B; -B, -A] [x; y] = [f; -g]: real and symmetric, of twice the size. A and B are
    used up; errors as of `PetscFactor`.
    """

    notice = ""

    def __init__(self, real: PETSc.Mat, imaginary: PETSc.Mat):
        self._local = real.getLocalSize()[0]
        minus_real = real.copy()
        minus_real.scale(-1.0)
        imaginary.scale(-1.0)
        nest = PETSc.Mat().createNest([[real, imaginary], [imaginary, minus_real]], comm=real.comm)
        doubled = PETSc.Mat()
        nest.convert("aij", doubled)
        for mat in (nest, minus_real, real, imaginary):
            mat.destroy()
        self._doubled = PetscFactor(doubled, definite=False)

    def solve(self, block: np.ndarray, accuracy: float = EXACT) -> np.ndarray:
        """Complex solution for local rows (rows here, k), real or complex."""
        parts = self._doubled.solve(np.vstack([block.real, -block.imag]))
        return parts[: self._local] + 1j * parts[self._local :]

    def close(self) -> None:
        """Frees the factor."""
        self._doubled.close()
