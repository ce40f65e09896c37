"""Two shapes with flat faces: along which axis they are farthest from overlapping, and where they meet.

The axes are the normals of faces of either, and the crosses of their edges (separating axes). Along the normal of a
face it is the face of the other most against it, clipped to the first: a manifold. Along a cross of edges it is the
pair of points where these are nearest. Where shapes are apart and no axis meets them so, as corner to corner, there is
no pair until they are nearer.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.world.collision.contacts import Contacts, PlacedShape, no_contacts, rigid_contacts
from fenics_rom.world.collision.manifold import MOST, NUMBERS, clip, thinned
from fenics_rom.world.shapes import Cylinder, Polytope

_PREFERRED = 1e-4  # of the size of the smaller: by so much must another axis be better than the one that is preferred
_PARALLEL = 1e-3  # sine between edges that have no cross
_MOST_EDGES = 1 << 10  # of a shape


class PlacedPolytope(NamedTuple):
    """As `PlacedShape`."""

    shape: Polytope
    position: Array
    rotation: Array


class _Edges(NamedTuple):
    corners: Array  # (E, 2)
    directions: Array  # (D, 3), units, those that differ by more than their sign; of a box x, y and z
    direction: Array  # (E,), which of them an edge has


def as_polytope(placed: PlacedShape) -> PlacedPolytope:
    """A shape with flat faces as it is, a cylinder as its prism."""
    shape = placed.shape.prism if isinstance(placed.shape, Cylinder) else placed.shape
    assert isinstance(shape, Polytope)
    return PlacedPolytope(shape, placed.position, placed.rotation)


def polytope_contacts(first: PlacedPolytope, second: PlacedPolytope, margin: float) -> Contacts:
    """Pairs of two shapes with flat faces that are nearer than a margin, m; at most eight, of edges one."""
    a, b = first.shape, second.shape
    axes, gaps = _separating_axes(first, second)
    tolerance = _PREFERRED * min(a.radius_around, b.radius_around)
    of_a, of_b = len(a.normals), len(a.normals) + len(b.normals)
    along, ranking = gaps.tolist(), []
    for begin, end, bonus in ((0, of_a, 2 * tolerance), (of_a, of_b, tolerance), (of_b, len(along), 0.0)):
        gap = max(along[begin:end])
        if gap > margin:
            return no_contacts()
        ranking.append((-gap - bonus, along.index(gap, begin, end)))
    for _, best in sorted(ranking):
        if best < of_a:
            found = _manifold(first, second, best, -1.0, margin)
        elif best < of_b:
            found = _manifold(second, first, best - of_a, 1.0, margin)
        else:
            found = _edge_pair(first, second, axes[best], best - of_b)
        if len(found.gaps):
            break
    return found


def _separating_axes(first: PlacedPolytope, second: PlacedPolytope) -> tuple[Array, Array]:
    """Normals from the second to the first, of the faces of both and of crosses of their edges, and gaps along them."""
    edges_a, edges_b = _edges_of(first.shape), _edges_of(second.shape)
    of_a, of_b = (placed.shape.normals.dot(placed.rotation.T) for placed in (first, second))
    along_a, along_b = edges_a.directions.dot(first.rotation.T), edges_b.directions.dot(second.rotation.T)
    crosses = np.cross(along_a[:, None], along_b[None]).reshape(-1, 3)
    sines = np.linalg.norm(crosses, axis=1)
    parallel = sines < _PARALLEL
    crosses /= np.where(parallel, 1.0, sines)[:, None]
    axes = np.concatenate([-of_a, of_b, crosses])
    a, b = (axes.dot(_corners(placed).T) for placed in (first, second))
    gaps, other_way = a.min(axis=1) - b.max(axis=1), b.min(axis=1) - a.max(axis=1)
    turned = other_way > gaps
    turned[: len(of_a) + len(of_b)] = False  # faces look outwards
    axes[turned] *= -1
    gaps = np.where(turned, other_way, gaps)
    gaps[len(of_a) + len(of_b) :][parallel] = -np.inf
    return axes, gaps


def _manifold(reference: PlacedPolytope, other: PlacedPolytope, face: int, side: float, margin: float) -> Contacts:
    """The face of `other` that is most against a face of `reference`, clipped to it.

    `side`: 1 where the normal of contact is the face's, -1 where it is against it.
    """
    shape, rotation = reference.shape, reference.rotation
    normal = rotation.dot(shape.normals[face])
    against = int(other.shape.normals.dot(normal.dot(other.rotation)).argmin())
    fixed = shape.vertices[shape.loops[face]].dot(rotation.T) + reference.position
    moving = other.shape.vertices[other.shape.loops[against]].dot(other.rotation.T) + other.position
    places, distances, labels = clip(fixed.tolist(), moving.tolist(), normal.tolist(), margin)
    if not labels:
        return no_contacts()
    gaps = np.array(distances)
    middle = np.array(places) - (gaps / 2)[:, None] * normal
    feature = np.array(labels) + ((face << 8 | against) << 1 | (side > 0)) * NUMBERS
    normals = np.empty(middle.shape)
    normals[:] = side * normal
    if len(gaps) > MOST:
        kept = thinned(middle, gaps, normal)
        middle, normals, gaps, feature = middle[kept], normals[kept], gaps[kept], feature[kept]
    return rigid_contacts(middle, normals, gaps, feature)


def _edge_pair(first: PlacedPolytope, second: PlacedPolytope, normal: Array, cross: int) -> Contacts:
    """The nearest points of two edges, which are the farthest along the normal of all with their directions."""
    edges_a, edges_b = _edges_of(first.shape), _edges_of(second.shape)
    i, j = divmod(cross, len(edges_b.directions))
    ends = []
    numbers = []
    for placed, edges, direction, sign in ((first, edges_a, i, -1.0), (second, edges_b, j, 1.0)):
        corners = _corners(placed)
        own = np.flatnonzero(edges.direction == direction)
        best = own[(sign * corners.dot(normal))[edges.corners[own]].sum(axis=1).argmax()]
        ends.append(corners[edges.corners[best]])
        numbers.append(int(best))
    (p, p_end), (q, q_end) = ends
    u, v, w = p_end - p, q_end - q, p - q
    uu, uv, vv, uw, vw = u.dot(u), u.dot(v), v.dot(v), u.dot(w), v.dot(w)
    sine = uu * vv - uv * uv
    on_a, on_b = p + (uv * vw - vv * uw) / sine * u, q + (uu * vw - uv * uw) / sine * v
    gap = float((on_a - on_b).dot(normal))
    feature = -1 - (numbers[0] * _MOST_EDGES + numbers[1])
    return rigid_contacts((on_a + on_b)[None] / 2, normal[None], np.array([gap]), np.array([feature]))


def _corners(placed: PlacedPolytope) -> Array:
    return placed.shape.vertices.dot(placed.rotation.T) + placed.position


@lru_cache(maxsize=256)
def _edges_of(shape: Polytope) -> _Edges:
    ends = np.concatenate([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in shape.loops])
    corners = np.unique(np.sort(ends, axis=1), axis=0)
    along = shape.vertices[corners[:, 1]] - shape.vertices[corners[:, 0]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    same = np.abs(along @ along.T) > 1 - 1e-12
    firsts, direction = np.unique(same.argmax(axis=1), return_inverse=True)
    return _Edges(corners, along[firsts], direction)
