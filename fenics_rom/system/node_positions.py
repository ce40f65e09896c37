"""Where the nodes of anyone's matrices are: three rows for each, in the order of the nodes."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StructureError
from fenics_rom.system.body import Body, Unknowns, body_without_mesh
from fenics_rom.system.columns import probe_columns
from fenics_rom.system.moving_frame import FullOrderFrame, GeometricStiffness, check_motions
from fenics_rom.system.protocols import Algebra, Operator

SAME_MASS = 1e-10  # largest share of a product with M in which the three components of a node may differ


def body_of_matrices(nodes: Any, M: Operator, diagonal: Array, algebra: Algebra) -> Body:
    """The body of matrices with nodes (N, 3), m, at rest, the same on every rank; or without a mesh where None.

    `diagonal` is that of M, (n,) on every rank, kg.
    """
    size = len(diagonal)
    if nodes is None:
        return body_without_mesh(size)
    if size % 3:
        raise StructureError(f"nodes: the matrices have {size} rows; use three for each node")
    X = np.array(nodes, dtype=float)
    if X.shape != (size // 3, 3) or not np.isfinite(X).all():
        raise StructureError(f"nodes has shape {X.shape}; use ({size // 3}, 3) finite numbers, m")
    rows = algebra.rows()
    if (algebra.total(rows.start % 3 + rows.stop % 3) > 0).any():
        raise StructureError("nodes: ranks have parts of a node's three rows; use whole nodes")
    along_x = np.tile([[1.0], [0.0], [0.0]], (size // 3, 1))[rows]
    node_mass = diagonal[::3] * float(algebra.inner(along_x, M @ along_x).item() / diagonal[::3].sum())
    return Body(X, np.empty((0, 3), dtype=int), Unknowns(size, np.arange(size)), node_mass)


def with_surface(body: Body, triangles: Any) -> Body:
    """The body with outward triangles (F, 3) between its nodes, so that it can be drawn; as it is where None."""
    if triangles is None:
        return body
    T = np.array(triangles, dtype=int).reshape(-1, 3)
    if T.size and not 0 <= T.min() <= T.max() < len(body.nodes):
        raise StructureError(f"triangles: name nodes from {T.min()} to {T.max()}; use 0 to {len(body.nodes) - 1}")
    return replace(body, triangles=T)


def check_outputs(outputs: Mapping[str, Array]) -> None:
    """Refuses (StructureError) outputs of a body with nodes that are not displacements of points."""
    for name, C in outputs.items():
        if C.shape[1] % 3:
            raise StructureError(
                f"outputs[{name!r}] has {C.shape[1]} columns; on a body with nodes an output is displacements of "
                "points: use three (x, y, z) for each"
            )


def frame_of_matrices(
    body: Body,
    M: Operator,
    rigid: int,
    algebra: Algebra,
    outputs: Mapping[str, Array],
    geometric_stiffness: GeometricStiffness | None,
) -> FullOrderFrame:
    """The moving frame of a body with nodes: free, or carried by a base at the origin of coordinates.

    Nodes that a base holds are not in the matrices: their mass counts as the base's.
    """
    if not len(body.nodes):
        raise StructureError('frame = "moving": nodes are needed, (N, 3), m, three rows of the matrices for each')
    carried, rows = rigid == 0, algebra.rows()
    check_motions(rigid, carried, 'frame = "moving": ')
    _check_alike(M, algebra)
    origin = np.zeros(3) if carried else _products(M, body.nodes, np.zeros(3), algebra)[0][0, 1:] / body.node_mass.sum()
    moments, mass_times = _products(M, body.nodes, origin, algebra)
    arms = body.nodes[rows.start // 3 : rows.stop // 3] - origin
    along = {name: algebra.inner(C, body.nodes.reshape(-1, 1)[rows]).reshape(-1, 3) for name, C in outputs.items()}
    return FullOrderFrame(carried, origin, arms, mass_times, moments, along, geometric_stiffness=geometric_stiffness)


def _products(M: Operator, X: Array, origin: Array, algebra: Algebra) -> tuple[Array, Array]:
    """(4, 4) and (nodes here, 4), as in FullOrderFrame."""
    rows = algebra.rows()
    fields = np.concatenate([np.ones((len(X), 1)), X - origin], axis=1)[rows.start // 3 : rows.stop // 3]
    along_x = (fields[:, None, :] * np.array([1.0, 0.0, 0.0])[:, None]).reshape(-1, 4)
    products = np.ascontiguousarray((M @ along_x)[::3])
    return algebra.inner(fields, products), products


def _check_alike(M: Operator, algebra: Algebra) -> None:
    """Refuses a mass that is not m ⊗ I₃."""
    z = probe_columns(algebra, 1)[::3]
    product = M @ (z[:, None, :] * np.eye(3)).reshape(-1, 3)
    expected = (product[::3, :1, None] * np.eye(3)).reshape(-1, 3)
    lack, size = algebra.maximum([np.abs(product - expected).max(), np.abs(product).max()])
    if lack > SAME_MASS * size:
        raise StructureError(
            f"mass is not the same for each component of a node by itself: off by {lack / size:.1e}; "
            f'frame = "moving" needs M = m ⊗ I₃, to {SAME_MASS:g}'
        )
