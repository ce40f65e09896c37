"""Every difference between the dolfinx releases that are supported (0.5 to 0.9), and nothing else."""

import inspect
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh

OLD = not hasattr(fem, "functionspace")  # 0.5 and 0.6


def _rows(adjacency: Any) -> np.ndarray:
    if isinstance(adjacency, np.ndarray):
        return adjacency
    return adjacency.array.reshape(adjacency.num_nodes, -1)


def create_tetrahedra(comm: Any, cells: np.ndarray, points: np.ndarray) -> Any:
    """Distributed mesh of straight tetrahedra from arrays on rank 0 (the other ranks pass none)."""
    parameters = inspect.signature(mesh.create_mesh).parameters
    if OLD:
        shape = ufl.Cell("tetrahedron", geometric_dimension=3)
        element = ufl.VectorElement(ufl.FiniteElement("Lagrange", shape, 1, variant="equispaced"))
    else:
        import basix.ufl

        element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    arguments: dict[str, Any] = {
        "cells": np.ascontiguousarray(cells, dtype=np.int64),
        "x": np.ascontiguousarray(points, dtype=float),
        "e" if "e" in parameters else "domain": ufl.Mesh(element),
    }
    if "ghost_mode" in parameters:
        arguments["ghost_mode"] = mesh.GhostMode.none
    return mesh.create_mesh(comm, **arguments)


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
    return _rows(domain.geometry.dofmap)


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
