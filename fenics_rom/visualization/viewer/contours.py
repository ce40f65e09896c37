"""A surface cut along the level lines of a field into bands, each of one colour.

The field is linear in a triangle. With corners a, b, c in the order of their levels, what of it lies between two levels
is a polygon of at most five corners: two on the side a-c, two on the way a-b-c, and b where its level is between.
"""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array


@dataclass(frozen=True)
class Bands:
    """Meshes of all bands, one after the other; pieces of a band share their corners, so that it shades smoothly.

    Attributes:
        first, second: (P,) vertices of the surface that each corner lies between.
        weight: (P,) of the second.
        faces: (T, 3) into these corners.
        corner_ends, face_ends: (B + 1,) where the corners and faces of each band begin, and the last end.
    """

    first: Array
    second: Array
    weight: Array
    faces: Array
    corner_ends: Array
    face_ends: Array

    def places(self, vertices: Array) -> Array:
        """Of all corners, (P, 3), where the surface's vertices are, (V, 3)."""
        start = vertices[self.first]
        return start + self.weight[:, None] * (vertices[self.second] - start)

    def parts(self, corners: Array) -> list[tuple[Array, Array]]:
        """Corners (p, 3) and faces (t, 3) into them of each band, of the places of all corners."""
        ends = zip(self.corner_ends, self.corner_ends[1:], self.face_ends, self.face_ends[1:], strict=False)
        return [(corners[p:q], self.faces[s:t] - p) for p, q, s, t in ends]


class Contours:
    """Cuts the triangles of a surface, (F, 3) into V vertices, into bands."""

    def __init__(self, triangles: Array, bands: int):
        self._triangles, self._bands = triangles, bands
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        _, numbers = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
        self._sides = numbers.reshape(-1, 3)  # between corners 0 and 1, 1 and 2, 2 and 0
        self._vertices = triangles.max() + 1

    def cut(self, levels: Array, whole: Array | None = None) -> Bands:
        """Bands of levels (V,), each from 0 to their number; the `whole` triangles (any,) are one more band, uncut."""
        cut = np.ones(len(self._triangles), dtype=bool)
        if whole is not None:
            cut[whole] = False
        corners, sides = self._triangles[cut], self._sides[cut]
        order = np.argsort(levels[corners], axis=1, kind="stable")
        rows = np.arange(len(corners))[:, None]
        a, b, c = corners[rows, order].T
        # The side that is opposite of corner k is (k + 1) % 3.
        bc, ac, ab = sides[rows, (order + 1) % 3].T
        is_turned = (order[:, 1] - order[:, 0]) % 3 == 1  # a, b, c stand as in the triangle, and a-c comes first below
        lowest = np.minimum(np.floor(levels[a]).astype(np.intp), self._bands - 1)
        count = np.maximum(np.ceil(levels[c]).astype(np.intp), lowest + 1) - lowest
        a, b, c, bc, ac, ab, is_turned = (np.repeat(each, count) for each in (a, b, c, bc, ac, ab, is_turned))
        band = np.repeat(lowest, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)

        low, high = np.maximum(band, levels[a]), np.minimum(band + 1, levels[c])
        middle = np.clip(levels[b], low, high)
        corners, sides = (a, b, c), (ab, bc)
        polygon = (
            self._along(levels, a, c, ac, low, 0.0),
            self._along(levels, a, c, ac, high, 1.0),
            self._around(levels, corners, sides, high, 1.0),
            self._around(levels, corners, sides, middle, 1.0),
            self._around(levels, corners, sides, low, 0.0),
        )
        names, first, second, weight = (np.stack(each, axis=1) for each in zip(*polygon, strict=True))
        faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
        faces = np.where(is_turned[:, None, None], faces[:, ::-1], faces)
        return self._joined(band, names, first, second, weight, faces, np.flatnonzero(~cut))

    def _along(
        self, levels: Array, start: Array, end: Array, side: Array, level: Array, if_even: float
    ) -> tuple[Array, ...]:
        """Where sides have a level: a name of the place, the two vertices, the weight of the second (`if_even`: where
        both have one level)."""
        rise = levels[end] - levels[start]
        weight = np.divide(level - levels[start], rise, out=np.full(len(rise), if_even), where=rise > 0)
        between = self._vertices + side * (self._bands + 1) + np.rint(level).astype(np.intp)
        name = np.where(weight <= 0, start, np.where(weight >= 1, end, between))
        return name, start, end, np.clip(weight, 0.0, 1.0)

    def _around(
        self, levels: Array, corners: tuple[Array, ...], sides: tuple[Array, ...], level: Array, if_even: float
    ) -> tuple[Array, ...]:
        """The same on the way from a over b to c."""
        a, b, c = corners
        is_second = level > levels[b]
        ab, bc = sides
        start, end, side = (np.where(is_second, *each) for each in ((b, a), (c, b), (bc, ab)))
        return self._along(levels, start, end, side, level, if_even)

    def _joined(
        self, band: Array, names: Array, first: Array, second: Array, weight: Array, faces: Array, whole: Array
    ) -> Bands:
        """Corners of the same name in a band made one, and faces without area left out."""
        uncut = self._triangles[whole].ravel()
        sizes = self._vertices + (self._sides.max() + 1) * (self._bands + 1)
        keys = np.concatenate([(band[:, None] * sizes + names).ravel(), self._bands * sizes + uncut])
        keys, index, inverse = np.unique(keys, return_index=True, return_inverse=True)
        of_pieces = inverse[: names.size].reshape(names.shape)
        triangles = of_pieces[np.arange(len(band))[:, None, None], faces].reshape(-1, 3)
        bands = np.repeat(band, 3)
        has_area = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        order = np.flatnonzero(has_area)[np.argsort(bands[has_area], kind="stable")]
        numbers = np.arange(self._bands + 2)
        return Bands(
            np.concatenate([first.ravel(), uncut])[index],
            np.concatenate([second.ravel(), uncut])[index],
            np.concatenate([weight.ravel(), np.zeros(len(uncut))])[index],
            np.concatenate([triangles[order], inverse[names.size :].reshape(-1, 3)]),
            np.searchsorted(keys // sizes, numbers),
            np.append(np.searchsorted(bands[order], numbers[:-1]), len(order) + len(whole)),
        )
