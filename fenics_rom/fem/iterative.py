"""Solves without a factorisation: conjugate gradients with algebraic multigrid."""

import numpy as np
from petsc4py import PETSc

from fenics_rom.errors import SolverError
from fenics_rom.fem.options import FACTOR_PREFIX, default_options
from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.system.columns import apply_to_complex

RESIDUAL_TOLERANCE = 1e-14  # preconditioned, relative: solutions are then as good as a factor's
MAX_ITERATIONS = 5000
# Couplings below this share do not join an aggregate: half the iterations on thin bodies, none lost on thick ones.
MULTIGRID_OPTIONS = {"pc_gamg_threshold": "0.05"}
METHOD_NAME = "conjugate gradients with algebraic multigrid"


def reason_name(reasons: type, value: int) -> str:
    """What PETSc or SLEPc calls a reason to stop, such as "DIVERGED_ITS"."""
    return next((name for name, number in vars(reasons).items() if number == value), str(value))


class IterativeFactor:
    """What a factor of a symmetric positive definite matrix does, in little memory; the matrix belongs to it then.

    Multigrid takes rigid body modes from the near-nullspace of the matrix; where it has none, solves take longer.
    """

    def __init__(self, mat: PETSc.Mat, notice: str):
        self.notice = notice
        self._matrix = PetscMatrix(mat)
        mat.setOption(PETSc.Mat.Option.SPD, True)
        self._ksp = PETSc.KSP().create(mat.comm)
        self._ksp.setOptionsPrefix(FACTOR_PREFIX)
        self._ksp.setOperators(mat)
        self._ksp.setType("cg")
        self._ksp.setTolerances(rtol=RESIDUAL_TOLERANCE, atol=0.0, max_it=MAX_ITERATIONS)
        self._ksp.getPC().setType("gamg")
        try:
            with default_options(FACTOR_PREFIX, MULTIGRID_OPTIONS):
                self._ksp.setFromOptions()
                self._ksp.setUp()
        except PETSc.Error as error:
            self.close()
            raise SolverError(
                f"multigrid could not be set up for {self._matrix.size:,} unknowns: PETSc error {error.ierr}; "
                "is the matrix symmetric positive definite?"
            ) from error

    def solve(self, block: np.ndarray) -> np.ndarray:
        """Solution for local rows (rows here, k), real or complex."""
        if np.iscomplexobj(block):
            return apply_to_complex(self.solve, block)
        result = np.empty(block.shape)
        for k in range(block.shape[1]):
            result[:, k : k + 1] = self._matrix.apply_to_column(self.apply, block[:, k : k + 1])
        return result

    def apply(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solution for one right-hand side, from zero.

        Raises:
            SolverError: the iterations did not converge.
        """
        self._ksp.solve(right, solution)
        reason = self._ksp.getConvergedReason()
        if reason < 0:
            raise SolverError(
                f"{METHOD_NAME} did not solve for {self._matrix.size:,} unknowns: "
                f"{reason_name(PETSc.KSP.ConvergedReason, reason)} after {self._ksp.getIterationNumber()} iterations "
                f"with a preconditioned residual of {self._ksp.getResidualNorm():.1e}, right-hand side "
                f"{right.norm():.1e}; is the matrix symmetric positive definite? "
                f"(-{FACTOR_PREFIX}ksp_monitor shows more)"
            )

    def close(self) -> None:
        """Frees the multigrid levels and the matrix."""
        self._ksp.reset()
        self._ksp.destroy()
        self._matrix.destroy()
