"""A surface of triangles whose edges are rounded: what a point meets is the mean of the surface in a disc around it.

A point that slides over an edge would feel another normal from one step to the next. So it meets the mean over a disc
of radius r about it, in the plane of the triangle that it is nearest to, of normal n₀. With the share a_T of the disc
that triangle T covers, seen along n₀, and its centre there c_T, the place and the normal are

    s = Σ a_T c_T = Σ w_i x_i,    n ∝ Σ a_T n_T / (n_T·n₀),

a convolution of the surface with the disc, and its normal, which do not jump. The gap is n·(x - s). Its rate is that of
its row, n·(v - Σ w_i v_i), but for the third order of the angles between triangles, and these times strains. So the row
has all nodes that the gap depends on, and points that slide are neither let in nor lifted. At an edge that bends by a
small α the surface is 2 α r / 3π inside. What no triangle around covers, as beyond a border, the nearest one goes over.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.surface_pairs import OnSurface, unit_normals

RADIUS = 0.2  # of the least height of triangles around
SHARPEST = np.cos(np.radians(40.0))  # between normals at rest of triangles at a corner: others are parted by a crease
STEEPEST = 0.3  # cosine: triangles that are steeper over the plane of the disc are not seen
INSIDE = -1e-9  # weights of a place that is on a triangle
BEYOND = 0.25  # of the margin: by less beyond a border, points outside may be over the surface in the end


class Rounding(NamedTuple):
    """How far edges of a surface are rounded, and which triangles are around each of its t triangles."""

    radii: Array  # (n,) at points, m
    nodes: Array  # (t, c) its corners, then those of the m triangles around, or again its own first
    around: Array  # (t, m, 4) each of those, or -1, and where its corners are among these nodes


NOT_ROUNDED = Rounding(np.zeros(0), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 0, 4), dtype=np.int64))


def rounding_of(points: Array, triangles: Array) -> Rounding:
    """That of a surface at rest.

    Args:
        points: (n, 3), m.
        triangles: (t, 3) rows of points, counterclockwise from outside.
    """
    corners, t = points[triangles], len(triangles)
    normals, sides = unit_normals(corners), np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    heights, counts = np.repeat(areas / sides.max(axis=1), 3), np.bincount(triangles.ravel(), minlength=len(points))
    radii = RADIUS * np.bincount(triangles.ravel(), heights, len(points)) / np.maximum(counts, 1)
    own, other = _at_common_points(triangles)
    smooth = (normals[own] * normals[other]).sum(axis=1) >= SHARPEST
    own, other = own[smooth], other[smooth]
    number, m = _numbers(own)
    n, same = max(len(points), 1), triangles[other][:, :, None] == triangles[own][:, None]
    is_own, place = same.any(axis=2), same.argmax(axis=2)
    keys = own[:, None] * n + triangles[other]
    beside, row = np.unique(keys[~is_own], return_inverse=True)
    place_beside, more = _numbers(beside // n)
    place[~is_own] = 3 + place_beside[row]
    nodes = np.repeat(triangles[:, :1], 3 + more, axis=1).astype(np.int64)
    nodes[:, :3], nodes[beside // n, 3 + place_beside] = triangles, beside % n
    around = np.zeros((t, m, 4), dtype=np.int64)
    around[:, :, 0] = -1
    around[own, number, 0], around[own, number, 1:] = other, place
    return Rounding(radii, nodes, around)


def _at_common_points(triangles: Array) -> tuple[Array, Array]:
    """Pairs of triangles (t, 3) that share corners, both ways, by the first ones."""
    corner, t = triangles.ravel(), len(triangles)
    order = np.argsort(corner, kind="stable")
    start, stop = (np.searchsorted(corner[order], corner, side) for side in ("left", "right"))
    counts = stop - start
    first = np.repeat(start - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
    own, other = np.repeat(np.arange(3 * t) // 3, counts), order[first + np.arange(counts.sum())] // 3
    own, other = np.divmod(np.unique(own * t + other), max(t, 1))
    return own[own != other], other[own != other]


def _numbers(owner: Array) -> tuple[Array, int]:
    """Of what is sorted by owners the number of each among those of its owner, and how many one has at most."""
    number = np.arange(len(owner)) - np.searchsorted(owner, owner)
    return number, int(number.max(initial=-1)) + 1


def rounded(
    rounding: Rounding, places: Array, points: Array, triangles: Array, margin: float, found: OnSurface
) -> OnSurface:
    """What places meet of a surface whose edges are rounded.

    Args:
        rounding: of the surface.
        places: (k, 3) of those that are near, m.
        points, triangles: of the surface as it is.
        margin: m, at most of places that are near, more than any moves in a step.
        found: what is found of flat triangles, with the numbers of these, (k, 1), for their corners.
    """
    T, c = found.nodes[:, 0], rounding.nodes.shape[1]
    nodes, weights = np.repeat(triangles[T, :1], c, axis=1), np.zeros((len(T), c))
    nodes[:, :3], weights[:, :3] = triangles[T], found.weights
    radii = (found.weights * rounding.radii[triangles[T]]).sum(axis=1)
    some = (np.abs(found.gaps) <= radii).nonzero()[0]
    disc = _Disc.about(places[some], radii[some], points[triangles[T[some]]])
    beside = disc.leaves_triangle.nonzero()[0]  # else a place meets its flat triangle
    some, disc = some[beside], _Disc(*(part[beside] for part in disc))
    around = rounding.around[T[some]]
    row, m = (around[:, :, 0] >= 0).nonzero()
    others = disc.seen(points, triangles[around[row, m, 0]], row)
    in_reach = (others.min(axis=1) < 1).all(axis=1) & (others.max(axis=1) > -1).all(axis=1)
    row, m, others = row[in_reach], m[in_reach], others[in_reach]
    tilts = unit_normals(points[triangles[around[row, m, 0]]])
    cosines = np.einsum("ib,ib->i", disc.normals[row], tilts)
    is_seen = cosines > STEEPEST
    row, m, others, tilts, cosines = (part[is_seen] for part in (row, m, others, tilts, cosines))
    shares, moments = in_disc(others)
    (own, own_slopes), (at_centre, slopes) = weights_at_centre(disc.corners), weights_at_centre(others)
    left, opposite, normals = np.ones(len(some)), np.zeros((len(some), 2)), disc.normals.copy()
    np.subtract.at(left, row, shares)
    np.subtract.at(opposite, row, moments)
    normals *= left[:, None]
    np.add.at(normals, row, (shares / cosines)[:, None] * tilts)
    w = np.zeros((len(some), c))
    w[:, :3] = left[:, None] * own + np.einsum("kca,ka->kc", own_slopes, opposite)
    parts = shares[:, None] * at_centre + np.einsum("ica,ia->ic", slopes, moments)
    np.add.at(w, (row[:, None], around[row, m, 1:]), parts)
    normals /= np.sqrt((normals**2).sum(axis=1))[:, None]
    above = disc.heights
    beyond = np.sqrt(np.maximum(found.gaps[some] ** 2 - above**2, 0.0))
    met = own.min(axis=1) >= INSIDE
    met[row[at_centre.min(axis=1) >= INSIDE]] = True
    met |= (above >= 0) & (beyond <= BEYOND * margin)
    some, w = some[met], w[met]
    weights[some], nodes[some] = w, np.where(w != 0.0, rounding.nodes[T[some]], nodes[some, :1])
    feet, gaps, out = found.places.copy(), found.gaps.copy(), found.normals.copy()
    feet[some], out[some] = (w[:, :, None] * points[nodes[some]]).sum(axis=1), normals[met]
    gaps[some] = ((places[some] - feet[some]) * out[some]).sum(axis=1)
    return OnSurface(found.row, nodes, weights, feet, out, gaps)


class _Disc(NamedTuple):
    """Discs of k places, each in the plane of a triangle; two axes in that are in units of the radius."""

    centres: Array  # (k, 3), m
    normals: Array  # (k, 3) units
    axes: Array  # (k, 2, 3), 1/m
    corners: Array  # (k, 3, 2) of the triangles
    heights: Array  # (k,) of the places above these, m

    @classmethod
    def about(cls, places: Array, radii: Array, corners: Array) -> "_Disc":
        """About places (k, 3), of radii (k,), m, in the planes of triangles (k, 3, 3)."""
        normals, along = unit_normals(corners), corners[:, 1] - corners[:, 0]
        along /= np.sqrt((along**2).sum(axis=1))[:, None]
        axes = np.stack([along, np.cross(normals, along)], axis=1) / radii[:, None, None]
        own = np.einsum("kab,kcb->kca", axes, corners - places[:, None])
        return cls(places, normals, axes, own, ((places - corners[:, 0]) * normals).sum(axis=1))

    @property
    def leaves_triangle(self) -> Array:
        """Which are not wholly in their triangles, (k,)."""
        sides = np.roll(self.corners, -1, axis=1) - self.corners
        off = _cross(self.corners, sides) / np.sqrt((sides**2).sum(axis=2))
        return off.min(axis=1) < 1.0

    def seen(self, points: Array, triangles: Array, row: Array) -> Array:
        """Corners of triangles (i, 3) of points, as they are seen in discs (i,) along the normals, (i, 3, 2)."""
        return np.einsum("iab,icb->ica", self.axes[row], points[triangles] - self.centres[row, None])


def in_disc(corners: Array) -> tuple[Array, Array]:
    """How much of the unit disc triangles (..., 3, 2) cover, counterclockwise: shares (...) and moments (..., 2).

    By Green's theorem: each side adds the triangle of its part in the disc with the centre, and sectors of the others.
    """
    area, moment = np.zeros(corners.shape[:-2]), np.zeros((*corners.shape[:-2], 2))
    for k in range(3):
        a, b = corners[..., k, :], corners[..., (k + 1) % 3, :]
        d = b - a
        square, half = np.maximum((d * d).sum(axis=-1), np.finfo(float).tiny), (a * d).sum(axis=-1)
        root = np.sqrt(np.maximum(half * half - square * ((a * a).sum(axis=-1) - 1), 0.0))
        first, last = (np.clip((sign * root - half) / square, 0.0, 1.0)[..., None] for sign in (-1, 1))
        p, q = a + first * d, a + last * d
        twice = _cross(p, q)
        area += twice / 2
        moment += twice[..., None] * (p + q) / 6
        for u, v in ((a, p), (q, b)):
            area += np.arctan2(_cross(u, v), (u * v).sum(axis=-1)) / 2
            u, v = (w / np.maximum(np.sqrt((w * w).sum(axis=-1)), np.finfo(float).tiny)[..., None] for w in (u, v))
            moment += np.stack([v[..., 1] - u[..., 1], u[..., 0] - v[..., 0]], axis=-1) / 3
    return area / np.pi, moment / np.pi


def weights_at_centre(corners: Array) -> tuple[Array, Array]:
    """Weights of the corners of triangles (..., 3, 2) at the centre, (..., 3), and how they change along both axes."""
    after, last = np.roll(corners, -1, axis=-2), np.roll(corners, 1, axis=-2)
    weights, d = _cross(after, last), after - last
    slopes = np.stack([d[..., 1], -d[..., 0]], axis=-1)
    twice = weights.sum(axis=-1)[..., None]
    return weights / twice, slopes / twice[..., None]


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
