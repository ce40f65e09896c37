"""A kept factor that turns with the body: R A⁻¹ Rᵀ, with the rotation R of every node since A was made.

In the frame of the turned material the tangent of a body that bends hardly changes (corotational elements: Rankin &
Brogan, 1986). So a factor serves many times as many steps as one that stays as it is.
"""

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.fem.direct import PetscFactor
from fenics_rom.fem.finite_strain.quadrature import QuadraturePoints
from fenics_rom.fem.finite_strain.stresses import IDENTITY

POLAR_ITERATIONS = 3  # from strains of a third to a rotation to four digits: any R leaves R A⁻¹ Rᵀ definite


class TurnedFactor:
    """R A⁻¹ Rᵀ; every rank must call every method.

    Args:
        factor: of A, which belongs to it then.
        points: of the body.
        H: displacement gradients (3, 3, P here) that A was made of.
        components: (rows here,) which displacement component each row is.
    """

    def __init__(self, factor: PetscFactor, points: QuadraturePoints, H: Array, components: Array):
        self._factor, self._points = factor, points
        self._F_inverse = np.linalg.inv((IDENTITY + H).T).T
        self._nodes, of_node = np.unique(components // 3, return_inverse=True)
        row = np.full((len(self._nodes), 3), -1)
        row[of_node, components % 3] = np.arange(len(components))
        self._both = (row[:, :, None] >= 0) & (row[:, None, :] >= 0)  # a plane of symmetry turns in itself
        columns = np.broadcast_to(row[:, None, :], self._both.shape)[self._both]
        starts = np.concatenate([[0], np.cumsum((row >= 0).sum(axis=1).repeat((row >= 0).sum(axis=1)))])
        shape = len(components), len(components)
        self._R = scipy.sparse.csr_matrix((np.eye(3)[None].repeat(len(row), 0)[self._both], columns, starts), shape)

    def turn(self, H: Array) -> None:
        """Turns it to where displacement gradients are (3, 3, P here)."""
        F, before = IDENTITY + H, self._F_inverse
        since = F[:, :1] * before[0] + F[:, 1:2] * before[1] + F[:, 2:] * before[2]
        mean = self._points.nodal_means(since.reshape(9, -1).T)[self._nodes].reshape(-1, 3, 3)
        R = np.where(self._both, mean, np.eye(3))
        for _ in range(POLAR_ITERATIONS):  # Higham, 1986
            R = (R + _inverse_transposed(R)) / 2
        self._R.data[:] = R[self._both]

    def solve(self, block: Array) -> Array:
        """Solution for local rows (rows here, k)."""
        solution: Array = self._R @ self._factor.solve(self._R.T @ block)
        return solution

    def apply(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Solution for one right-hand side."""
        solution.array[:] = self.solve(right.array_r[:, None])[:, 0]

    def close(self) -> None:
        """Frees the factor."""
        self._factor.close()


def _inverse_transposed(R: Array) -> Array:
    """Of matrices (any, 3, 3)."""
    cofactors = np.cross(R[:, [1, 2, 0]], R[:, [2, 0, 1]])
    determinants = np.einsum("ni,ni->n", R[:, 0], cofactors[:, 0])
    inverse: Array = cofactors / determinants[:, None, None]
    return inverse
