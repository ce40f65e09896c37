"""PETSc matrices as the reduction sees them, with factorisations by MUMPS and eigenpairs by SLEPc."""

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc
from slepc4py import SLEPc

from fenics_rom.errors import SolverError

DENSE_SHARE = 3  # beyond a third of all eigenpairs, LAPACK on gathered matrices is the better eigensolver
EIGEN_RESIDUAL = 1e-6  # largest accepted |K v - γ M v| / |K v|
EIGEN_ORTHONORMALITY = 1e-9  # largest accepted |Vᵀ M V - I|
FACTOR_PREFIX = "fenics_rom_factor_"
NEGATIVE_PIVOTS = 12  # of MUMPS' INFOG: it factors indefinite matrices without a word
# L Lᵀ, which fails for an indefinite matrix; the simplicial L D Lᵀ that CHOLMOD prefers for small ones does not.
CHOLMOD_OPTIONS = {"mat_cholmod_factor": "SUPERNODAL", "mat_cholmod_print": 0}


def require_real(scalar: type) -> None:
    """Refuses a PETSc of complex numbers: energies and MUMPS' symmetric definite factors are real here.

    Raises:
        SolverError: PETSc was built for complex numbers.
    """
    if np.issubdtype(scalar, np.complexfloating):
        raise SolverError(
            "PETSc is the complex-valued build; fenics_rom needs the real one "
            "(on Debian: unset PETSC_DIR and SLEPC_DIR, or point them to the -real packages)"
        )


class PetscMatrix:
    """A symmetric sparse matrix with its rows spread over the ranks."""

    def __init__(self, mat: PETSc.Mat):
        self.mat = mat
        self.size = mat.getSize()[0]
        self.local = mat.getLocalSize()[0]
        self._vectors = mat.createVecs()

    def __matmul__(self, block: np.ndarray) -> np.ndarray:
        """Product with local rows (rows here, k)."""
        if block.shape[1] == 0:
            return np.empty_like(block)
        if block.shape[1] == 1:
            return self.single(self.mat.mult, block)
        with _Dense(self, block) as x:
            y = self.mat.matMult(x)
            result = y.getDenseArray().copy()
            y.destroy()
        return result

    def single(self, operation: Callable[[PETSc.Vec, PETSc.Vec], None], column: np.ndarray) -> np.ndarray:
        """Result of `operation(x, y)` for one column, in vectors that are kept: this is what a time step does."""
        x, y = self._vectors
        x.array[:] = column[:, 0]
        operation(x, y)
        return y.array[:, None].copy()

    def destroy(self) -> None:
        """Frees the matrix."""
        for part in (*self._vectors, self.mat):
            part.destroy()


class _Dense:
    """A block of local rows as a PETSc matrix, for as long as a call needs it."""

    def __init__(self, like: PetscMatrix, block: np.ndarray):
        size = ((like.local, like.size), (None, block.shape[1]))
        self.data = np.array(block, dtype=float, order="F")  # PETSc takes no copy, so this one must live as long
        self.mat = PETSc.Mat().createDense(size, array=self.data, comm=like.mat.comm)
        self.mat.setUp()  # without it PETSc 3.18 crashes
        self.mat.assemble()

    def __enter__(self) -> PETSc.Mat:
        return self.mat

    def __exit__(self, *_: object) -> None:
        self.mat.destroy()


