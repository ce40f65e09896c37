"""Which of a body's surface are the walls of chambers: of hollows that hardly see the outside.

A hollow without an opening is a part of the surface by itself, whose normals look inwards. One with openings is cut off
at their rims, and each opening closed by triangles from its middle. Of what a wall of area A sees, diffusely and on the
average, openings of area a are the share a/A: by the reciprocity of view factors, as all that a flat opening sees of
the hollow are walls. A hollow is a chamber where this is at most `OPEN_SHARE`: a blind hole is one if it is deeper than
1.5 times its radius, a hole from side to side if it is longer than 4 radii; a dimple and a groove are none.

Rims are the outlines of pieces of the surface that have several, but for the outermost: of flat pieces, so that a rim
may be sharp or round, and of pieces that bend smoothly. No ray is cast: the result follows from the mesh alone.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from scipy.sparse.csgraph import connected_components

OPEN_SHARE = 0.25  # of what its walls see on the average, that a chamber may have open
FLAT, SMOOTH = 0.02, 0.6  # rad, by which triangles of a flat, and of a smooth piece turn from one to the next
CLEARLY_LONGER = 1.5  # from end to end, the outermost outline of a bent piece than its next: a tube has none
NO_VOLUME = 1e-9  # share of the cube of the body's length


class Hollow(NamedTuple):
    """A part of the surface that bounds a hollow."""

    facets: Array  # (any,) which
    open_share: float  # of what its walls see, on the average
    middle: Array  # (3,), m, the mean of its walls' corners


def inner_facets(points: Array, facets: Array) -> tuple[Array, list[Hollow]]:
    """Which of a surface are the walls of chambers.

    Args:
        points: (N, 3), m.
        facets: (F, 3) the whole surface of a body, outward triangles.

    Returns:
        Whether each facet (F,) is one; and all hollows that were found, also those that are too open.
    """
    found = _hollows(points, facets)
    inner = np.zeros(len(facets), dtype=bool)
    for hollow in found:
        inner[hollow.facets] = hollow.open_share <= OPEN_SHARE
    return inner, found


def _hollows(points: Array, facets: Array) -> list[Hollow]:
    """Those without an opening and those with, in the order of their first triangles."""
    corners = points[facets] - points.mean(axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(normals, axis=1)
    normals /= doubled[:, None]
    sides, pairs = _edges(facets)
    angles = np.arccos(np.clip(np.einsum("ej,ej->e", *normals[pairs].swapaxes(0, 1)), -1.0, 1.0))
    is_rim = np.zeros(len(pairs), dtype=bool)
    for most in (FLAT, SMOOTH):
        is_rim[_rims(points, sides, pairs, angles, most)] = True

    count, part = _parts(len(facets), pairs[~is_rim])
    is_rim &= part[pairs[:, 0]] != part[pairs[:, 1]]
    sides, beside = sides[is_rim], part[pairs[is_rim]]  # of edges of rims: their ends, and the parts on both sides
    swept, openings = _caps(points, sides)
    volumes = np.bincount(part, np.linalg.det(corners) / 6, count)
    np.add.at(volumes, beside[:, 0], swept)
    np.add.at(volumes, beside[:, 1], -swept)

    none = NO_VOLUME * float(np.ptp(points, axis=0).max()) ** 3
    is_hollow = volumes < -none
    for _ in range(count):  # a flat end is of the hollow that is all around it
        surrounded = np.bincount(beside.ravel(), minlength=count) > 0
        surrounded[beside[~is_hollow[beside[:, ::-1]]]] = False
        flat = ~is_hollow & surrounded & (np.abs(volumes) <= none)
        if not flat.any():
            break
        is_hollow |= flat
    within = is_hollow[beside].all(axis=1)
    _, whole = _parts(count, beside[within])
    found = []
    for one in np.unique(whole[is_hollow]):
        walls = np.flatnonzero(is_hollow[part] & (whole[part] == one))
        is_open = ~within & (is_hollow[beside] & (whole[beside] == one)).any(axis=1)
        share = 2 * openings[is_open].sum() / doubled[walls].sum()
        found.append(Hollow(walls, float(share), points[facets[walls]].mean(axis=(0, 1))))
    return sorted(found, key=lambda hollow: int(hollow.facets[0]))


def _edges(facets: Array) -> tuple[Array, Array]:
    """Edges that two triangles share: their ends (E, 2), as the first has them in its order, and the two (E, 2).

    Where more than two meet, at an edge at which parts of a body touch, they are not neighbours.
    """
    directed = np.concatenate([facets[:, [k, (k + 1) % 3]] for k in range(3)])
    owner = np.tile(np.arange(len(facets)), 3)
    _, edge, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.ravel(), kind="stable")
    order = order[np.repeat(count, count) == 2].reshape(-1, 2)
    return directed[order[:, 0]], owner[order]


def _parts(count: int, pairs: Array) -> tuple[int, Array]:
    """How many connected parts a graph has, and the part of each."""
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    number, part = connected_components(graph, directed=False)
    return int(number), part


def _rims(points: Array, sides: Array, pairs: Array, angles: Array, most: float) -> Array:
    """Edges (any,) at which a hollow may open, of pieces whose triangles turn by `most` from one to the next."""
    _, piece = _parts(int(pairs.max()) + 1, pairs[angles <= most])
    is_bent = np.zeros(len(piece), dtype=bool)
    is_bent[piece[pairs[(angles > FLAT) & (angles <= most), 0]]] = True
    rows = np.flatnonzero(piece[pairs[:, 0]] != piece[pairs[:, 1]])
    owner, ends = piece[pairs[rows]].T.ravel(), np.tile(sides[rows], (2, 1))  # each edge bounds a piece on either side
    _, corner = np.unique(np.stack([np.repeat(owner, 2), ends.ravel()]), axis=1, return_inverse=True)
    corner = corner.reshape(-1, 2)
    _, line = _parts(int(corner.max(initial=-1)) + 1, corner)
    line = line[corner[:, 0]]
    _, first = np.unique(line, return_index=True)
    several = np.bincount(owner[first], minlength=len(piece)) > 1
    is_rim = several[owner] & (is_bent[owner] if most > FLAT else True)
    for one in np.unique(owner[is_rim]):
        lines = np.unique(line[owner == one])
        extents = [np.linalg.norm(np.ptp(points[ends[line == k]].reshape(-1, 3), axis=0)) for k in lines]
        *_, second, longest = np.sort(extents)
        if longest >= CLEARLY_LONGER * second or not is_bent[one]:
            is_rim[line == lines[int(np.argmax(extents))]] = False  # the outermost
    return np.tile(rows, 2)[is_rim]


def _caps(points: Array, sides: Array) -> tuple[Array, Array]:
    """What closes rims, a triangle from each edge (R, 2) to the middle of its rim: volumes m³, and areas, m², (R,).

    A volume is that to the middle of all points, of the side on which the edge has its order.
    """
    _, rim = _parts(len(points), sides)
    _, rim = np.unique(rim[sides[:, 0]], return_inverse=True)
    ends = points[sides] - points.mean(axis=0)
    count = np.bincount(rim)
    tips = np.stack([np.bincount(rim, ends[:, :, axis].mean(axis=1)) / count for axis in range(3)], axis=1)[rim]
    areas = np.linalg.norm(np.cross(ends[:, 0] - tips, ends[:, 1] - tips), axis=1) / 2
    return np.linalg.det(np.stack([ends[:, 1], ends[:, 0], tips], axis=1)) / 6, areas
