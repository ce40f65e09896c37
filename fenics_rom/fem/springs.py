"""Springs and dashpots to ground, and masses fixed to a body: matrices of NumPy, added to those of dolfinx."""

from collections.abc import Iterable

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_rom.fem.nodes import Nodes, patch_triangles, shape_functions, surface_mass
from fenics_rom.fem.petsc_matrix import PetscMatrix, from_local_rows
from fenics_rom.scene.places import Place
from fenics_rom.scene.scene import Scene
from fenics_rom.system.body import Unknowns


def springs_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Stiffness of springs to ground, of all displacements of the nodes (3 N, 3 N), N/m."""
    springs = scene.effects.springs
    return _on_surfaces(nodes, ((f"effects.springs.{name}", s, s.stiffness) for name, s in springs.items()))


def dashpots_of(scene: Scene, nodes: Nodes) -> scipy.sparse.csr_matrix | None:
    """Damping of dashpots to ground, of all displacements of the nodes (3 N, 3 N), N s/m."""
    dashpots = scene.effects.damped.dashpots
    return _on_surfaces(nodes, ((f"effects.damping.dashpots.{name}", d, d.coefficient) for name, d in dashpots.items()))


def masses_of(scene: Scene, nodes: Nodes) -> tuple[scipy.sparse.csr_matrix | None, np.ndarray]:
    """What masses fixed to the body add to M, of all displacements (3 N, 3 N), and to its weight at each node (N,), kg.

    A mass at a point is carried by the nodes of its cell, by their shape functions w: m w wᵀ.
    """
    total, weight = None, np.zeros(len(nodes.coordinates))
    for name, fixed in scene.effects.point_masses.items():
        where, along = f"effects.point_masses.{name}", np.eye(3)
        if fixed.point is not None:
            w = scipy.sparse.csr_matrix(shape_functions(nodes, np.array(fixed.point), where)).T
            share = w @ w.T
        else:
            share = surface_mass(nodes, patch_triangles(nodes, fixed, where))
        if fixed.direction is not None:
            n = np.array(fixed.direction) / np.linalg.norm(fixed.direction)
            along = np.outer(n, n)
        added = scipy.sparse.kron(fixed.mass * share, along, format="csr")
        total = added if total is None else total + added
        weight += fixed.mass * np.asarray(share.sum(axis=1)).ravel()
    return total, weight


def _on_surfaces(nodes: Nodes, parts: Iterable[tuple[str, Place, float]]) -> scipy.sparse.csr_matrix | None:
    """Sum of coefficients spread evenly over surfaces; None of none."""
    total = None
    for where, place, coefficient in parts:
        share = surface_mass(nodes, patch_triangles(nodes, place, where))
        added = scipy.sparse.kron(coefficient * share, np.eye(3), format="csr")
        total = added if total is None else total + added
    return total


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