def combination(*terms: tuple[float, PetscMatrix]) -> PETSc.Mat:
    """Sum of coefficient times matrix; all matrices have one pattern."""
    present = [(c, a) for c, a in terms if c != 0.0]
    (first, start), *rest = present
    total = start.mat.copy()
    total.scale(first)
    for coefficient, matrix in rest:
        total.axpy(coefficient, matrix.mat, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    return total


class PetscFactor:
    """Cholesky factor of a symmetric positive definite matrix, kept.

    MUMPS solves many right-hand sides at once and on any number of ranks; CHOLMOD, on one rank, is about three times
    as fast for one right-hand side at a time, which is what a time step has.
    """

    def __init__(self, mat: PETSc.Mat, one_by_one: bool = False):
        solver = "cholmod" if one_by_one and mat.comm.size == 1 else "mumps"
        size = mat.getSize()[0]
        self._like = PetscMatrix(mat)
        mat.setOption(PETSc.Mat.Option.SPD, True)
        self.ksp = PETSc.KSP().create(mat.comm)
        self.ksp.setOptionsPrefix(FACTOR_PREFIX)
        self.ksp.setOperators(mat)
        self.ksp.setType("preonly")
        preconditioner = self.ksp.getPC()
        preconditioner.setType("cholesky")
        preconditioner.setFactorSolverType(solver)
        self.ksp.setErrorIfNotConverged(True)
        failure = self._factorize(mat, solver)
        if failure:
            self.close()
            raise SolverError(
                f"{solver} could not factor a matrix of {size} unknowns ({failure}): "
                "is it symmetric positive definite, and does its factor fit in memory?"
            )

    def _factorize(self, mat: PETSc.Mat, solver: str) -> str:
        """Makes the factor, or says why there is none."""
        if not np.isfinite(mat.norm()):
            return "not all of its numbers are finite"
        if solver == "cholmod":  # no sooner: PETSc complains of options that nothing has read
            options = PETSc.Options(FACTOR_PREFIX)
            for name, value in CHOLMOD_OPTIONS.items():
                options[name] = value
        try:
            self.ksp.setUp()
        except PETSc.Error as error:
            return f"PETSc error {error.ierr}"
        self._factor = self.ksp.getPC().getFactorMatrix()
        if solver == "mumps" and self._factor.getMumpsInfog(NEGATIVE_PIVOTS) > 0:
            return "negative pivots"
        return ""

    def solve(self, block: np.ndarray) -> np.ndarray:
        """Solution for local rows (rows here, k)."""
        if block.shape[1] == 0:
            return np.empty_like(block)
        if block.shape[1] == 1:
            return self._like.single(self._factor.solve, block)
        with _Dense(self._like, block) as b, _Dense(self._like, np.zeros_like(block)) as x:
            self._factor.matSolve(b, x)
            return x.getDenseArray().copy()

    def close(self) -> None:
        """Frees the factor; without reset, PETSc keeps it as long as Python saw its preconditioner."""
        if hasattr(self, "_factor"):
            self._factor.destroy()
        self.ksp.reset()
        self.ksp.destroy()
        self._like.destroy()


class PetscAlgebra:
    """Sums, solves and eigenpairs of PETSc matrices on one communicator."""

    def __init__(self, comm: Any, row_range: tuple[int, int]):
        self.comm = comm
        self._rows = slice(*row_range)

    def rows(self) -> slice:
        """Rows of this rank."""
        return self._rows

    def inner(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """leftᵀ right over all ranks. Summed on rank 0 and sent, so that every rank decides on the same bits."""
        return self.comm.bcast(self.comm.reduce(left.T @ right, root=0), root=0)

    def gather(self, block: np.ndarray) -> np.ndarray:
        """All rows of a block."""
        return np.concatenate(self.comm.allgather(np.ascontiguousarray(block)))

    def factor(self, *terms: tuple[float, PetscMatrix]) -> PetscFactor:
        """Factorisation of a sum of coefficient times matrix."""
        return PetscFactor(combination(*terms))

    def eigenpairs(self, mass: PetscMatrix, stiffness: PetscMatrix, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The lowest γ of K v = γ M v, ascending, and M-orthonormal v, paper (10)-(11).

        Raises:
            SolverError: not enough pairs converged, or they do not satisfy their equation.
        """
        if DENSE_SHARE * count > mass.size:
            gamma, vectors = self._all_eigenpairs(mass, stiffness)
        else:
            gamma, vectors = self._lowest_eigenpairs(mass, stiffness, count)
        gamma, vectors = gamma[:count], vectors[:, :count]
        self._check_eigenpairs(mass, stiffness, gamma, vectors)
        return gamma, vectors

    def _all_eigenpairs(self, mass: PetscMatrix, stiffness: PetscMatrix) -> tuple[np.ndarray, np.ndarray]:
        import scipy.linalg

        identity = np.eye(mass.size)[self._rows]
        dense_m, dense_k = self.gather(mass @ identity), self.gather(stiffness @ identity)
        gamma, vectors = self.comm.bcast(scipy.linalg.eigh(dense_k, dense_m) if self.comm.rank == 0 else None, root=0)
        return gamma, vectors[self._rows]

    def _lowest_eigenpairs(
        self, mass: PetscMatrix, stiffness: PetscMatrix, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        eps = SLEPc.EPS().create(self.comm)
        eps.setOptionsPrefix("fenics_rom_eps_")
        eps.setOperators(stiffness.mat, mass.mat)
        eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        eps.setDimensions(count)
        eps.setTarget(0.0)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setTolerances(1e-10, 500)
        spectral = eps.getST()
        spectral.setType("sinvert")
        ksp = spectral.getKSP()
        ksp.setType("preonly")
        preconditioner = ksp.getPC()
        preconditioner.setType("cholesky")
        preconditioner.setFactorSolverType("mumps")
        eps.setFromOptions()
        try:
            eps.solve()
        except PETSc.Error as error:
            raise SolverError(f"SLEPc failed with PETSc error {error.ierr}") from error
        converged = eps.getConverged()
        if converged < count:
            raise SolverError(
                f"SLEPc found {converged} of {count} eigenpairs in {eps.getIterationNumber()} iterations "
                f"(reason {eps.getConvergedReason()}); ask for fewer"
            )
        gamma = np.array([eps.getEigenvalue(k).real for k in range(count)])
        vectors = np.empty((mass.local, count))
        work = mass.mat.createVecRight()
        for k in range(count):
            eps.getEigenvector(k, work)
            vectors[:, k] = work.array
        work.destroy()
        ksp.reset()
        eps.destroy()
        order = np.argsort(gamma, kind="stable")
        return gamma[order], vectors[:, order]

    def _check_eigenpairs(
        self, mass: PetscMatrix, stiffness: PetscMatrix, gamma: np.ndarray, vectors: np.ndarray
    ) -> None:
        mv, kv = mass @ vectors, stiffness @ vectors
        residual = kv - gamma * mv
        norms = np.sqrt(np.diag(self.inner(residual, residual)) / np.diag(self.inner(kv, kv)))
        lack = np.abs(self.inner(vectors, mv) - np.eye(len(gamma))).max()
        if not (norms.max() <= EIGEN_RESIDUAL and lack <= EIGEN_ORTHONORMALITY):  # so that NaN is refused too
            raise SolverError(
                f"eigenvectors are not good enough: |K v - γ M v| / |K v| = {norms.max():.1e} "
                f"(allowed {EIGEN_RESIDUAL:g}), |Vᵀ M V - I| = {lack:.1e} (allowed {EIGEN_ORTHONORMALITY:g})"
            )
