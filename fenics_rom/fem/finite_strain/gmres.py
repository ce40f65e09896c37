"""Solves with a matrix that is known by its products, preconditioned by a kept factor of one like it."""

from collections.abc import Callable
from typing import Any

from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.finite_strain.turned_factor import TurnedFactor

MAX_PRODUCTS = 60  # for one solution


class Gmres:
    """GMRES (Saad & Schultz, 1986) on vectors with `local` of `size` rows on this rank.

    Attributes:
        products: with matrices, counted.
        converged: whether the last solution has the residual that was asked for.
    """

    def __init__(self, local: int, size: int, comm: Any):
        sizes = ((local, size), (local, size))
        self._apply: Callable[[Array], Array] = lambda column: column
        self._factor: PetscFactor | TurnedFactor | None = None
        self.products, self.converged = 0, True
        self._matrix = PETSc.Mat().createPython(sizes, context=self, comm=comm)
        self._matrix.setUp()
        self._right, self._solution = self._matrix.createVecs()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOperators(self._matrix)
        self._ksp.setType("gmres")
        self._ksp.setGMRESRestart(MAX_PRODUCTS)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)  # so that it is the residual itself that gets small
        self._preconditioner = self._ksp.getPC()
        self._preconditioner.setType("python")
        self._preconditioner.setPythonContext(self)

    def solve(
        self,
        apply: Callable[[Array], Array],
        factor: PetscFactor | TurnedFactor,
        right: Array,
        residual: float,
        max_products: int = MAX_PRODUCTS,
    ) -> Array:
        """A solution (rows here, 1) of `apply`(x) = right (rows here, 1) to a residual, as a share of |right|."""
        self._apply, self._factor = apply, factor
        self._right.array[:] = right[:, 0]
        self._solution.set(0.0)
        self._ksp.setTolerances(rtol=residual, atol=0.0, max_it=max_products)
        self._ksp.solve(self._right, self._solution)
        self.converged = self._ksp.getConvergedReason() > 0
        return self._solution.array[:, None].copy()

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """The product with the matrix, as PETSc calls it."""
        self.products += 1
        y.array[:] = self._apply(x.array_r[:, None])[:, 0]

    def apply(self, _: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """The preconditioner, as PETSc calls it."""
        assert self._factor is not None
        self._factor.apply(x, y)

    def close(self) -> None:
        """Gives the memory back."""
        self._ksp.reset()
        for part in (self._preconditioner, self._ksp, self._right, self._solution, self._matrix):
            part.destroy()
