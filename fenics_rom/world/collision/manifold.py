"""A polygon clipped to a face: where two flat faces meet. In Python's floats, as these are a few points."""

import numpy as np
from numpy import ndarray as Array

MOST = 8  # pairs that are kept
_LABELS = 1 << 10  # more than two polygons have edges
NUMBERS = _LABELS * _LABELS  # more than pairs of them
_SPREAD = np.linspace(0.0, 2 * np.pi, MOST, endpoint=False)
Vector = list[float]
Clipped = tuple[list[Vector], list[float], list[int]]


def clip(face: list[Vector], polygon: list[Vector], normal: Vector, margin: float) -> Clipped:
    """What of a polygon lies above or below a face, and not farther above than a margin (Sutherland-Hodgman).

    Args:
        face: corners, counterclockwise about its normal.
        polygon: corners, around.
        normal: unit.
        margin: m.

    Returns:
        Corners of the clipped polygon, m; gaps above the face, m; and numbers < NUMBERS of which edges meet there.
    """
    nx, ny, nz = normal
    # each corner with the label of the edge that leads to it; sides of the face are labelled after the polygon's own
    count = len(polygon)
    ring = [(x, y, z, (k - 1) % count) for k, (x, y, z) in enumerate(polygon)]
    for side, (ax, ay, az) in enumerate(face):
        bx, by, bz = face[(side + 1) % len(face)]
        dx, dy, dz = bx - ax, by - ay, bz - az
        ox, oy, oz = dy * nz - dz * ny, dz * nx - dx * nz, dx * ny - dy * nx  # out of the face
        level = ox * ax + oy * ay + oz * az
        heights = [ox * x + oy * y + oz * z - level for x, y, z, _ in ring]
        if max(heights) <= 0:
            continue
        clipped = []
        for k, (x, y, z, label) in enumerate(ring):
            height, before = heights[k], heights[k - 1]
            if (height > 0) != (before > 0):
                px, py, pz, _ = ring[k - 1]
                share = before / (before - height)
                cut = px + share * (x - px), py + share * (y - py), pz + share * (z - pz)
                # going out, the edge of old is followed to the side; coming in, the side has led to it
                clipped.append((*cut, label if height > 0 else count + side))
            if height <= 0:
                clipped.append((x, y, z, label))
        ring = clipped
        if not ring:
            return [], [], []
    fx, fy, fz = face[0]
    level = nx * fx + ny * fy + nz * fz
    places, gaps, feature = [], [], []
    for k, (x, y, z, label) in enumerate(ring):
        gap = nx * x + ny * y + nz * z - level
        if gap <= margin:
            places.append([x, y, z])
            gaps.append(gap)
            feature.append(label * _LABELS + ring[(k + 1) % len(ring)][3])
    return places, gaps, feature


def thinned(places: Array, gaps: Array, normal: Array) -> Array:
    """Rows of at most eight of the places: the nearest, and the farthest out in directions around the normal."""
    if len(places) <= MOST:
        return np.arange(len(places))
    along = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    flat = (places - places.mean(axis=0)) @ np.stack([along, np.cross(normal, along)], axis=1)
    outmost = (flat @ np.stack([np.cos(_SPREAD), np.sin(_SPREAD)])).argmax(axis=0)
    return np.unique(np.append(outmost[:-1], gaps.argmin()))
