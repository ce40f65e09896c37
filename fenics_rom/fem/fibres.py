"""Fibres of a scene at points of its cells: of materials by their directions, and of membranes and cables."""

from typing import Any

import numpy as np
import scipy.sparse
from mpi4py import MPI
from numpy import ndarray as Array

from fenics_rom.errors import MeshError, check_known
from fenics_rom.fem.embedded import directions_at, embedded_points, refuse_without_direction
from fenics_rom.fem.finite_strain.quadrature import QuadraturePoints
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.places import cells_of
from fenics_rom.mechanics.fibres import Fibres, structure_of
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.voigt import VOIGT_INDEX
from fenics_rom.scene.fibres import FibreMaterial
from fenics_rom.scene.scene import Scene

DATA_FILES = ".vtk, .vtu and .xdmf"


def has_fibres(scene: Scene) -> bool:
    """Whether it has any, membranes and cables among them."""
    return bool(
        scene.effects.membranes or scene.effects.cables or any(m.fibres is not None for m in scene.materials.values())
    )


def quadrature_points(scene: Scene, nodes: Nodes, comm: Any) -> QuadraturePoints:
    """The points of a scene's body, and of what is embedded in it."""
    return QuadraturePoints(nodes, comm, scene.integration == "selective", embedded_points(scene, nodes))


def point_material(scene: Scene, nodes: Nodes, points: QuadraturePoints, moduli: Array) -> PointMaterial:
    """What the points are made of, by a law of small strains where the scene names no other.

    `moduli`: λ and μ of every cell of the mesh file, (C, 2), Pa.
    """
    large = scene.effects.large_deformation
    law = "st_venant_kirchhoff" if large is None else large.law
    λ, μ = points.shared_moduli(*points.of_cells(moduli[points.cells]).T)
    cells = points.of_cells(points.cells)
    cells[len(cells) - len(points.embedded_in) :] = -1
    cells[points.is_dilation] = -1
    inside, places = cells >= 0, points.strain_places
    fibres = []
    for family in fibres_at(scene, nodes.mesh, cells[inside], places):
        rows = np.flatnonzero(inside)[family.points]
        fibres.append(Fibres(family.law, rows, family.structure, family.modulus, family.stiffening))
    first = len(cells) - len(points.embedded_in)
    for family in points.embedded.fibres:
        fibres.append(Fibres(family.law, first + family.points, family.structure, family.modulus, family.stiffening))
    return PointMaterial(law, λ, μ, tuple(fibres))


def fibres_at(scene: Scene, mesh: Mesh, cells: Array, places: Array) -> tuple[Fibres, ...]:
    """Of the materials of cells (P,) at places in them (P, 3).

    Raises:
        MeshError, SceneError: the mesh file has no such cell data, or fibres have no direction.
    """
    families = []
    for name, material in scene.materials.items():
        if material.fibres is None:
            continue
        where = f"{scene.source}: materials.{name}"
        is_there = np.zeros(len(mesh.cells), dtype=bool)
        is_there[cells_of(material, mesh, where)] = True
        points = np.flatnonzero(is_there[cells])
        fibres, count = material.fibres, len(points)
        for directions in _directions(fibres, mesh, is_there, cells[points], places[points], f"{where}.fibres"):
            structure = structure_of(directions, fibres.dispersion)
            of_points = np.full(count, fibres.modulus), np.full(count, fibres.stiffening)
            families.append(Fibres(fibres.law, points, structure, *of_points))
    return tuple(families)


def _directions(
    fibres: FibreMaterial, mesh: Mesh, is_there: Array, cells: Array, places: Array, where: str
) -> list[Array]:
    """Unit directions (K, 3) of each family at places (K, 3) in cells (K,)."""
    if fibres.data is None:
        return directions_at(fibres, places, where)
    found = []
    for name in fibres.data:
        if not mesh.vectors:
            raise MeshError(
                f"{where}.data: {mesh.source} has no vectors {name!r} of its cells, nor any; use cell data of "
                f"three numbers in {DATA_FILES}"
            )
        check_known("vectors", name, mesh.vectors, MeshError, f"{where}.data: {mesh.source}: ")
        vectors = mesh.vectors[name]
        length = np.linalg.norm(vectors, axis=1)
        own, middles = np.flatnonzero(is_there), mesh.points[mesh.cells[is_there]].mean(axis=1)
        lacks = ~(np.isfinite(length) & (length > 0))[own]
        refuse_without_direction(lacks, middles, f"{where}.data", "cells", f"{name!r} is 0 or no number there")
        found.append(vectors[cells] / length[cells][:, None])
    return found


def fibre_stiffness(
    scene: Scene, nodes: Nodes, moduli: Array, damping: Array
) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix] | None:
    """What fibres add to K of small strains, and with β (C,) of each cell to D, of all displacements (3 N, 3 N).

    The same on every rank, of all cells; None where there are none. `moduli` as in `point_material`.
    """
    if not has_fibres(scene):
        return None
    points = quadrature_points(scene, nodes, MPI.COMM_SELF)
    material = point_material(scene, nodes, points, moduli)
    K, D = (scipy.sparse.csr_matrix((3 * len(nodes.coordinates),) * 2) for _ in range(2))
    gradient, β = points.gradient_matrix, points.of_cells(damping)
    by_axis = [gradient[axis * len(points.weights) :][: len(points.weights)] for axis in range(3)]
    for family in material.fibres:
        strain = sum(_component(family, by_axis, i) for i in range(3))
        stiffness = points.weights[family.points] * family.stiffness_at_rest
        K = K + strain.T @ scipy.sparse.diags(stiffness) @ strain
        D = D + strain.T @ scipy.sparse.diags(β[family.points] * stiffness) @ strain
    return K.tocsr(), D.tocsr()


def _component(family: Fibres, by_axis: list[scipy.sparse.csr_matrix], i: int) -> scipy.sparse.csr_matrix:
    """Strains (K, 3 N) of displacements along one axis: M_ij ∂/∂X_j."""
    along = sum(
        scipy.sparse.diags(family.structure[VOIGT_INDEX[i, j]]) @ by_axis[j][family.points] for j in range(3)
    ).tocoo()
    shape = along.shape[0], 3 * along.shape[1]
    return scipy.sparse.csr_matrix((along.data, (along.row, 3 * along.col + i)), shape=shape)
