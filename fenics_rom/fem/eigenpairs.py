"""The lowest eigenpairs of K v = γ M v by SLEPc."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from petsc4py import PETSc
from slepc4py import SLEPc

from fenics_rom.errors import SolverError
from fenics_rom.fem.options import EIGEN_PREFIX
from fenics_rom.fem.petsc_matrix import PetscMatrix


class _Solve:
    """K⁻¹ as PETSc's preconditioner: what a factor does for one right-hand side."""

    def __init__(self, factor: Any):
        self._factor = factor
        self.failure: SolverError | None = None  # kept, because newer PETSc passes on that there was one, not which

    def apply(self, _: PETSc.PC, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        try:
            self._factor.apply(right, solution)
        except SolverError as error:
            self.failure = error
            raise


def lowest_eigenpairs(
    mass: PetscMatrix, stiffness: PetscMatrix, factor: Any, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest γ, ascending, (count,) and M-orthonormal v (rows here, count).

    One solve with a factor of K at a time. Block Lanczos with 64 at a time was no faster: what it gains in solves, its
    larger spaces lose in orthogonalisation.

    Raises:
        SolverError: not all of them converged.
    """
    solve = _Solve(factor)
    with _solver(mass, stiffness, solve, count) as eps:
        try:
            eps.solve()
        except (PETSc.Error, SystemError) as error:  # of what `solve` raised petsc4py 3.25 makes the latter
            if solve.failure:
                raise solve.failure from None
            raise SolverError(f"SLEPc failed with PETSc error {getattr(error, 'ierr', error)}") from error
        converged = eps.getConverged()
        if converged < count:
            reason = _reason_name(SLEPc.EPS.ConvergedReason, eps.getConvergedReason())
            raise SolverError(
                f"SLEPc found {converged} of {count} eigenpairs in {eps.getIterationNumber()} iterations "
                f"({reason}); ask for fewer"
            )
        γ = np.array([eps.getEigenvalue(k).real for k in range(count)])
        vectors = np.empty((mass.local, count))
        work = mass.mat.createVecRight()
        for k in range(count):
            eps.getEigenvector(k, work)
            vectors[:, k] = work.array
        work.destroy()
    order = np.argsort(γ, kind="stable")
    return γ[order], vectors[:, order]


@contextmanager
def _solver(mass: PetscMatrix, stiffness: PetscMatrix, solve: _Solve, count: int) -> Iterator[SLEPc.EPS]:
    """Krylov-Schur for the γ next to zero."""
    eps = SLEPc.EPS().create(mass.mat.comm)
    eps.setOptionsPrefix(EIGEN_PREFIX)
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
    preconditioner.setType("python")
    preconditioner.setPythonContext(solve)
    try:
        eps.setFromOptions()
        yield eps
    finally:
        ksp.reset()
        eps.destroy()


def _reason_name(reasons: type, value: int) -> str:
    """What SLEPc calls a reason to stop, such as "DIVERGED_ITS"."""
    return next((name for name, number in vars(reasons).items() if number == value), str(value))
