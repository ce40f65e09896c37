"""Families of fibres at the points of a body, compiled: `mechanics.fibres`, whose laws they are.

Each is a row: which law, its modulus with the weight of its point, J, its stiffening, and the six numbers of M.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.fibres import FIBRE_LAWS, LARGEST_EXPONENT, SHORTEST, Fibres

QUADRATIC, HOLZAPFEL, SHEET = range(3)
LAWS = ("quadratic", "holzapfel", "sheet")  # in this order
AT_REST = np.array([FIBRE_LAWS[law].at_rest for law in LAWS])  # ψ''(0) over the modulus
SMALLEST = np.finfo(float).eps  # stiffening below which the law is a parabola
WIDTH = 9
Six = tuple[float, float, float, float, float, float]


def threads_of(families: tuple[Fibres, ...], count: int) -> tuple[Array, Array]:
    """Where those of each of so many points begin, (count + 1,), and rows (K, 9)."""
    points = np.concatenate([np.empty(0, dtype=np.int64), *(family.points for family in families)])
    rows = [
        np.column_stack(
            [np.full(len(each.points), LAWS.index(each.law)), each.modulus, each.stiffening, each.structure.T]
        )
        for each in families
    ]
    order = points.argsort(kind="stable")
    return points[order].searchsorted(np.arange(count + 1)), np.concatenate([np.empty((0, WIDTH)), *rows])[order]


@jit_part
def strain_along(threads: Array, t: int, E: Six) -> float:
    """e = M:E."""
    total = threads[t, 3] * E[0] + threads[t, 4] * E[1] + threads[t, 5] * E[2]
    return total + threads[t, 6] * E[3] + threads[t, 7] * E[4] + threads[t, 8] * E[5]


@jit_part
def _stretch(e: float) -> float:
    return math.sqrt(max(1 + 2 * e, SHORTEST))


@jit_part
def _parted(e: float, s: float) -> tuple[float, float, float]:
    """2e where it is positive up to where W is a parabola, by how much it is beyond, and s times its square."""
    most = math.sqrt(LARGEST_EXPONENT / max(s, 1e-12))
    known = min(max(2 * e, 0.0), most)
    return known, max(2 * e - most, 0.0), s * known * known


@jit_part
def energy_along(threads: Array, t: int, e: float) -> float:
    """k ψ, J."""
    if threads[t, 0] == SHEET:
        return threads[t, 1] * e * e / 2
    if threads[t, 0] == QUADRATIC:
        lengthened = 2 * e / (1 + _stretch(e))
        return threads[t, 1] * lengthened * lengthened / 2
    s = threads[t, 2]
    x, beyond, square = _parted(e, s)
    energy = x * x / 2 if s < SMALLEST else math.expm1(square) / (2 * s)
    grown = math.exp(square)
    return threads[t, 1] * (energy + beyond * (x * grown + beyond * (1 + 2 * square) * grown / 2))


@jit_part
def slope_along(threads: Array, t: int, e: float) -> float:
    """k ψ'."""
    if threads[t, 0] == SHEET:
        return threads[t, 1] * e
    if threads[t, 0] == QUADRATIC:
        stretch = _stretch(e)
        return threads[t, 1] * 2 * e / (1 + stretch) / stretch
    x, beyond, square = _parted(e, threads[t, 2])
    return threads[t, 1] * 2 * math.exp(square) * (x + beyond * (1 + 2 * square))


@jit_part
def curvature_along(threads: Array, t: int, e: float) -> float:
    """k ψ''."""
    if threads[t, 0] == SHEET:
        return threads[t, 1]
    if threads[t, 0] == QUADRATIC:
        return threads[t, 1] / _stretch(e) ** 3
    square = _parted(e, threads[t, 2])[2]
    return threads[t, 1] * 4 * (1 + 2 * square) * math.exp(square) if e > 0 else 0.0


@jit_part
def stiffness_at_rest(threads: Array, t: int) -> float:
    """k ψ''(0)."""
    return threads[t, 1] * AT_REST[int(threads[t, 0])]


@jit_part
def pulled_along(threads: Array, t: int, size: float, S: Six) -> Six:
    """Stresses with so many times M."""
    a, b, c = S[0] + size * threads[t, 3], S[1] + size * threads[t, 4], S[2] + size * threads[t, 5]
    return a, b, c, S[3] + size * threads[t, 6], S[4] + size * threads[t, 7], S[5] + size * threads[t, 8]


@jit_part
def add_along(threads: Array, t: int, size: float, p: int, into: Array) -> None:
    """Adds to moduli (6, 6, P) of point p so many times M⊗M."""
    for c in range(6):
        for d in range(6):
            into[c, d, p] += size * threads[t, 3 + c] * threads[t, 3 + d]
