"""Springs and dashpots to ground, spread evenly over surfaces: matrices of NumPy, added to those of dolfinx.

They are the same for the three components of a node, S ⊗ I₃, but for springs that slide, which resist along the normals
of triangles. In a fixed frame they are part of K and D. Of a body whose frame moves these strain the body alone, and
what ties it to the ground stays beside them.
"""

from collections.abc import Iterable, Iterator

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_rom.fem.facets import surface_area, surface_mass
from fenics_rom.fem.nodes import Nodes, area_vectors
from fenics_rom.fem.petsc_matrix import PetscMatrix, from_local_rows
from fenics_rom.fem.places import patch_triangles
from fenics_rom.scene.effects import Spring
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns


def springs_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Stiffness S of springs to ground that resist in all directions alike, of all nodes (N, N), N/m."""
    return summed(
        _stiffness(spring, nodes, triangles) * surface_mass(nodes, triangles)
        for spring, triangles in _springs(scene, nodes)
        if not spring.sliding
    )


def sliding_springs_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Stiffness of springs that resist along normals n alone, ∫ φ_i φ_j n nᵀ, (3 N, 3 N), N/m."""
    parts = []
    for spring, triangles in _springs(scene, nodes):
        if spring.sliding:
            n, k = area_vectors(nodes, triangles), _stiffness(spring, nodes, triangles)
            n /= np.linalg.norm(n, axis=1)[:, None]
            for row, column in np.ndindex(3, 3):
                S = k * surface_mass(nodes, triangles, n[:, row] * n[:, column])
                parts.append(scipy.sparse.kron(S, np.outer(*np.eye(3)[[row, column]]), format="csr"))
    return summed(parts)


def _springs(scene: Scene, nodes: Nodes) -> Iterator[tuple[Spring, np.ndarray]]:
    """With the triangles (F, 3) of each."""
    for name, spring in scene.effects.springs.items():
        yield spring, patch_triangles(nodes, spring, f"effects.springs.{name}")


def _stiffness(spring: Spring, nodes: Nodes, triangles: np.ndarray) -> float:
    """Of the whole surface, N/m."""
    area = surface_area(nodes, triangles)
    return spring.foundation * area if spring.foundation is not None else spring.stiffness or 0.0


def dashpots_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Damping S of dashpots to ground, of all nodes (N, N), N s/m."""
    return summed(
        dashpot.coefficient * surface_mass(nodes, patch_triangles(nodes, dashpot, f"effects.damping.dashpots.{name}"))
        for name, dashpot in scene.effects.damped.dashpots.items()
    )


def summed(parts: Iterable[scipy.sparse.csr_matrix | None]) -> scipy.sparse.csr_matrix | None:
    """The sum of those that there are; None of none."""
    there = [part for part in parts if part is not None]
    return sum(there[1:], start=there[0]) if there else None


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
