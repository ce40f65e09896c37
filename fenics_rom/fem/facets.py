"""Integrals over the surface: of shape functions, of these times the normal, and of products of two.

Triangles of straight tetrahedra have closed forms. Faces of hexahedra, and curved ones, are integrated by quadrature.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.fem.cell_kinds import tabulate
from fenics_rom.fem.nodes import Nodes, area_vectors, face_keys, triangle_areas

QUADRATURE = 6  # degree of polynomials: exact for shape functions times normals, but for triple products of degree 2
CORNERS = [0, 1, 3, 2]  # of a face of four, from around it to basix' order


class FacetIntegrals(NamedTuple):
    """Of the shape function φ of each node of faces."""

    carriers: Array  # (Q, B) nodes
    shares: Array  # (Q, B) ∫ φ dA, m²
    vectors: Array  # (Q, B, 3) ∫ φ n dA with the outward normal n, m²


def facet_integrals(nodes: Nodes, triangles: Array) -> FacetIntegrals:
    """Over triangles (F, 3) of the surface.

    Of straight tetrahedra of degree 1 a third of the area at each vertex; of degree 2 nothing at the vertices, a third
    at each mid-side node.
    """
    if nodes.is_straight:
        carriers = nodes.triangle_edges(triangles) if len(nodes.edges) else triangles
        share = np.broadcast_to(triangle_areas(nodes, triangles)[:, None] / 3, carriers.shape)
        normals = area_vectors(nodes, triangles)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        return FacetIntegrals(carriers, share, share[:, :, None] * normals[:, None])
    carriers, _ = facet_nodes(nodes, triangles)
    φ, weights, normals = _at_points(nodes, carriers)
    areas = np.linalg.norm(normals, axis=2)
    shares = np.einsum("q,qb,fq->fb", weights, φ, areas)
    return FacetIntegrals(carriers, shares, np.einsum("q,qb,fqi->fbi", weights, φ, normals))


def mean_over(nodes: Nodes, triangles: Array) -> Array:
    """Weights (N,) whose product with nodal values is their mean over a surface."""
    of = facet_integrals(nodes, triangles)
    mean = np.zeros(len(nodes.coordinates))
    np.add.at(mean, of.carriers, of.shares)
    return mean / mean.sum()


def surface_area(nodes: Nodes, triangles: Array) -> float:
    """Of triangles (F, 3) of the surface, m²."""
    return float(facet_integrals(nodes, triangles).shares.sum())


def volume_within_surface(nodes: Nodes, triangles: Array, origin: Array) -> float:
    """Between triangles (F, 3) of the surface and a place (3,), m³: ∫ (x - origin)·n dA/3."""
    if nodes.is_straight:
        return float(np.linalg.det(nodes.coordinates[triangles] - origin).sum()) / 6
    facets, _ = facet_nodes(nodes, triangles)
    φ, weights, normals = _at_points(nodes, facets)
    places = np.einsum("qb,fbi->fqi", φ, nodes.coordinates[facets]) - origin
    return float(np.einsum("q,fqi,fqi->", weights, places, normals)) / 3


def surface_mass(nodes: Nodes, triangles: Array, weights: Array | None = None) -> scipy.sparse.csr_matrix:
    """∫ w φ_i φ_j over a surface, as a share of its area, (N, N); w (F,) of its triangles is 1 unless given."""
    if nodes.is_straight:
        area = triangle_areas(nodes, triangles)
        if len(nodes.edges):
            opposite = -4 * np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
            element = np.block([[7 * np.eye(3) - 1, opposite], [opposite.T, 16 * (np.eye(3) + 1)]]) / 180
        else:
            element = (np.eye(3) + 1) / 12
        ends, share = nodes.triangle_nodes(triangles), area / area.sum() * (1.0 if weights is None else weights)
        values = share[:, None, None] * element
    else:
        ends, of_triangles = facet_nodes(nodes, triangles)
        φ, at, normals = _at_points(nodes, ends)
        areas = np.linalg.norm(normals, axis=2) * at
        values = np.einsum("fq,qa,qb->fab", areas / areas.sum(), φ, φ)
        if weights is not None:
            values *= weights[of_triangles].mean(axis=1)[:, None, None]
    count = ends.shape[1]
    rows, columns = np.repeat(ends, count, axis=1), np.tile(ends, count)
    entries = values.ravel(), (rows.ravel(), columns.ravel())
    return scipy.sparse.csr_matrix(entries, shape=2 * (len(nodes.coordinates),))


def contact_facets(nodes: Nodes, triangles: Array) -> tuple[Array, Array]:
    """Nodes (Q, B) of the faces that triangles (F, 3) are of, and their areas (Q,), m², as `FacetShares` takes them."""
    areas = triangle_areas(nodes, triangles)
    if nodes.kind.facet == "triangle":
        return nodes.triangle_nodes(triangles), areas
    facets, halves = facet_nodes(nodes, triangles)
    return facets, areas[halves].sum(axis=1)


def facet_nodes(nodes: Nodes, triangles: Array) -> tuple[Array, Array]:
    """Nodes (Q, B) of the faces that triangles (F, 3) are of, in basix' order, and which triangles (Q, H) each has."""
    if nodes.kind.facet == "triangle":
        of_sides = np.roll(nodes.triangle_edges(triangles), -1, axis=1) if len(nodes.edges) else triangles[:, :0]
        return np.hstack([triangles, of_sides]), np.arange(len(triangles))[:, None]
    keys, order = face_keys(nodes, triangles), np.argsort(face_keys(nodes, triangles))
    first, second = (face_keys(nodes, half) for half in np.split(nodes.surface, 2))
    rows = np.flatnonzero(np.isin(first, keys))
    pairs = np.stack([order[np.searchsorted(keys[order], half[rows])] for half in (first, second)], axis=1)
    corners = np.column_stack([nodes.surface[rows], nodes.surface[rows + len(first), 1]])[:, CORNERS]
    if not len(nodes.edges):
        return corners, pairs
    ends = corners[:, [(0, 1), (0, 2), (1, 3), (2, 3), (0, 3)]]
    return np.hstack([corners, nodes.on_edges(ends)]), pairs


def _at_points(nodes: Nodes, facets: Array) -> tuple[Array, Array, Array]:
    """Shape functions (P, B) and weights (P,) at the points of the rule, and normals times area (Q, P, 3), m²."""
    degree = 2 if len(nodes.edges) else 1
    φ, gradients, weights = tabulate(nodes.kind.facet, degree, QUADRATURE)
    tangents = np.einsum("pbt,fbi->tfpi", gradients, nodes.coordinates[facets])
    return φ, weights, np.cross(*tangents)
