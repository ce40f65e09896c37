"""Places in cells: which cell a point is in, shape functions there and their gradients; volumes; inside-out cells."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.cell_kinds import CURVED_TETRAHEDRA, TETRAHEDRON, points_of_rule, tabulate
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.mesh_quality import signed_volumes
from fenics_rom.fem.nodes import Nodes, canonical_nodes

NEAREST = 32  # cells, by their boxes, of which a point may be in one
ITERATIONS = 30  # of Newton's method, which finds a point in a cell
FAR = 0.5  # sizes of the reference cell that an iteration may be off it
CONVERGED = 1e-13
ROUND_OFF = 1e-12  # of shape functions that are 0


def quadrature_rule(nodes: Nodes) -> tuple[int, int, int]:
    """Degrees of stiffness, of mass, and of changes of volume, as `CellKind.rules` has them."""
    if nodes.is_curved and nodes.kind is TETRAHEDRON:
        return CURVED_TETRAHEDRA
    return nodes.kind.rule(nodes.degree)


def gradients_at(nodes: Nodes, cells: Array, ξ: Array) -> Array:
    """∂N_a/∂X_j (P, A, 3), 1/m, at places ξ (P, 3) of the reference cell, in cells (P,)."""
    _, slopes = nodes.kind.shapes(nodes.degree, ξ)
    jacobian = np.einsum("pak,paj->pkj", slopes, nodes.coordinates[nodes.cell_nodes[cells]])  # ∂X_j/∂ξ_k
    gradients: Array = np.einsum("pjk,pak->paj", np.linalg.inv(jacobian), slopes)
    return gradients


def jacobians(nodes: Nodes, cells: Array, quadrature_degree: int) -> tuple[Array, Array, Array]:
    """∂X_j/∂ξ_k (C, Q, k, j) of cells (C,) at the points of a rule, slopes (Q, A, 3) there, and weights (Q,)."""
    _, slopes, weights = tabulate(nodes.kind.name, nodes.degree, quadrature_degree)
    return np.einsum("qak,caj->cqkj", slopes, nodes.coordinates[nodes.cell_nodes[cells]]), slopes, weights


def strain_points(nodes: Nodes, cells: Array) -> tuple[Array, Array]:
    """∂N_a/∂X_j (C, Q, A, 3), 1/m, and weights (C, Q), m³, at the points of stiffness of cells (C,)."""
    jacobian, slopes, weights = jacobians(nodes, cells, quadrature_rule(nodes)[0])
    return np.einsum("cqjk,qak->cqaj", np.linalg.inv(jacobian), slopes), np.linalg.det(jacobian) * weights


def dilation_points(nodes: Nodes, gradients: Array, weights: Array) -> tuple[Array, Array]:
    """The same at fewer points G, for changes of volume alone: means over the cell, weighed by shape functions of them.

    Of one point that is the mean over the cell (Nagtegaal, Parks & Rice, 1974), which on boxes is the value in the
    middle; of eight the projection on their trilinear shape functions. So an even strain stays one in any cell.

    Args:
        nodes: of the cells.
        gradients, weights: of `strain_points`.
    """
    of_strain, _, of_dilation = quadrature_rule(nodes)
    at, coarse = (points_of_rule(nodes.kind.name, degree) for degree in (of_strain, of_dilation))
    φ: Array = np.ones((len(at), 1))
    if len(coarse) > 1:
        φ = nodes.kind.shapes(1, at)[0] @ np.linalg.inv(nodes.kind.shapes(1, coarse)[0])
    volumes = weights @ φ
    return np.einsum("cq,qg,cqaj->cgaj", weights, φ, gradients) / volumes[..., None, None], volumes


def cell_volumes(nodes: Nodes) -> Array:
    """Volumes (C,) of all cells, m³."""
    if nodes.is_straight:
        return signed_volumes(nodes.coordinates, nodes.cells)
    jacobian, _, weights = jacobians(nodes, np.arange(len(nodes.cells)), quadrature_rule(nodes)[1])
    volumes: Array = np.linalg.det(jacobian) @ weights
    return volumes


def checked_nodes(mesh: Mesh, degree: int) -> Nodes:
    """The nodes of a mesh, of which no cell is inside out at a point of quadrature.

    Raises:
        MeshError: some are; with how many, and where the worst is.
    """
    nodes = canonical_nodes(mesh, degree)
    if nodes.is_straight:
        return nodes  # as `check_filling` has it
    stiffness, mass, _ = quadrature_rule(nodes)
    every = np.arange(len(nodes.cells))
    least, mean = np.full(len(every), np.inf), cell_volumes(nodes)
    for degree in (stiffness, mass):
        jacobian, _, weights = jacobians(nodes, every, degree)
        least = np.minimum(least, np.linalg.det(jacobian).min(axis=1) * weights.sum())
    turned = least <= 0
    if turned.any():
        worst = int((least / np.abs(mean)).argmin())
        place = nodes.coordinates[nodes.cells[worst]].mean(axis=0).round(6).tolist()
        how = ", curved as the file says" if nodes.is_curved else ""
        cure = "; mesh.degree = 1 makes edges straight, and a finer mesh bends them less" if nodes.is_curved else ""
        share = least[worst] / abs(mean[worst])
        raise MeshError(
            f"{nodes.mesh.source}: {turned.sum()} of {len(every)} cells are inside out at points of quadrature{how}, "
            f"the worst around {place}: the Jacobian's determinant there is {share:.3g} of its mean; "
            f"it must be above 0{cure}"
        )
    return nodes


def cell_at(nodes: Nodes, point: Array, where: str) -> tuple[int, Array]:
    """The cell in which a point is, and its place (3,) in the reference cell.

    A point just outside (a marker on a curved surface that the mesh cuts off) is taken to the nearest cell.

    Raises:
        SceneError: it is farther outside.
    """
    cells, ξ, distance = _straight(nodes, point) if nodes.is_straight else _bent(nodes, point)
    nearest = int(distance.argmin())
    size = np.linalg.norm(np.ptp(nodes.coordinates, axis=0))
    if distance[nearest] > 0.01 * size:
        raise SceneError(
            f"{where}: point {point.tolist()} is {distance[nearest]:.3g} m outside the body; "
            f"at most 1 % of its size, {0.01 * size:.3g} m (mesh.scale says in which unit the mesh is)"
        )
    return int(cells[nearest]), ξ[nearest]


def _straight(nodes: Nodes, point: Array) -> tuple[Array, Array, Array]:
    """All tetrahedra (C,), the places (C, 3) in them that are near a point, and their distances (C,) from it, m."""
    corners = nodes.coordinates[nodes.cells]
    edges = np.transpose(corners[:, 1:] - corners[:, :1], (0, 2, 1))
    inner = np.linalg.solve(edges, (point - corners[:, 0])[:, :, None])[:, :, 0]
    barycentric = _within(inner)
    distance = np.linalg.norm(np.einsum("ci,cij->cj", barycentric, corners) - point, axis=1)
    return np.arange(len(corners)), barycentric[:, 1:], distance


def _bent(nodes: Nodes, point: Array) -> tuple[Array, Array, Array]:
    """The same of cells that are near, by Newton's method."""
    places = nodes.coordinates[nodes.cell_nodes]
    low, high = places.min(axis=1), places.max(axis=1)
    off = np.linalg.norm(point - np.clip(point, low, high), axis=1)
    cells = np.argsort(off, kind="stable")[:NEAREST]
    is_simplex, places = nodes.kind is TETRAHEDRON, places[cells]
    ξ = np.tile(nodes.kind.corners.mean(axis=0), (len(cells), 1))
    for _ in range(ITERATIONS):
        values, slopes = nodes.kind.shapes(nodes.degree, ξ)
        miss = point - np.einsum("pa,pai->pi", values, places)
        jacobian = np.einsum("pak,pai->pik", slopes, places)
        change = np.einsum("pki,pi->pk", np.linalg.pinv(jacobian), miss)
        ξ = np.clip(ξ + change, -FAR, 1 + FAR)
        if np.abs(change).max() <= CONVERGED:
            break
    ξ = _within(ξ)[:, 1:] if is_simplex else np.clip(ξ, 0.0, 1.0)
    values, _ = nodes.kind.shapes(nodes.degree, ξ)
    return cells, ξ, np.linalg.norm(np.einsum("pa,pai->pi", values, places) - point, axis=1)


def _within(ξ: Array) -> Array:
    """Barycentric coordinates (P, 4) in the tetrahedron, of the places (P, 3) or near them."""
    barycentric = np.clip(np.column_stack([1 - ξ.sum(axis=1), ξ]), 0, None)
    return barycentric / barycentric.sum(axis=1)[:, None]


def shape_functions(nodes: Nodes, point: Array, where: str) -> Array:
    """Values (N,) of all shape functions at a point; SceneError as of `cell_at`."""
    values = np.zeros(len(nodes.coordinates))
    cell, ξ = cell_at(nodes, point, where)
    of_cell = nodes.kind.shapes(nodes.degree, ξ)[0][0]
    values[nodes.cell_nodes[cell]] = np.where(np.abs(of_cell) > ROUND_OFF, of_cell, 0.0)  # on a face of it alone
    return values
