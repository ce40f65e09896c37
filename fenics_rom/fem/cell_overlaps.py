"""Cells that overlap others, or touch them without sharing nodes: their common volume, and the nodes that lie there.

Of two volumes that a mesher was not told to join (`addBox` of Gmsh twice, without `fragment`) each has its own cells.
"""

from collections.abc import Iterator
from functools import reduce

import numpy as np
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from fenics_rom.fem.meeting_boxes import meeting_boxes
from fenics_rom.fem.mesh_quality import CELL_FACES, Faces, signed_volumes

SAME_PLACE = 1e-6  # share of the body's size that places may differ by, as files hold few digits
ROUND_OFF = 1e-9  # share of the smaller cell that two must have in common
PAIRS_AT_ONCE = 4_000
PIECES = {  # of a tetrahedron of which so many vertices are inside: its vertices, or places on edges between two
    1: [((0, 0), (0, 1), (0, 2), (0, 3))],
    2: [((0, 0), (0, 2), (0, 3), (1, 3)), ((0, 0), (0, 2), (1, 3), (1, 2)), ((0, 0), (1, 2), (1, 3), (1, 1))],
    3: [((0, 0), (1, 1), (2, 2), (2, 3)), ((0, 0), (1, 1), (2, 3), (1, 3)), ((0, 0), (1, 3), (2, 3), (0, 3))],
    4: [((0, 0), (1, 1), (2, 2), (3, 3))],
}


def describe_overlaps(points: Array, cells: Array, faces: Faces, source: str) -> Iterator[str]:
    """What to say of cells that overlap, or touch without being joined; neighbours are left to `check_filling`.

    Args:
        points: (N, 3), m.
        cells: (C, 4), positively oriented.
        faces: of these cells, as `check_filling` gives them.
        source: their file.
    """
    corners, volumes = points[cells], np.abs(signed_volumes(points, cells))
    reach = SAME_PLACE * float(np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0)))
    count, part = faces.parts()
    is_skin = np.zeros(len(cells), dtype=bool)
    is_skin[faces.owner] = True
    chosen = np.flatnonzero(is_skin | (count > 1))  # in one part, skin meets first
    low, high = corners[chosen].min(axis=1) - reach, corners[chosen].max(axis=1) + reach
    pairs = meeting_boxes(low, high, part[chosen], is_skin[chosen])
    pairs, inside, touching = _look_at(pairs, corners[chosen], cells[chosen], part[chosen], reach)
    meeting = chosen[pairs]
    pieces, pair = common_pieces(corners[meeting[:, 0]], corners[meeting[:, 1]])
    common = np.bincount(pair, weights=piece_volumes(pieces), minlength=len(meeting))
    is_overlap = common > ROUND_OFF * volumes[meeting].min(axis=1)
    if is_overlap.any():
        volume = common[is_overlap].sum()
        where = _where(pieces[is_overlap[pair]].reshape(-1, 3))
        yield (
            f"{_who(part[meeting[is_overlap]])} overlap {where}: of the {volumes.sum():.4g} m³ of all cells "
            f"{volume:.3g} m³ count twice in mass and stiffness, and nothing joins the {len(inside)} nodes inside "
            "other cells to these; unite the volumes where the mesh is made (in Gmsh: BooleanUnion, or "
            "BooleanFragments to keep each), and mesh anew"
        )
    elif len(touching):
        on_node = cKDTree(points[np.unique(cells)]).query(points[touching], k=2)[0][:, 1] <= 2 * reach
        cure = "unite the volumes where the mesh is made (in Gmsh: BooleanFragments), and mesh anew"
        if on_node.all():
            cure = f"fenics-rom mesh {source} -o JOINED.msh --glue makes one of those in one place"
        yield (
            f"{len(touching)} nodes lie on cells that they do not belong to, {on_node.sum()} of them on other nodes, "
            f"{_where(points[touching])}: what touches there is not joined; {cure}"
        )
    shared = _nodes_of_several(cells, part)
    if len(shared):
        yield (
            f"{part.max() + 1} parts of the body have {len(shared)} nodes in common, {_where(points[shared])}, and no "
            "faces: they hang together as by hinges; where volumes meet, let them share their surface (in Gmsh: "
            "BooleanFragments)"
        )


def _nodes_of_several(cells: Array, part: Array) -> Array:
    """Nodes of cells of more than one part."""
    if not part.any():
        return cells[:0, 0]
    nodes, count = np.unique(
        np.unique(np.column_stack([cells.ravel(), np.repeat(part, 4)]), axis=0)[:, 0], return_counts=True
    )
    return nodes[count > 1]


