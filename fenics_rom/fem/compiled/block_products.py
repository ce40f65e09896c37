"""Sparse matrices of 3 x 3 blocks times many columns at once, and what conjugate gradients do with the columns.

A block is read once for all columns, whose numbers stand beside each other, so that one instruction takes several.
Arrays: starts (R + 1,), columns (b,), blocks (b, 3, 3) of R rows of blocks; x, y (3 R or 3 C, k).
"""

from numpy import ndarray as Array

from fenics_rom.compiled_products import LANES, add_row_of_blocks


def multiply(starts: Array, columns: Array, blocks: Array, x: Array, y: Array, fresh: bool) -> None:
    """y = A x where fresh, else y += A x."""
    k = x.shape[1]
    full = k % LANES == 0
    for row in range(len(starts) - 1):
        y0, y1, y2 = y[3 * row], y[3 * row + 1], y[3 * row + 2]
        if fresh:
            for c in range(k):
                y0[c] = y1[c] = y2[c] = 0
        if full:
            add_row_of_blocks(row, starts, columns, blocks, x, y)
            continue
        for entry in range(starts[row], starts[row + 1]):
            first, a = 3 * columns[entry], blocks[entry]
            x0, x1, x2 = x[first], x[first + 1], x[first + 2]
            a00, a01, a02 = a[0, 0], a[0, 1], a[0, 2]
            a10, a11, a12 = a[1, 0], a[1, 1], a[1, 2]
            a20, a21, a22 = a[2, 0], a[2, 1], a[2, 2]
            for c in range(k):
                u, v, w = x0[c], x1[c], x2[c]
                y0[c] += a00 * u + a01 * v + a02 * w
                y1[c] += a10 * u + a11 * v + a12 * w
                y2[c] += a20 * u + a21 * v + a22 * w


def add_transposed(starts: Array, columns: Array, blocks: Array, x: Array, y: Array) -> None:
    """y += Aᵀ x."""
    k = x.shape[1]
    for row in range(len(starts) - 1):
        x0, x1, x2 = x[3 * row], x[3 * row + 1], x[3 * row + 2]
        for entry in range(starts[row], starts[row + 1]):
            first, a = 3 * columns[entry], blocks[entry]
            y0, y1, y2 = y[first], y[first + 1], y[first + 2]
            a00, a01, a02 = a[0, 0], a[0, 1], a[0, 2]
            a10, a11, a12 = a[1, 0], a[1, 1], a[1, 2]
            a20, a21, a22 = a[2, 0], a[2, 1], a[2, 2]
            for c in range(k):
                u, v, w = x0[c], x1[c], x2[c]
                y0[c] += a00 * u + a10 * v + a20 * w
                y1[c] += a01 * u + a11 * v + a21 * w
                y2[c] += a02 * u + a12 * v + a22 * w


def relax(product: Array, b: Array, inverse: Array, d: Array, x: Array, kept: Array, share: Array) -> None:
    """d = kept d + share D⁻¹(b - product), x += d; `inverse` (n,) of D, `kept` and `share` (1,)."""
    for row in range(len(x)):
        before, weight = kept[0], share[0] * inverse[row]
        for c in range(x.shape[1]):
            d[row, c] = before * d[row, c] + weight * (b[row, c] - product[row, c])
            x[row, c] += d[row, c]


def advance(α: Array, p: Array, q: Array, x: Array, r: Array, squares: Array) -> None:
    """x += α p, r -= α q for α (k,) of each column; squares (k,) = |r|²."""
    for c in range(x.shape[1]):
        squares[c] = 0
    for row in range(len(x)):
        for c in range(x.shape[1]):
            x[row, c] += α[c] * p[row, c]
            r[row, c] -= α[c] * q[row, c]
            squares[c] += r[row, c] * r[row, c]


def turn(β: Array, z: Array, scale: Array, p: Array) -> None:
    """p = scale z + β p for β and scale (k,) of each column."""
    for row in range(len(p)):
        for c in range(p.shape[1]):
            p[row, c] = scale[c] * z[row, c] + β[c] * p[row, c]


def dots(a: Array, b: Array, sums: Array) -> None:
    """sums (k,) = aᵀb of each pair of columns."""
    for c in range(a.shape[1]):
        sums[c] = 0
    for row in range(len(a)):
        for c in range(a.shape[1]):
            sums[c] += a[row, c] * b[row, c]
