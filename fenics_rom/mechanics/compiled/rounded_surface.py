"""What points meet of surfaces whose edges are rounded: `mechanics.rounded_surface`, compiled."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.triangles import added, dot
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.mechanics.rounded_surface import BEYOND, INSIDE, STEEPEST

Corners = tuple[float, float, float, float, float, float]  # x, y of three

_TINY = float(np.finfo(float).tiny)


@jit_part
def meet_rounded(
    point: Vector,
    corners: Array,
    triangles: Array,
    t: int,
    radii: Array,
    nodes: Array,
    around: Array,
    margin: float,
    share: Vector,
    flat: Vector,
    gap: float,
    carriers: Array,
    weights: Array,
) -> tuple[Vector, float]:
    """As `rounded_surface.rounded`, of one point; sets its carriers and weights (c,), and tells its normal and gap.

    Args:
        point: m.
        corners, triangles: of the surface, (Q, 3), m, and (T, 3) rows of these.
        t: the triangle that is nearest.
        radii, nodes, around: of `Rounding`.
        margin: m.
        share: weights of the corners of that triangle.
        flat, gap: normal and gap of flat triangles.
    """
    own = triangles[t]
    for k in range(len(weights)):
        carriers[k], weights[k] = own[0], 0.0
    for k in range(3):
        carriers[k], weights[k] = own[k], share[k]
    radius = share[0] * radii[own[0]] + share[1] * radii[own[1]] + share[2] * radii[own[2]]
    if not abs(gap) <= radius:
        return flat, gap
    a, n = _vector(corners, own[0]), _normal(corners, own)
    along = added(_vector(corners, own[1]), -1.0, a)
    size = math.sqrt(dot(along, along)) * radius
    x = along[0] / size, along[1] / size, along[2] / size
    y = n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]
    seen = _seen(point, corners, own, x, y)
    if _distance_to_sides(seen) >= 1.0:
        return flat, gap
    at, slope_x, slope_y = _weights_at_centre(seen)
    is_met, left, to_x, to_y, mean = min(at[0], at[1], at[2]) >= INSIDE, 1.0, 0.0, 0.0, (0.0, 0.0, 0.0)
    w = np.zeros(len(weights))
    for m in range(around.shape[1]):
        other = around[t, m, 0]
        if other < 0:
            break
        tilt = _normal(corners, triangles[other])
        cosine = dot(n, tilt)
        if not cosine > STEEPEST:
            continue
        beside = _seen(point, corners, triangles[other], x, y)
        here, along_x, along_y = _weights_at_centre(beside)
        is_met = is_met or min(here[0], here[1], here[2]) >= INSIDE
        part, moment_x, moment_y = _in_disc(beside)
        if part == 0.0:
            continue
        left, to_x, to_y = left - part, to_x - moment_x, to_y - moment_y
        mean = added(mean, part / cosine, tilt)
        for k in range(3):
            w[around[t, m, 1 + k]] += part * here[k] + moment_x * along_x[k] + moment_y * along_y[k]
    above = dot(added(point, -1.0, a), n)
    beyond = math.sqrt(max(gap * gap - above * above, 0.0))
    if not (is_met or (above >= 0 and beyond <= BEYOND * margin)):
        return flat, gap
    for k in range(3):
        w[k] += left * at[k] + to_x * slope_x[k] + to_y * slope_y[k]
    mean = added(mean, left, n)
    size = math.sqrt(dot(mean, mean))
    mean, offset = (mean[0] / size, mean[1] / size, mean[2] / size), point
    for k in range(len(weights)):
        weights[k], carriers[k] = w[k], nodes[t, k] if w[k] != 0.0 else own[0]
        offset = added(offset, -w[k], _vector(corners, carriers[k]))
    return mean, dot(mean, offset)


@jit_part
def _in_disc(corners: Corners) -> tuple[float, float, float]:
    """As `rounded_surface.in_disc`, of one triangle."""
    area, to_x, to_y = 0.0, 0.0, 0.0
    for k in range(3):
        ax, ay = _corner(corners, k)
        bx, by = _corner(corners, (k + 1) % 3)
        dx, dy = bx - ax, by - ay
        square, half = max(dx * dx + dy * dy, _TINY), ax * dx + ay * dy
        root = math.sqrt(max(half * half - square * (ax * ax + ay * ay - 1), 0.0))
        first = min(max((-root - half) / square, 0.0), 1.0)
        last = min(max((root - half) / square, 0.0), 1.0)
        px, py, qx, qy = ax + first * dx, ay + first * dy, ax + last * dx, ay + last * dy
        twice = px * qy - py * qx
        before, after = _sector(ax, ay, px, py), _sector(qx, qy, bx, by)
        area += twice / 2 + before[0] + after[0]
        to_x += twice * (px + qx) / 6 + before[1] + after[1]
        to_y += twice * (py + qy) / 6 + before[2] + after[2]
    return area / math.pi, to_x / math.pi, to_y / math.pi


@jit_part
def _sector(ax: float, ay: float, bx: float, by: float) -> tuple[float, float, float]:
    """Area and moments of the unit disc's sector between the directions of two places."""
    if ax == bx and ay == by:
        return 0.0, 0.0, 0.0
    a, b = max(math.sqrt(ax * ax + ay * ay), _TINY), max(math.sqrt(bx * bx + by * by), _TINY)
    angle = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
    return angle / 2, (by / b - ay / a) / 3, (ax / a - bx / b) / 3


