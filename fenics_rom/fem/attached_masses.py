"""What is fixed to a body and has mass of its own: its part of M and of the weight, of all displacements of the nodes.

A mass at a point is carried by the nodes of its cell, by their shape functions w: m w wᵀ. A rigid part is carried by
the mean displacement ū of its surface and the mean H̄ of ∂u/∂X in the cells behind it, so that what was at X + d is at
X + d + ū + H̄ d. With the weights w of its centre and g_j of ∂u/∂X_j, all of one component of u, that is

    m w wᵀ + Σ S_jk g_j g_kᵀ,   S = ½ tr(I) 1 - I

the same for every component, and constant however far it turns: of a turn, F̄ = 1 + H̄ = R, it is the rigid body's
½ m v² + ½ ωᵀ R I Rᵀ ω.
"""

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.cell_points import shape_functions
from fenics_rom.fem.facets import mean_over, surface_mass
from fenics_rom.fem.nodes import Nodes, triangle_areas
from fenics_rom.fem.places import patch_triangles
from fenics_rom.fem.readings import surface_gradients
from fenics_rom.scene.effects import PointMass, RigidPart
from fenics_rom.scene.scene import Scene

FARTHEST = 10.0  # sizes of the body that the centre of a rigid part may be off: beyond, it is in another unit


def attached_masses(scene: Scene, nodes: Nodes) -> tuple[scipy.sparse.csr_matrix | None, Array]:
    """What is fixed to the body adds to M, of all displacements (3 N, 3 N), and to its weight at each node (N,), kg.

    Raises:
        MeshError, SceneError: a place that does not exist.
    """
    parts, weight = [], np.zeros(len(nodes.coordinates))
    for name, fixed in scene.effects.point_masses.items():
        share, along = _share_of_nodes(nodes, fixed, f"effects.point_masses.{name}"), np.eye(3)
        if fixed.direction is not None:
            n = np.array(fixed.direction) / np.linalg.norm(fixed.direction)
            along = np.outer(n, n)
        parts.append(scipy.sparse.kron(fixed.mass * share, along, format="csr"))
        weight += fixed.mass * np.asarray(share.sum(axis=1)).ravel()
    for name, part in scene.effects.rigid_parts.items():
        centre, gradient = _carried(nodes, part, f"effects.rigid_parts.{name}")
        inertia = np.diag(part.inertia)
        S = np.trace(inertia) / 2 * np.eye(3) - inertia
        share = part.mass * centre @ centre.T + gradient @ S @ gradient.T
        parts.append(scipy.sparse.kron(scipy.sparse.csr_matrix(share), np.eye(3), format="csr"))
        weight += part.mass * centre.toarray()[:, 0]
    return sum(parts[1:], parts[0]) if parts else None, weight


def _share_of_nodes(nodes: Nodes, fixed: PointMass, where: str) -> scipy.sparse.csr_matrix:
    """Of 1 kg at a point, or spread over a surface, (N, N)."""
    if fixed.point is None:
        return surface_mass(nodes, patch_triangles(nodes, fixed, where))
    w = scipy.sparse.csr_matrix(shape_functions(nodes, np.array(fixed.point), where)).T
    return w @ w.T


def _carried(nodes: Nodes, part: RigidPart, where: str) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
    """Weights of the centre of a rigid part, (N, 1), and of the mean gradient at its surface, (N, 3), 1/m."""
    facets = patch_triangles(nodes, part, where)
    drawn, operator, _ = surface_gradients(nodes, facets)
    area = triangle_areas(nodes, nodes.surface)[drawn % len(nodes.surface)]
    mean = scipy.sparse.kron(scipy.sparse.identity(3), area / area.sum())
    gradient = (mean @ operator[: 3 * len(drawn), ::3]).T.tocsr()  # of u_x; those of u_y and u_z are the same
    over = mean_over(nodes, facets)
    arm = np.array(part.center) - over @ nodes.coordinates
    farthest = FARTHEST * float(np.linalg.norm(np.ptp(nodes.coordinates, axis=0)))
    if np.linalg.norm(arm) > farthest:
        raise SceneError(
            f"{where}.center = {list(part.center)}: is {np.linalg.norm(arm):.3g} m from its surface; at most "
            f"{FARTHEST:g} sizes of the body, {farthest:.3g} m (mesh.scale says in which unit the mesh is)"
        )
    return scipy.sparse.csr_matrix(over[:, None]) + gradient @ scipy.sparse.csr_matrix(arm[:, None]), gradient
