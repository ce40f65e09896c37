"""Springs and dashpots to ground, spread evenly over surfaces: matrices of NumPy, added to those of dolfinx.

They are the same for the three components of a node, S ⊗ I₃. In a fixed frame they are part of K and D. Of a body whose
frame moves these strain the body alone, and what ties it to the ground stays beside them.
"""

from collections.abc import Iterable

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_rom.fem.nodes import Nodes, surface_mass
from fenics_rom.fem.petsc_matrix import PetscMatrix, from_local_rows
from fenics_rom.fem.places import patch_triangles
from fenics_rom.scene.places import Place
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns


def springs_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Stiffness S of springs to ground, of all nodes (N, N), N/m."""
    springs = scene.effects.springs
    return _on_surfaces(nodes, ((f"effects.springs.{name}", s, s.stiffness) for name, s in springs.items()))


def dashpots_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Damping S of dashpots to ground, of all nodes (N, N), N s/m."""
    dashpots = scene.effects.damped.dashpots
    return _on_surfaces(nodes, ((f"effects.damping.dashpots.{name}", d, d.coefficient) for name, d in dashpots.items()))


def _on_surfaces(nodes: Nodes, parts: Iterable[tuple[str, Place, float]]) -> scipy.sparse.csr_matrix | None:
    """Sum of coefficients spread evenly over surfaces; None of none."""
    total = None
    for where, place, coefficient in parts:
        added = coefficient * surface_mass(nodes, patch_triangles(nodes, place, where))
        total = added if total is None else total + added
    return total


def of_components(matrix: scipy.sparse.csr_matrix | None) -> scipy.sparse.csr_matrix | None:
    """S ⊗ I₃ of all displacement components (3 N, 3 N)."""
    return None if matrix is None else scipy.sparse.kron(matrix, np.eye(3), format="csr")


def with_attached(matrix: PetscMatrix, attached: scipy.sparse.csr_matrix | None, unknowns: Unknowns) -> PetscMatrix:
    """The matrix plus one of all displacements of the nodes (3 N, 3 N), if there is one."""
    if attached is None:
        return matrix
    start, stop = matrix.mat.getOwnershipRange()
    Z = unknowns.matrix
    here = (Z[:, start:stop].T @ attached @ Z).tocsr()
    here.sort_indices()
    added = from_local_rows(here, matrix.mat.comm)
    total = matrix.mat.copy()
    total.axpy(1.0, added, structure=PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
    added.destroy()
    matrix.destroy()
    return PetscMatrix(total)
