"""Solves with a matrix that is known by its products, preconditioned by a kept factor of one like it."""

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_rom.fem.direct import PetscFactor

Array = np.ndarray

MAX_PRODUCTS = 60  # for one solution


class Gmres:
    """GMRES (Saad & Schultz, 1986) on vectors of which each rank holds its rows.

    Args:
        local, size: number of rows here, and of all.
        comm: PETSc's communicator.

    Attributes:
        products: how many there have been.
    """

    def __init__(self, local: int, size: int, comm: Any):
        sizes = ((local, size), (local, size))
        self._apply: Callable[[Array], Array] = lambda column: column
        self._factor: PetscFactor | None = None
        self.products = 0
        self._matrix = PETSc.Mat().createPython(sizes, context=_Product(self), comm=comm)
        self._matrix.setUp()
        self._right, self._solution = self._matrix.createVecs()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOperators(self._matrix)
        self._ksp.setType("gmres")
        self._ksp.setGMRESRestart(MAX_PRODUCTS)
        self._ksp.setPCSide(PETSc.PC.Side.RIGHT)  # so that it is the residual itself that gets small
        self._preconditioner = self._ksp.getPC()
        self._preconditioner.setType("python")
        self._preconditioner.setPythonContext(_Preconditioner(self))

    def solve(self, apply: Callable[[Array], Array], factor: PetscFactor, right: Array, residual: float) -> Array:
        """A solution (rows here, 1) of `apply`(x) = right (rows here, 1) to a residual, as a share of |right|."""
        self._apply, self._factor = apply, factor
        self._right.array[:] = right[:, 0]
        self._solution.set(0.0)
        self._ksp.setTolerances(rtol=residual, atol=0.0, max_it=MAX_PRODUCTS)
        self._ksp.solve(self._right, self._solution)
        return self._solution.array[:, None].copy()

    def close(self) -> None:
        """Gives the memory back."""
        self._ksp.reset()
        for part in (self._preconditioner, self._ksp, self._right, self._solution, self._matrix):
            part.destroy()


class _Product:
    """The matrix as PETSc calls it."""

    def __init__(self, gmres: Gmres):
        self._gmres = gmres

    def mult(self, _: Any, x: PETSc.Vec, y: PETSc.Vec) -> None:
        self._gmres.products += 1
        y.array[:] = self._gmres._apply(x.array_r[:, None])[:, 0]


class _Preconditioner:
    """The factor as PETSc calls it."""

    def __init__(self, gmres: Gmres):
        self._gmres = gmres

    def apply(self, _: Any, x: PETSc.Vec, y: PETSc.Vec) -> None:
        assert self._gmres._factor is not None
        self._gmres._factor.apply(x, y)
