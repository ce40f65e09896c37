"""What flat triangles leave out of a smooth surface: its normals, and how high it is above them.

At a corner the normal is the sum of those of the triangles around, by the weights of Max (J. Graphics Tools 4, 1999),
which are exact on a sphere. Within a triangle it is interpolated by the weights w of the corners, as in Puso & Laursen
(Comput. Methods Appl. Mech. Eng. 193, 2004), and the surface is above the triangle by

    η = ½ Σ w_i w_j (n_j - n_i)·(x_j - x_i)    of all sides ij,

which is exact for surfaces of second order. A place with the offset d from its foot then has the gap n·d - η. Both
go on across sides between triangles. Edges that are sharp at rest, and borders, part the triangles around a corner.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

SHARPEST = np.cos(np.radians(40.0))  # between normals of triangles: edges that bend by more at rest are creases
FLAT = 1e-10  # by so much normals at corners differ from the triangle's where it is as flat as round-off lets it be
SMOOTH, BORDER, CREASE = range(3)  # sides
SIDES, CORNERS = slice(3, 6), slice(6, 9)  # of a row of `bends_of`: sides opposite to corners, and if corners are sharp


class Bent(NamedTuple):
    """What is known of how triangles (k,) are joined to others."""

    bends: Array  # (k, 9) of `bends_of`
    normals: Array  # (f, 3) units at corners, of `corner_normals`

    def of(self, rows: Array) -> "Bent":
        """Of some of the triangles."""
        return self._replace(bends=self.bends[rows])


def bends_of(points: Array, triangles: Array) -> Array:
    """Which triangles of a surface are smoothly joined, (t, 9): a row of integers for each of them.

    The first three tell which normal, of as many as there are, its corners have; the next what the sides opposite to
    them are; the last whether corners are at a crease or on a border.

    Args:
        points: at rest (n, 3), m.
        triangles: (t, 3) rows of points, counterclockwise from outside.
    """
    sides = np.stack([triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]], axis=2).reshape(-1, 2)
    _, edge, count = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    edge = edge.ravel()
    order = np.argsort(edge, kind="stable")
    first = order[np.cumsum(count) - count]
    one, other = first[count == 2], order[(np.cumsum(count) - count)[count == 2] + 1]  # the two sides of an edge
    normals = unit_normals(points[triangles])
    cosines = (normals[one // 3] * normals[other // 3]).sum(axis=1)
    kinds = np.where(count == 1, BORDER, CREASE)[edge]
    joined = cosines >= SHARPEST
    one, other = one[joined], other[joined]
    kinds[one] = kinds[other] = SMOOTH
    is_sharp = np.zeros(len(points), dtype=bool)
    is_sharp[sides[kinds != SMOOTH]] = True
    fans = np.arange(3 * len(triangles))  # numbers of corners: those that share a normal get the least of them
    ends = [_corners_at(triangles, sides[one, end], one // 3) for end in (0, 1)]
    others = [_corners_at(triangles, sides[one, end], other // 3) for end in (0, 1)]
    mine, theirs = np.concatenate(ends), np.concatenate(others)
    while (fans[mine] != fans[theirs]).any():
        least = np.minimum(fans[mine], fans[theirs])
        np.minimum.at(fans, mine, least)
        np.minimum.at(fans, theirs, least)
    fans = np.unique(fans, return_inverse=True)[1].ravel()
    table: Array = np.hstack([fans.reshape(-1, 3), kinds.reshape(-1, 3), is_sharp[triangles]])
    return table


def _corners_at(triangles: Array, point: Array, triangle: Array) -> Array:
    """Numbers of the corners (k,) of triangles (k,) that are at points (k,)."""
    corners: Array = 3 * triangle + (triangles[triangle] == point[:, None]).argmax(axis=1)
    return corners


def unit_normals(corners: Array) -> Array:
    """Units (k, 3) of triangles (k, 3, 3)."""
    (a, b, c), (x, y, z) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    normals = np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
    normals /= np.sqrt(_dot(normals, normals))[:, None]
    return normals


def corner_normals(corners: Array, fans: Array) -> Array:
    """Units (f, 3) at all corners that have their own.

    Args:
        corners: of all triangles, (t, 3, 3), m.
        fans: of `bends_of`, (t, 3).
    """
    sides = np.roll(corners, -1, axis=1) - corners  # from each corner to the next
    squares = _dot(sides, sides)
    a, b = sides[:, 0], sides[:, 1]
    crossed = np.cross(a, b)  # as at all corners of a triangle
    weights = 1 / (squares * np.roll(squares, 1, axis=1))
    normals = np.empty((fans.max(initial=-1) + 1, 3))
    for k in range(3):
        normals[:, k] = np.bincount(fans.ravel(), (weights * crossed[:, k, None]).ravel(), len(normals))
    normals /= np.sqrt(_dot(normals, normals))[:, None]
    return normals


def smoothed(
    bent: Bent, weights: Array, corners: Array, offsets: Array, flat: Array, clear: Array, normals: Array, gaps: Array
) -> tuple[Array, Array]:
    """Normals (k, 3) and gaps (k,), m, of places near triangles that stand for a smooth surface.

    Args:
        bent: of these triangles.
        weights: of the corners, (k, 3), in the places of them that are nearest.
        corners: of the triangles, (k, 3, 3), m.
        offsets: of the places from these, (k, 3), m.
        flat: units (k, 3) of the triangles.
        clear: which places are off the surface by more than round-off, (k,).
        normals, gaps: as of flat triangles; they stay where a triangle is flat. At creases and on borders a place that
            is clear has its own normal.
    """
    at = bent.normals[bent.bends[:, :3]]
    curved = (np.abs(at - flat[:, None]).max(axis=(1, 2), initial=0.0) > FLAT).nonzero()[0]
    if not len(curved):
        return normals, gaps
    w, at, corners, bends = weights[curved], at[curved], corners[curved], bent.bends[curved]
    η = np.zeros(len(curved))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        rise = _dot(at[:, j] - at[:, i], corners[:, j] - corners[:, i]) / 2
        η += np.where(bends[:, SIDES][:, k] == CREASE, 0.0, w[:, i] * w[:, j] * rise)
    n = (w[:, :, None] * at).sum(axis=1)
    n /= np.sqrt(_dot(n, n))[:, None]
    is_sharp = ((w == 0) & (bends[:, SIDES] != SMOOTH) | (w == 1) & (bends[:, CORNERS] != SMOOTH)).any(axis=1)
    own = clear[curved] & is_sharp
    normals, gaps, smooth = normals.copy(), gaps.copy(), curved[~own]
    normals[smooth], gaps[smooth] = n[~own], _dot(n[~own], offsets[smooth])
    gaps[curved] -= η
    return normals, gaps


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)