@jit_part
def _weights_at_centre(corners: Corners) -> tuple[Vector, Vector, Vector]:
    """As `rounded_surface.weights_at_centre`, of one triangle: weights, and their slopes along x and y."""
    ax, ay, bx, by, cx, cy = corners
    a, b, c = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    twice = a + b + c
    slope_x = (by - cy) / twice, (cy - ay) / twice, (ay - by) / twice
    slope_y = (cx - bx) / twice, (ax - cx) / twice, (bx - ax) / twice
    return (a / twice, b / twice, c / twice), slope_x, slope_y


@jit_part
def _distance_to_sides(corners: Corners) -> float:
    """From the centre to the nearest side of a triangle, < 0 outside."""
    nearest = math.inf
    for k in range(3):
        ax, ay = _corner(corners, k)
        bx, by = _corner(corners, (k + 1) % 3)
        dx, dy = bx - ax, by - ay
        nearest = min(nearest, (ax * dy - ay * dx) / math.sqrt(dx * dx + dy * dy))
    return nearest


@jit_part
def _corner(corners: Corners, k: int) -> tuple[float, float]:
    ax, ay, bx, by, cx, cy = corners
    if k == 0:
        return ax, ay
    if k == 1:
        return bx, by
    return cx, cy


@jit_part
def _seen(point: Vector, corners: Array, triangle: Array, x: Vector, y: Vector) -> Corners:
    """Corners of a triangle in a disc about a point, by its axes."""
    a, b, c = (
        added(_vector(corners, triangle[0]), -1.0, point),
        added(_vector(corners, triangle[1]), -1.0, point),
        added(_vector(corners, triangle[2]), -1.0, point),
    )
    return dot(x, a), dot(y, a), dot(x, b), dot(y, b), dot(x, c), dot(y, c)


@jit_part
def _normal(corners: Array, triangle: Array) -> Vector:
    """A unit."""
    a = _vector(corners, triangle[0])
    u, v = added(_vector(corners, triangle[1]), -1.0, a), added(_vector(corners, triangle[2]), -1.0, a)
    n = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    size = math.sqrt(dot(n, n))
    return n[0] / size, n[1] / size, n[2] / size


@jit_part
def _vector(rows: Array, k: int) -> Vector:
    return rows[k, 0], rows[k, 1], rows[k, 2]
