"""Tables of strains of second degree, read by compiled loops: `rom.strain_tables` and `rom.carried_strains`.

A shape q (m,) has n = (m + 1)(m + 2)/2 products x_k x_l (k <= l) of x = (1, q), row by row, of squares the half. The
table makes of these the upper triangle of ½ K(x), row by row, whose entries of q are K (m, m) here, and whose first row
has what is linear. Strains y (n - 1,) are the same products but for the first.

Tables are symmetric, and kept as `folded` ones (N, N): what is below the diagonal is 0, what is on it is half. N is a
multiple of eight, so that rows begin on cache lines; vectors are filled up with zeros.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums

LINE = 8  # numbers on a cache line


def folded(matrix: Array, first: int = 0) -> Array:
    """A symmetric matrix as `read` takes it, after so many rows and columns of zeros."""
    n = first + len(matrix)
    size = padded(n)
    room = np.zeros(size * size + LINE)
    start = -room.ctypes.data % (8 * LINE) // 8
    table: Array = room[start : start + size * size].reshape(size, size)
    upper = np.triu(matrix)
    np.fill_diagonal(upper, upper.diagonal() / 2)
    table[first:n, first:n] = upper
    return table


def padded(n: int) -> int:
    """Of so many numbers, with those that fill up the last cache line."""
    return -(-n // LINE) * LINE


@jit_part
def set_products(one: float, q: Array, p: Array) -> None:
    """Of x = (one, q), the first n of p."""
    m = len(q)
    p[0], at = one * one / 2, m + 1
    for i in range(m):
        p[1 + i] = one * q[i]
        p[at] = q[i] * q[i] / 2
        for j in range(i + 1, m):
            p[at + j - i] = q[i] * q[j]
        at += m - i


@jit_part
def set_strains(q: Array, y: Array) -> None:
    """y of E(q)."""
    m = len(q)
    at = m
    for i in range(m):
        y[i] = q[i]
        y[at] = q[i] * q[i] / 2
        for j in range(i + 1, m):
            y[at + j - i] = q[i] * q[j]
        at += m - i


@jit_part
def add_rates(q: Array, v: Array, size: float, y: Array) -> None:
    """Adds to y what it changes by at q with v (m,), so many times."""
    m = len(q)
    at = m
    for i in range(m):
        y[i] += size * v[i]
        y[at] += size * q[i] * v[i]
        for j in range(i + 1, m):
            y[at + j - i] += size * (q[i] * v[j] + q[j] * v[i])
        at += m - i


@jit_part
def read(table: Array, given: Array, into: Array) -> None:
    """Sets a folded table (N, N) times two vectors (2, N).

    Four rows at once add to their own results and to those of all later rows; the second vector finds them in the
    fastest cache.
    """
    for k in range(2):
        for j in range(len(table)):
            into[k, j] = 0.0
    for i in range(0, len(table), 4):
        first, second, third, fourth = table[i, i:], table[i + 1, i:], table[i + 2, i:], table[i + 3, i:]
        for k in range(2):
            own, to = given[k, i:], into[k, i:]
            a, b, c, d = _read_four(first, second, third, fourth, own, own[0], own[1], own[2], own[3], to)
            to[0] += a
            to[1] += b
            to[2] += c
            to[3] += d


@jit_sums
def _read_four(
    first: Array,
    second: Array,
    third: Array,
    fourth: Array,
    given: Array,
    p: float,
    q: float,
    r: float,
    s: float,
    into: Array,
) -> tuple[float, float, float, float]:
    """What rows of a folded table have for themselves, from their diagonal on; adds what they have for all.

    Of these the given vector has p, q, r and s.
    """
    a = b = c = d = 0.0
    for j in range(len(first)):
        x, first_j, second_j, third_j, fourth_j = given[j], first[j], second[j], third[j], fourth[j]
        a += first_j * x
        b += second_j * x
        c += third_j * x
        d += fourth_j * x
        into[j] += first_j * p + second_j * q + third_j * r + fourth_j * s
    return a, b, c, d


@jit_part
def unfold(upper: Array, K: Array) -> None:
    """Sets the symmetric matrix (m, m) of an upper triangle, row by row, which may be followed by more."""
    m = len(K)
    at = 0
    for i in range(m):
        for j in range(i, m):
            K[i, j] = K[j, i] = upper[at]
            at += 1