def _who(parts: Array) -> str:
    """Which parts (P, 2) pairs of cells are of."""
    return f"{len(np.unique(parts))} parts of the body" if (parts[:, 0] != parts[:, 1]).any() else "cells of the body"


def _where(places: Array) -> str:
    low, high = (exact.round(6).tolist() for exact in (places.min(axis=0), places.max(axis=0)))
    return f"between {low} and {high}"


def _look_at(pairs: Array, corners: Array, cells: Array, part: Array, reach: float) -> tuple[Array, Array, Array]:
    """Pairs of cells that no plane of a face parts, and nodes in cells, and on cells, that they do not belong to.

    Cells of one part that share a node are left to `check_filling`.
    """
    meeting, inside, touching = [pairs[:0]], [cells[:0, 0]], [cells[:0, 0]]
    normals, offsets = _planes(corners)
    # Pairs are the last axis, as sums over a few numbers are fast along the first ones alone.
    places, normals, nodes, offsets = (np.ascontiguousarray(each.T) for each in (corners, normals, cells, offsets))
    for start in range(0, len(pairs), PAIRS_AT_ONCE):
        some = pairs[start : start + PAIRS_AT_ONCE]
        first, second = some.T
        mine, theirs = nodes[:, first], nodes[:, second]
        are_strangers = part[first] != part[second]
        are_strangers |= ~reduce(np.logical_or, (one == other for one in mine for other in theirs))
        some, first, second = some[are_strangers], first[are_strangers], second[are_strangers]
        is_shared = nodes[:, None, first] == nodes[None, :, second]
        are_apart = np.zeros(len(some), dtype=bool)
        for one, other, is_own in ((first, second, is_shared.any(axis=0)), (second, first, is_shared.any(axis=1))):
            there, along = places[..., other], normals[..., one]
            depth = offsets[None, :, one] + sum(there[k][:, None] * along[k][None] for k in range(3))  # (4, 4, pairs)
            are_apart |= depth.max(axis=0).min(axis=0) <= reach
            least = np.where(is_own, -np.inf, depth.min(axis=1))
            inside.append(nodes[:, other][least > reach])
            touching.append(nodes[:, other][np.abs(least) <= reach])
        meeting.append(some[~are_apart])
    return np.concatenate(meeting), *(np.unique(np.concatenate(nodes)) for nodes in (inside, touching))


def _planes(corners: Array) -> tuple[Array, Array]:
    """Inward unit normals (..., 4, 3) of faces of cells, and what makes the product with them a depth (..., 4), m."""
    a, b, c = (corners[..., CELL_FACES[:, k], :] for k in range(3))
    normals = -np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=-1)[..., None]
    return normals, -(normals * a).sum(axis=-1)


def common_pieces(one: Array, other: Array) -> tuple[Array, Array]:
    """Tetrahedra (T, 4, 3) that fill what each tetrahedron (P, 4, 3) has in common with another, and of which (T,).

    The first are cut at each face of the second into tetrahedra, of which those inside are kept.
    """
    normals, offsets = _planes(other)
    left, pair = one, np.arange(len(one))
    for f in range(4):
        depth = np.einsum("tvi,ti->tv", left, normals[pair, f]) + offsets[pair, f, None]
        order = np.argsort(-depth, axis=1)
        left, depth = np.take_along_axis(left, order[:, :, None], axis=1), np.take_along_axis(depth, order, axis=1)
        count = (depth > 0).sum(axis=1)
        pieces, of = [left[:0]], [pair[:0]]
        for kept, tetrahedra in PIECES.items():
            rows = np.flatnonzero(count == kept)
            for tetrahedron in tetrahedra:
                pieces.append(np.stack([_between(left[rows], depth[rows], *ends) for ends in tetrahedron], axis=1))
                of.append(pair[rows])
        left, pair = np.concatenate(pieces), np.concatenate(of)
    return left, pair


def piece_volumes(pieces: Array) -> Array:
    """Volumes (T,) of tetrahedra (T, 4, 3) of any orientation."""
    return np.abs(np.linalg.det(pieces[:, 1:] - pieces[:, :1])) / 6


def _between(corners: Array, depth: Array, i: int, j: int) -> Array:
    """Where the edges between vertices i, inside, and j meet the face; vertex i where they are the same."""
    if i == j:
        return corners[:, i]
    share = depth[:, i] / (depth[:, i] - depth[:, j])
    return corners[:, i] + share[:, None] * (corners[:, j] - corners[:, i])
