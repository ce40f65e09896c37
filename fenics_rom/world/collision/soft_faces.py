"""Faces of soft bodies between their points: what sticks out of rigid shapes meets them, and sharp edges of others."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_faces import DEEPEST, BodyFaces, Places
from fenics_rom.mechanics.obstacle_outline import Outline
from fenics_rom.mechanics.placed_surface import PlacedSurface
from fenics_rom.world.collision.contacts import Contacts, PlacedShape, Spots
from fenics_rom.world.collision.manifold import MOST, thinned

_ONES = np.ones(3)


def faces_on_rigid(surface: PlacedSurface, faces: BodyFaces, rigid: PlacedShape, margin: float) -> Contacts:
    """Corners and edges of a shape that are nearer than a margin, m, to faces of a surface."""
    shape, places = rigid.shape, surface.points - rigid.position
    squares = np.square(places).dot(_ONES)
    local, near = places.dot(rigid.rotation), (shape.radius_around + margin + faces.reach) ** 2
    outline = shape.outline if squares.min() <= near else shape.outline._replace(corners=shape.outline.corners[:0])
    found = faces.near(local, shape.distance(local)[0], outline, margin, DEEPEST * faces.size)
    found = found.of(_thinned(found, faces.parts))
    at, normals = (part.dot(rigid.rotation.T) for part in (found.at, found.normals))
    soft = _spots(found, at + rigid.position)
    none = np.zeros((len(found.keys), 0))
    return Contacts(soft, Spots(soft.arms, none.astype(int), none, soft.feature), normals, found.gaps)


def edges_on_edges(first: PlacedSurface, second: PlacedSurface, margin: float) -> Contacts | None:
    """Sharp edges of two surfaces that are nearer than a margin, m, where they cross; None: not both have faces."""
    faces, others = first.faces, second.faces
    if faces is None or others is None:
        return None
    edges = others.edges[others.sharp]
    found = faces.crossings(first.points, Outline(second.points, edges, 0.0), margin, DEEPEST * faces.size)
    ends = edges[found.keys // faces.parts - len(second.points)]
    begin, end = second.points[ends].transpose(1, 0, 2)
    foot, way = found.at - found.gaps[:, None] * found.normals, end - begin
    share = ((foot - begin) * way).dot(_ONES) / (way * way).dot(_ONES)
    nodes, weights = np.concatenate([ends, ends[:, :1]], axis=1), np.stack([1 - share, share, 0 * share], axis=1)
    mine = _spots(found, found.at)
    return Contacts(mine, Spots(foot, nodes, weights, mine.feature), found.normals, found.gaps)


def _thinned(found: Places, parts: int) -> Array:
    """Rows of places, at most `MOST` on any triangle or edge, as where a rim lies on one; parts: as of BodyFaces."""
    own, of = np.unique(found.keys % parts, return_inverse=True)
    kept = np.ones(len(of), dtype=bool)
    for part in (np.bincount(of, minlength=len(own)) > MOST).nonzero()[0]:
        rows = (of == part).nonzero()[0]
        kept[rows] = False
        kept[rows[thinned(found.at[rows], found.gaps[rows], found.normals[rows[0]])]] = True
    return kept.nonzero()[0]


def _spots(found: Places, at: Array) -> Spots:
    """Where they are; points have features that are not negative."""
    return Spots(at, found.nodes, found.weights, -1 - found.keys)
