"""Tables of strains of second degree, read by compiled loops: `rom.strain_tables` and `rom.carried_strains`.

A shape q (m,) has n = (m + 1)(m + 2)/2 products x_k x_l (k <= l) of x = (1, q), row by row. The table makes of these
the upper triangle of ½ K(x), row by row, whose entries of q are K (m, m) here, and whose first row has what is linear.
Strains y (n - 1,) are the same products but for the first, of squares the half.
"""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums


@jit_part
def set_products(one: float, q: Array, p: Array) -> None:
    """Of x = (one, q), (n,)."""
    m = len(q)
    p[0], at = one, m + 1
    for i in range(m):
        p[1 + i] = one * q[i]
        for j in range(i, m):
            p[at] = q[i] * q[j]
            at += 1


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


@jit_sums
def read(table: Array, given: Array, into: Array) -> None:
    """Sets the table (n, n) times two vectors (2, n), in one pass with four rows at once."""
    n = len(table)
    a, b = given[0], given[1]
    for i in range(0, n - 3, 4):
        first, second, third, fourth = table[i], table[i + 1], table[i + 2], table[i + 3]
        a1 = a2 = a3 = a4 = b1 = b2 = b3 = b4 = 0.0
        for j in range(n):
            x, y = a[j], b[j]
            a1 += first[j] * x
            a2 += second[j] * x
            a3 += third[j] * x
            a4 += fourth[j] * x
            b1 += first[j] * y
            b2 += second[j] * y
            b3 += third[j] * y
            b4 += fourth[j] * y
        into[0, i], into[0, i + 1], into[0, i + 2], into[0, i + 3] = a1, a2, a3, a4
        into[1, i], into[1, i + 1], into[1, i + 2], into[1, i + 3] = b1, b2, b3, b4
    for i in range(n - n % 4, n):
        row = table[i]
        a1 = b1 = 0.0
        for j in range(n):
            a1 += row[j] * a[j]
            b1 += row[j] * b[j]
        into[0, i], into[1, i] = a1, b1


@jit_part
def unfold(upper: Array, K: Array) -> None:
    """Sets the symmetric matrix (m, m) of an upper triangle, row by row."""
    m = len(K)
    at = 0
    for i in range(m):
        for j in range(i, m):
            K[i, j] = K[j, i] = upper[at]
            at += 1
