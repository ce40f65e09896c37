"""Matrices of all displacement components, as dolfinx assembles them, to those of the unknowns: ZᵀAZ."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_rom.fem.petsc_matrix import PetscMatrix
from fenics_rom.system.body import Unknowns


def restrict_matrices(
    full: Mapping[str, PETSc.Mat], unknowns: Unknowns, dolfinx_number: np.ndarray, coordinates: np.ndarray
) -> dict[str, PetscMatrix]:
    """The matrices on the unknowns, which replace those on all components.

    Args:
        full: symmetric but for round-off, in dolfinx's numbering; they are destroyed. One is called "stiffness".
        unknowns: in canonical numbering.
        dolfinx_number: (N,) of each canonical node.
        coordinates: (N, 3) of the nodes, m.
    """
    free = unknowns.free
    first = full["stiffness"]
    comm = first.comm.tompi4py()
    whole_nodes = len(free) == 3 * len(np.unique(free // 3))
    here, index_set = rows_here(comm, free.reshape(-1, 3) if whole_nodes else free, dolfinx_number)
    if unknowns.weights is None:
        restricted = {name: A.createSubMatrix(index_set, index_set) for name, A in full.items()}
    else:
        Z = _expansion(first, unknowns, dolfinx_number, len(here))
        restricted = {name: A.ptap(Z) for name, A in full.items()}
        Z.destroy()
    matrices = {name: PetscMatrix(_symmetrize(A)) for name, A in restricted.items()}
    for matrix in full.values():
        matrix.destroy()
    if whole_nodes:
        set_rigid_modes(matrices["stiffness"].mat, coordinates[here[::3] // 3])
    return matrices


def rows_here(comm: Any, free: np.ndarray, dolfinx_number: np.ndarray) -> tuple[np.ndarray, PETSc.IS]:
    """This rank's part of free components (n,), or of whole nodes' (n/3, 3) for multigrid; and where dolfinx has it."""
    here = np.array_split(free, comm.size)[comm.rank].ravel()
    index_set = PETSc.IS().createGeneral((3 * dolfinx_number[here // 3] + here % 3).astype(PETSc.IntType), comm=comm)
    if free.ndim == 2:
        index_set.setBlockSize(3)
    return here, index_set


def _expansion(full: PETSc.Mat, unknowns: Unknowns, dolfinx_number: np.ndarray, columns_here: int) -> PETSc.Mat:
    """Z with the rows of a matrix of all components, in dolfinx's numbering."""
    start, stop = full.getOwnershipRange()
    rows = np.arange(start, stop)
    Z = unknowns.matrix[3 * np.argsort(dolfinx_number)[rows // 3] + rows % 3]
    Z.sort_indices()
    csr = (Z.indptr.astype(PETSc.IntType), Z.indices.astype(PETSc.IntType), Z.data)
    sizes = ((stop - start, unknowns.components), (columns_here, len(unknowns.free)))
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=full.comm)


def set_rigid_modes(stiffness: PETSc.Mat, coordinates: np.ndarray) -> None:
    """Tells multigrid the motions that cost next to no energy; `coordinates` of the nodes here, (N here, 3)."""
    points = stiffness.createVecRight()
    points.array[:] = coordinates.ravel()
    modes = PETSc.NullSpace().createRigidBody(points)
    stiffness.setNearNullSpace(modes)
    modes.destroy()
    points.destroy()


def _symmetrize(matrix: PETSc.Mat) -> PETSc.Mat:
    """(A + Aᵀ)/2, in place, symmetric to the last bit.

    The sums of assembly are so to round-off only, and xᵀ(A - Aᵀ)v would open the energy account of a thin body.
    """
    transposed = matrix.transpose(PETSc.Mat())
    matrix.axpy(1.0, transposed, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    matrix.scale(0.5)
    transposed.destroy()
    return matrix
