"""Where triangles are nearest to points: `mechanics.triangles`, compiled."""

import numpy as np

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.mechanics import frame_motion
from fenics_rom.mechanics.frame_motion import Vector

added, dot = map(jit_shared, (frame_motion.added, frame_motion.dot))

_TINY = float(np.finfo(float).tiny)


@jit_part
def nearest_on_triangle(point: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Weights of the corners where a triangle is nearest to a point."""
    u, v, w = added(b, -1.0, a), added(c, -1.0, a), added(point, -1.0, a)
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    twice_area = max(uu * vv - uv * uv, _TINY)
    of_b, of_c = (vv * uw - uv * vw) / twice_area, (uu * vw - uv * uw) / twice_area
    if min(1 - of_b - of_c, of_b, of_c) >= 0:
        return 1 - of_b - of_c, of_b, of_c
    # beyond: the nearest point is on an edge
    first, off_first = _share_along(point, a, b)
    second, off_second = _share_along(point, b, c)
    third, off_third = _share_along(point, c, a)
    if off_first <= off_second and off_first <= off_third:
        return 1 - first, first, 0.0
    if off_second <= off_third:
        return 0.0, 1 - second, second
    return third, 0.0, 1 - third


@jit_part
def offset_from(point: Vector, share: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Of a point from the place of a triangle that has these weights of its corners, m."""
    foot = added(added((share[0] * a[0], share[0] * a[1], share[0] * a[2]), share[1], b), share[2], c)
    return added(point, -1.0, foot)


@jit_part
def _share_along(point: Vector, a: Vector, b: Vector) -> tuple[float, float]:
    """How far along an edge it is nearest to a point, as a share, and the square of how near, m²."""
    along = added(b, -1.0, a)
    share = min(max(dot(added(point, -1.0, a), along) / max(dot(along, along), _TINY), 0.0), 1.0)
    off = added(added(a, share, along), -1.0, point)
    return share, dot(off, off)
