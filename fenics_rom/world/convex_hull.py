"""The convex hull of a few points: its corners, and its faces as polygons."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import SceneError

_FLAT = 1e-9  # of the hull's size: nearer to a plane is on it


def convex_hull(points: Array) -> tuple[Array, list[list[int]]]:
    """The convex hull of points (P, 3): its corners (V, 3), and faces as loops of them, counterclockwise from outside.

    The points are added one by one; what a new one sees is cut out, and the rim of the hole is joined to it.

    Raises:
        SceneError: the points lie in one plane.
    """
    size = float(np.ptp(points, axis=0).max())
    faces = _tetrahedron(points, size)
    for new, point in enumerate(points):
        seen = [face for face, (normal, level) in faces.items() if normal.dot(point) - level > _FLAT * size]
        edges = {edge for face in seen for edge in _edges(face)}
        for face in seen:
            del faces[face]
        for start, end in edges:
            if (end, start) not in edges:
                faces[start, end, new] = _plane(points, (start, end, new))
    polygons = _merge(points, faces)
    used = sorted({corner for polygon in polygons for corner in polygon})
    number = {corner: k for k, corner in enumerate(used)}
    return points[used], [[number[corner] for corner in polygon] for polygon in polygons]


def _tetrahedron(points: Array, size: float) -> dict[tuple[int, int, int], tuple[Array, float]]:
    """Four points that are far from one plane, as triangles with their planes."""
    a = int(points[:, 0].argmin())
    b = int(np.linalg.norm(points - points[a], axis=1).argmax())
    across = np.cross(points - points[a], points[b] - points[a])
    c = int(np.linalg.norm(across, axis=1).argmax())
    height = (points - points[a]) @ across[c]
    d = int(np.abs(height).argmax())
    if not abs(height[d]) > 1e-6 * size**3:
        raise SceneError("hull: points: use points that do not lie in one plane (got points that do)")
    if height[d] > 0:  # across[c] then points into the tetrahedron from the face (a, c, b), as c x b does
        b, c = c, b
    return {triangle: _plane(points, triangle) for triangle in [(a, c, b), (a, b, d), (b, c, d), (c, a, d)]}


def _plane(points: Array, triangle: tuple[int, int, int]) -> tuple[Array, float]:
    a, b, c = points[list(triangle)]
    normal = np.cross(b - a, c - a)
    normal = normal / max(np.linalg.norm(normal), np.finfo(float).tiny)
    return normal, float(normal.dot(a))


def _edges(face: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(zip(face, face[1:] + face[:1], strict=True))


def _merge(points: Array, faces: dict[tuple[int, int, int], tuple[Array, float]]) -> list[list[int]]:
    """Triangles of one plane become a polygon, without the corners that lie on its edges."""
    planes: list[tuple[Array, set[int]]] = []
    by_size = sorted(faces.items(), key=lambda item: -_area(points, item[0]))  # slivers know no normal
    for triangle, (normal, _) in by_size:
        plane = next((corners for other, corners in planes if other.dot(normal) > 1 - 1e-10), None)
        if plane is None:
            planes.append((normal, plane := set()))
        plane.update(triangle)
    return [_loop(points, normal, sorted(corners)) for normal, corners in planes]


def _area(points: Array, triangle: tuple[int, int, int]) -> float:
    a, b, c = points[list(triangle)]
    return float(np.linalg.norm(np.cross(b - a, c - a)))


def _loop(points: Array, normal: Array, corners: list[int]) -> list[int]:
    """The corners of a convex polygon around its normal."""
    offsets = points[corners] - points[corners].mean(axis=0)
    along = offsets[np.linalg.norm(offsets, axis=1).argmax()]
    angles = np.arctan2(offsets @ np.cross(normal, along), offsets @ along)  # both of the same length
    order = np.argsort(angles)
    ring = points[corners][order]
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = np.cross(before, after) @ normal
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return [corners[k] for k, sharp in zip(order, turn > 1e-7 * lengths, strict=True) if sharp]
