"""Tables of strains of second degree, read by compiled loops: `rom.strain_tables` and `rom.carried_strains`.

A shape q (m,) has n = (m + 1)(m + 2)/2 products x_k x_l (k <= l) of x = (1, q), row by row, of squares the half. The
table makes of these the upper triangle of ½ K(x), row by row, whose entries of q are K (m, m) here, and whose first row
has what is linear. Strains y (n - 1,) are the same products but for the first.

Tables are symmetric, and kept as `folded` ones (N, N): what is below the diagonal is 0, what is on it is half. N is a
multiple of eight, so that rows begin on cache lines; vectors are filled up with zeros.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_products import ROWS, add_rows

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
    """Sets a folded table (N, N) times a vector (N,), or times two (2, N)."""
    into[:] = 0.0
    for i in range(0, len(table), ROWS):
        add_rows(table, i, given, into)


@jit_part
def unfold(upper: Array, K: Array) -> None:
    """Sets the symmetric matrix (m, m) of an upper triangle, row by row, which may be followed by more."""
    m = len(K)
    at = 0
    for i in range(m):
        for j in range(i, m):
            K[i, j] = K[j, i] = upper[at]
            at += 1
