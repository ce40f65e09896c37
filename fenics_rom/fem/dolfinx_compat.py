"""Every difference between the dolfinx releases that are supported (0.5 to 0.11), and nothing else."""

import inspect
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import ufl
from dolfinx import cpp, fem, mesh

from fenics_rom.fem.partition import bisect_cells

OLD = not hasattr(fem, "functionspace")  # 0.5 and 0.6


def _rows(adjacency: Any) -> np.ndarray:
    if isinstance(adjacency, np.ndarray):
        return adjacency
    return adjacency.array.reshape(adjacency.num_nodes, -1)


def create_cells(comm: Any, cells: np.ndarray, points: np.ndarray, cell: str = "tetrahedron", degree: int = 1) -> Any:
    """Distributed mesh of cells from arrays on rank 0 (the other ranks pass none).

    Args:
        comm: an mpi4py communicator.
        cells: (C, any) nodes in basix' order.
        points: (N, 3), m.
        cell: which of basix' cell types.
        degree: of the coordinates, 2 of curved cells.
    """
    parameters = inspect.signature(mesh.create_mesh).parameters
    if OLD:
        shape = ufl.Cell(cell, geometric_dimension=3)
        element = ufl.VectorElement(ufl.FiniteElement("Lagrange", shape, degree, variant="equispaced"))
    else:
        import basix.ufl

        element = basix.ufl.element("Lagrange", cell, degree, basix.LagrangeVariant.equispaced, shape=(3,))
    cells, points = np.ascontiguousarray(cells, dtype=np.int64), np.ascontiguousarray(points, dtype=float)
    owner = bisect_cells(points[cells].mean(axis=1), comm.size)
    arguments: dict[str, Any] = {
        "cells": cells,
        "x": points,
        "e" if "e" in parameters else "domain": ufl.Mesh(element),
        "partitioner": _partitioner(owner),
    }
    if "ghost_mode" in parameters:
        arguments["ghost_mode"] = mesh.GhostMode.none
    return mesh.create_mesh(comm, **arguments)


def _partitioner(owner: np.ndarray) -> Any:
    """What tells dolfinx the rank of each cell of this rank; 0.5 also wants to hear who has a neighbour of it."""
    if not OLD:
        return lambda *_: cpp.graph.AdjacencyList_int32(owner[:, None])

    def destinations(comm: Any, ranks: int, neighbours: Any, ghosting: bool) -> Any:
        cell, count = np.arange(len(owner)), np.diff(neighbours.offsets)
        of_neighbours = np.column_stack([np.repeat(cell, count), owner[neighbours.array]])
        others = np.unique(of_neighbours[of_neighbours[:, 1] != np.repeat(owner, count)], axis=0)
        pairs = np.concatenate([np.column_stack([cell, owner]), others])
        pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
        offsets = np.searchsorted(pairs[:, 0], np.arange(len(owner) + 1))
        return cpp.graph.AdjacencyList_int32(pairs[:, 1].astype(np.int32), offsets.astype(np.int32))

    return cpp.mesh.create_cell_partitioner(destinations)


def vector_space(domain: Any, degree: int) -> Any:
    """Lagrange displacements."""
    if OLD:
        return fem.VectorFunctionSpace(domain, ("Lagrange", degree))
    return fem.functionspace(domain, ("Lagrange", degree, (3,)))


def cell_constants(domain: Any) -> Any:
    """Space of functions that are constant in each cell."""
    if OLD:
        return fem.FunctionSpace(domain, ("DG", 0))
    return fem.functionspace(domain, ("DG", 0))


def cell_nodes(domain: Any) -> np.ndarray:
    """Geometry nodes of each local cell."""
    geometry = domain.geometry
    return _rows(geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap)


def input_nodes(domain: Any) -> np.ndarray:
    """Rows of the points that the mesh was made of, for each local geometry node; 0.5 has them as a list."""
    return np.asarray(domain.geometry.input_global_indices, dtype=np.int64)


def cell_dofs(space: Any) -> np.ndarray:
    """Nodes of the space in each local cell."""
    return _rows(space.dofmap.list)


@contextmanager
def quiet_compiler() -> Iterator[None]:
    """Meanwhile nothing is logged of the C compiler, which 0.5 lets talk."""
    logging.disable(logging.INFO)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)
