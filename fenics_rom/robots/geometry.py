"""Shapes of links: what touches, and what is seen."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError
from fenics_rom.mechanics.frame_motion import quaternion_of
from fenics_rom.robots.records import Visual
from fenics_rom.world.records import UPRIGHT
from fenics_rom.world.shapes import Box, Capsule, Cylinder, HalfSpace, Hull, Shape, Sphere

PLANE, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = 0, 2, 3, 4, 5, 6, 7
FEWER = 100  # corners of the hull of a mesh, at most
GOLDEN = np.pi * (3 - 5**0.5)


class LinkShape(NamedTuple):
    """Of a link."""

    shape: Shape | None
    position: Array  # from the centre of mass, in the axes of the link, m
    rotation: Array | tuple[float, ...]
    said: str  # what is to be told of it


class StaticShape(NamedTuple):
    """Of what stands still, in the axes of the base."""

    body: int
    shape: Shape
    position: Array
    rotation: Array  # (3, 3)


def link_shape(m: Any, d: Any, geoms: Sequence[int], centre: Array, R: Array, where: str) -> LinkShape:
    """The shape of what touches of a link with a centre of mass and axes R: a primitive, or the hull of all."""
    if not geoms:
        return LinkShape(None, np.zeros(3), UPRIGHT, "")
    if len(geoms) == 1 and (shape := _primitive(m, geoms[0], where)) is not None:
        place, turn = R.T.dot(d.geom_xpos[geoms[0]] - centre), R.T.dot(d.geom_xmat[geoms[0]].reshape(3, 3))
        return LinkShape(shape, place, quaternion_of(turn), "")
    points = np.concatenate([(_points(m, d, g, where) - centre).dot(R) for g in geoms])
    hull, fewer = _hull(points)
    said = f"touches by the hull of its {len(geoms)} shapes" if len(geoms) > 1 else ""
    if fewer:
        said += f"{', ' if said else ''}of which {len(hull.vertices)} corners are kept: {fewer:.2g} m are lost"
    return LinkShape(hull, hull.shift, UPRIGHT, said)


def static_shapes(m: Any, d: Any, geoms: Sequence[int], where: object) -> list[StaticShape]:
    """Those of what stands still, each by itself."""
    found = []
    for g in geoms:
        body, R = int(m.geom_bodyid[g]), d.geom_xmat[g].reshape(3, 3)
        if m.geom_type[g] == PLANE:
            found.append(StaticShape(body, HalfSpace(), d.geom_xpos[g].copy(), R.copy()))
        elif (shape := _primitive(m, g, str(where))) is not None:
            found.append(StaticShape(body, shape, d.geom_xpos[g].copy(), R.copy()))
        else:
            hull, _ = _hull(_points(m, d, g, str(where)))
            found.append(StaticShape(body, hull, hull.shift, np.eye(3)))
    return found


def visuals_of(m: Any, d: Any, geoms: Sequence[int], centre: Array, R: Array) -> list[Visual]:
    """What is only seen of a link."""
    seen = []
    for g in geoms:
        if m.geom_type[g] == MESH:
            vertices, triangles = _mesh(m, m.geom_dataid[g])
        elif (shape := _primitive(m, g, "")) is not None:
            vertices, triangles = shape.surface()
        else:
            continue
        placed = d.geom_xpos[g] + vertices.dot(d.geom_xmat[g].reshape(3, 3).T)
        seen.append(Visual((placed - centre).dot(R), triangles, m.geom_rgba[g].astype(float)))
    return seen


def _primitive(m: Any, g: int, where: str) -> Shape | None:
    """None of a mesh or an ellipsoid."""
    kind, size = m.geom_type[g], m.geom_size[g].tolist()
    if kind == SPHERE:
        return Sphere(size[0])
    if kind == CAPSULE:
        return Capsule(size[0], 2 * size[1])
    if kind == CYLINDER:
        return Cylinder(size[0], 2 * size[1])
    if kind == BOX:
        return Box([2 * each for each in size])
    if kind in (MESH, ELLIPSOID):
        return None
    raise SceneError(
        f"{where}: geom {m.geom(g).name or g}: is a plane, height field or sdf: use another shape on a link"
    )


def _mesh(m: Any, mesh: int) -> tuple[Array, Array]:
    begin, count = m.mesh_vertadr[mesh], m.mesh_vertnum[mesh]
    first, faces = m.mesh_faceadr[mesh], m.mesh_facenum[mesh]
    return m.mesh_vert[begin : begin + count].astype(float), m.mesh_face[first : first + faces].astype(np.int64)


def _points(m: Any, d: Any, g: int, where: str) -> Array:
    """Of a geom, in the axes of the base, (any, 3)."""
    if m.geom_type[g] == MESH:
        points, _ = _mesh(m, m.geom_dataid[g])
    elif m.geom_type[g] == ELLIPSOID:
        points = _directions(FEWER) * m.geom_size[g]
    else:
        shape = _primitive(m, g, where)
        assert shape is not None
        points, _ = shape.surface()
    placed: Array = d.geom_xpos[g] + points.dot(d.geom_xmat[g].reshape(3, 3).T)
    return placed


def _hull(points: Array) -> tuple[Hull, float]:
    """The hull of points, of few corners; and how far, at most, others are outside of it, m."""
    points = np.unique(points.round(9), axis=0)
    if len(points) <= FEWER:
        return Hull(points.tolist()), 0.0
    kept, middle = np.empty(0, dtype=int), points.mean(axis=0)
    for count in (4 * FEWER, 2 * FEWER, FEWER - 6):
        ways = np.concatenate([np.eye(3), -np.eye(3), _directions(count)])
        kept = np.unique((points - middle).dot(ways.T).argmax(axis=0))
        if len(kept) <= FEWER:
            break
    hull = Hull(points[kept].tolist())
    away, _ = hull.distance(points - hull.shift)
    return hull, max(float(away.max()), 0.0)


def _directions(count: int) -> Array:
    """Units that are spread evenly, (count, 3)."""
    z, turn = 1 - (2 * np.arange(count) + 1) / count, GOLDEN * np.arange(count)
    out = np.sqrt(1 - z * z)
    return np.stack([out * np.cos(turn), out * np.sin(turn), z], axis=1)
