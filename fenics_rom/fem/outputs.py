"""Displacements that are read by name: of points, of surfaces, and of markers that stand off the surface."""

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.fem.cell_points import shape_functions
from fenics_rom.fem.facets import mean_over
from fenics_rom.fem.nodes import Nodes
from fenics_rom.fem.places import patch_triangles
from fenics_rom.mechanics.readings import MarkerReading
from fenics_rom.mechanics.triangles import nearest_on_triangles
from fenics_rom.scene.outputs import Output
from fenics_rom.system.body import Unknowns

SAME_DISTANCE = 1e-9  # share of the body's size by which triangles may differ and be equally near
SIDES = ((0, 1), (1, 2), (2, 0))  # of a triangle, in the order of its mid-side nodes


def marker_reading(nodes: Nodes, place: Array, unknowns: Unknowns, where: str) -> MarkerReading:
    """A marker whose middle is at a place (3,), m, at rest, of the unknowns.

    Its foot is the nearest point of the surface; of several triangles that are equally near, the first.

    Raises:
        SceneError: it is farther from the body than the body is large.
    """
    corners = nodes.coordinates[nodes.surface]
    weights, feet = nearest_on_triangles(np.broadcast_to(place, (len(corners), 3)), corners)
    distances, size = np.linalg.norm(feet - place, axis=1), float(np.linalg.norm(np.ptp(nodes.coordinates, axis=0)))
    if distances.min() > size:
        raise SceneError(
            f"{where}: {place.tolist()} is {distances.min():.3g} m from the body; at most its size, {size:.3g} m "
            "(mesh.scale says in which unit the mesh is)"
        )
    facet = int(np.argmax(distances <= distances.min() + SAME_DISTANCE * size))
    a, b, c = corners[facet]
    sides = np.stack([b - a, c - a], axis=1)
    first = sides[:, 0] / np.linalg.norm(sides[:, 0])
    normal = np.cross(sides[:, 0], sides[:, 1])
    tangents = np.stack([first, np.cross(normal / np.linalg.norm(normal), first)])
    of_corners = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]) @ np.linalg.pinv(sides) @ tangents.T  # (3, 2), ∂λ/∂t
    values, slopes = weights[facet], of_corners
    if len(nodes.edges):
        λ = values[:, None]
        i, j = np.array(SIDES).T
        values = np.concatenate([λ * (2 * λ - 1), 4 * λ[i] * λ[j]])[:, 0]
        slopes = np.concatenate([(4 * λ - 1) * of_corners, 4 * (λ[i] * of_corners[j] + λ[j] * of_corners[i])])
    carriers = nodes.triangle_nodes(nodes.surface[[facet]])[0]
    of_one_component = scipy.sparse.csr_matrix(
        (np.vstack([values, slopes.T]).ravel(), (np.repeat(range(3), len(carriers)), np.tile(carriers, 3))),
        shape=(3, len(nodes.coordinates)),
    )
    operator = scipy.sparse.kron(of_one_component, np.eye(3), format="csr")
    return MarkerReading((operator @ unknowns.matrix).tocsr(), tangents, place - feet[facet])


def output_rows(nodes: Nodes, output: Output, unknowns: Unknowns, where: str) -> Array:
    """Cᵀ of an output on the unknowns, (n, 3 points); a surface is one point, its mean; markers turn little."""
    if output.markers is not None:
        markers = [marker_reading(nodes, np.array(place), unknowns, f"{where}.markers") for place in output.markers]
        return np.hstack([marker.operator.T @ marker.small_motion.T for marker in markers])
    if output.points is not None:
        weights = np.stack([shape_functions(nodes, np.array(point), where) for point in output.points], axis=1)
    else:
        weights = mean_over(nodes, patch_triangles(nodes, output, where))[:, None]
    return unknowns.restrict(np.kron(weights, np.eye(3)))
