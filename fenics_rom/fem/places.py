"""Which triangles of the surface, nodes and cells a scene's places pick; the same on every rank.

Of triangles and cells the centroid counts, of nodes they themselves.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import MeshError, SceneError
from fenics_rom.fem.chambers import OPEN_SHARE
from fenics_rom.fem.facets import surface_area
from fenics_rom.fem.mesh import Mesh
from fenics_rom.fem.nodes import Nodes, area_vectors, face_keys
from fenics_rom.scene.places import CellPlace, Held, Place, given_piece

SAME_PLACE = 1e-6  # share of the body's length within which something is in a plane, in a box or on a line
SAME_POINT = 1e-6  # share of the size of the body within which a node is at a point


class _Pickable(NamedTuple):
    """What places pick some of."""

    kind: str
    located: str  # how a message says where one is
    points: Array  # (P, 3), m, which say where each is
    length: float  # m, of the body
    pick: Callable[[Place | CellPlace, str, str], Array]  # whether it is in a place (P,), by another of its keys


def patch_triangles(nodes: Nodes, place: Place, where: str) -> Array:
    """Outward triangles of the surface (F, 3) that a place picks, between canonical vertices.

    Raises:
        MeshError, SceneError: a surface does not exist, or nothing is picked.
    """
    return nodes.surface[_facets(nodes, place, where)]


def patch_nodes(nodes: Nodes, place: Place, where: str) -> Array:
    """All nodes of the triangles that a place picks, ascending."""
    return np.unique(nodes.triangle_nodes(patch_triangles(nodes, place, where)))


def patch_area(nodes: Nodes, place: Place, where: str) -> float:
    """Area of the triangles that a place picks, m²."""
    return surface_area(nodes, patch_triangles(nodes, place, where))


def held_nodes(nodes: Nodes, place: Place, where: str) -> Array:
    """The nodes that a support holds, ascending.

    Those of named surfaces, also inside the body; those that are in a box or along a line, and the one at a point;
    else those of the triangles that the place picks.

    Raises:
        MeshError, SceneError: a surface does not exist, or nothing is picked.
    """
    if isinstance(place, Held) and place.point is not None:
        return _node_at(nodes, np.array(place.point), where)
    count = len(nodes.coordinates)

    def pick(one: Place | CellPlace, piece: str, at: str) -> Array:
        assert isinstance(one, Place)
        of_surface = _nodes_of_surface(nodes, one.surface) if one.surface is not None else patch_nodes(nodes, one, at)
        return np.isin(np.arange(count), of_surface)

    return np.flatnonzero(_pick(place, _Pickable("node", "is", nodes.coordinates, _length(nodes), pick), where))


def picked_cells(mesh: Mesh, place: CellPlace, where: str) -> Array:
    """Whether a place picks each cell of the mesh file, (C,).

    Raises:
        MeshError, SceneError: a group does not exist, or nothing is picked.
    """
    corners = mesh.points[mesh.cells]

    def pick(one: Place | CellPlace, piece: str, at: str) -> Array:
        return np.isin(np.arange(len(mesh.cells)), mesh.region(getattr(one, piece)))

    length = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    return _pick(place, _Pickable("cell", "has its centroid", corners.mean(axis=1), length, pick), where)


def cells_of(place: CellPlace, mesh: Mesh, where: str) -> Array | slice:
    """Those that a material has: whether each of the mesh file is one, (C,), or all where it names none."""
    return slice(None) if given_piece(place) is None else picked_cells(mesh, place, where)


def _facets(nodes: Nodes, place: Place, where: str) -> Array:
    """Whether a place picks each triangle of the surface, (F,): of a quadrilateral both halves, or none."""
    centroids = nodes.facet_centroids

    def pick(one: Place | CellPlace, piece: str, at: str) -> Array:
        assert isinstance(one, Place)
        of_piece = {"surface": _named, "plane": _in_plane, "facing": _facing, "inner": _inner}[piece]
        return nodes.whole_facets(of_piece(nodes, one, at))

    facets = _Pickable("surface triangle", "has its centroid", centroids, _length(nodes), pick)
    return _pick(place, facets, where)


def _pick(place: Place | CellPlace, among: _Pickable, where: str) -> Array:
    """Whether a place picks each, (P,)."""
    piece = given_piece(place)
    assert piece is not None
    if piece in ("all", "any", "none"):
        parts = np.array([_pick(part, among, f"{where}.{piece}[{k}]") for k, part in enumerate(getattr(place, piece))])
        picked: Array = parts.all(axis=0) if piece == "all" else parts.any(axis=0)
        picked = ~picked if piece == "none" else picked
        if not picked.any():
            counts = ", ".join(str(count) for count in parts.sum(axis=1))
            raise SceneError(
                f"{where}.{piece}: no {among.kind} is in {piece} of its places, which pick {counts} of {parts.shape[1]}"
            )
        return picked
    if place.near is not None and among.kind != "node":
        distance, reach = np.linalg.norm(among.points - place.near.point, axis=1), place.near.radius
        wanted, off = f".near.radius = {reach:g}", f"that close to {list(place.near.point)}"
    elif place.box is not None:
        low, high = np.sort(np.array(place.box.corners), axis=0)
        distance = np.linalg.norm(among.points - np.clip(among.points, low, high), axis=1)
        reach, wanted, off = SAME_PLACE * among.length, ".box", "in it"
    elif place.along is not None:
        distance = _from_line(among.points, np.array(place.along.points))
        reach = place.along.radius or SAME_PLACE * among.length
        wanted, off = ".along", f"within {reach:.3g} m of the line"
    else:
        return among.pick(place, piece, where)
    if not (distance <= reach).any():
        raise SceneError(
            f"{where}{wanted}: no {among.kind} {among.located} {off}; the nearest is {distance.min():.4g} m away, at "
            f"{among.points[distance.argmin()].round(9).tolist()}"
        )
    return distance <= reach


def _from_line(points: Array, line: Array) -> Array:
    """Distances (P,), m, of points (P, 3) from a line of straight pieces through (K, 3)."""
    nearest = np.full(len(points), np.inf)
    for start, along in zip(line, np.diff(line, axis=0), strict=False):
        square = max(along @ along, np.finfo(float).tiny)
        share = np.clip((points - start) @ along / square, 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - start - share[:, None] * along, axis=1))
    return nearest


def _length(nodes: Nodes) -> float:
    return float(np.ptp(nodes.coordinates, axis=0).max())


def _named(nodes: Nodes, place: Place, where: str) -> Array:
    """Of a named surface; refuses one that is not on the boundary."""
    name = str(place.surface)
    given, boundary = face_keys(nodes, nodes.vertices(nodes.mesh.surface(name))), face_keys(nodes, nodes.surface)
    _refuse_stray(nodes, name, ~np.isin(given, boundary), "on the boundary of the body")
    return np.isin(boundary, given)


def _nodes_of_surface(nodes: Nodes, name: str) -> Array:
    """All nodes of a named surface, inside the body or on its boundary; refuses one that is not of faces of cells."""
    triangles = nodes.vertices(nodes.mesh.surface(name))
    faces = nodes.kind.triangles(nodes.cells)[0].reshape(-1, 3)
    is_stray = ~np.isin(face_keys(nodes, triangles), face_keys(nodes, faces))
    _refuse_stray(nodes, name, is_stray, "faces of the cells")
    return np.unique(nodes.triangle_nodes(triangles))


def _refuse_stray(nodes: Nodes, name: str, is_stray: Array, allowed: str) -> None:
    if is_stray.any():
        count = f"{is_stray.sum()} of its {len(is_stray)} triangles"
        raise MeshError(f"{nodes.mesh.source}: surface {name!r}: {count} are not {allowed}")


def _in_plane(nodes: Nodes, place: Place, where: str) -> Array:
    plane = place.plane
    assert plane is not None
    reach = plane.distance or SAME_PLACE * _length(nodes)
    normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
    off = np.abs((nodes.coordinates[nodes.surface] - plane.point) @ normal).max(axis=1)
    if not (off <= reach).any():
        raise SceneError(
            f"{where}.plane: no surface triangle is within {reach:.3g} m of the plane through {list(plane.point)} with "
            f"normal {list(plane.normal)}; the nearest has a corner {off.min():.4g} m off"
        )
    return off <= reach


def _facing(nodes: Nodes, place: Place, where: str) -> Array:
    facing = place.facing
    assert facing is not None
    normals, direction = area_vectors(nodes, nodes.surface), np.array(facing.direction)
    cosine = normals @ direction / (np.linalg.norm(normals, axis=1) * np.linalg.norm(direction))
    angles = np.arccos(np.clip(cosine, -1.0, 1.0))
    if not (angles <= facing.angle).any():
        raise SceneError(
            f"{where}.facing.angle = {facing.angle:g}: no surface triangle looks that close to "
            f"{list(facing.direction)}; the nearest is {angles.min():.4g} rad off"
        )
    return angles <= facing.angle


def _inner(nodes: Nodes, place: Place, where: str) -> Array:
    inner, hollows = nodes.chambers
    if not place.inner:
        return ~inner
    if not inner.any():
        found = "the surface has no hollow"
        if hollows:
            least = min(hollows, key=lambda hollow: hollow.open_share)
            found = (
                f"of its {len(hollows)} hollows the least open, around {least.middle.round(9).tolist()}, has "
                f"{least.open_share:.2g} of what its walls see open; at most {OPEN_SHARE:g}"
            )
        raise SceneError(f"{where}.inner: the body has no chamber: {found}")
    return inner


def _node_at(nodes: Nodes, point: Array, where: str) -> Array:
    distance = np.linalg.norm(nodes.coordinates - point, axis=1)
    nearest = int(distance.argmin())
    if distance[nearest] > SAME_POINT * np.linalg.norm(np.ptp(nodes.coordinates, axis=0)):
        raise SceneError(
            f"{where}.point = {point.tolist()}: no node of the mesh is there; the nearest is at "
            f"{nodes.coordinates[nearest].round(9).tolist()}, {distance[nearest]:.3g} m away"
        )
    return np.array([nearest])
