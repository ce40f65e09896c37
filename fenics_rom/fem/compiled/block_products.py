"""Sparse matrices of 3 x 3 blocks times many columns at once, and what multigrid and conjugate gradients do with these.

A block is read once for all columns, whose numbers stand beside each other, so that one instruction takes several.
Arrays: starts (R + 1,), columns (b,), blocks (b, 3, 3) of R rows of blocks; x (3 C, k), y, b and old (3 R, k), where k
is full lanes. What is made of rows of the product is made while they are at hand.
"""

from numpy import ndarray as Array

from fenics_rom.compiled_products import add_row_of_blocks

ROWS_AT_HAND = 64  # rows of blocks


def multiply(starts: Array, columns: Array, blocks: Array, x: Array, y: Array, fresh: bool) -> None:
    """y = A x where fresh, else y += A x."""
    rows = len(starts) - 1
    for first in range(0, rows, ROWS_AT_HAND):
        last = min(first + ROWS_AT_HAND, rows)
        if fresh:
            y[3 * first : 3 * last] = 0
        for row in range(first, last):
            add_row_of_blocks(row, starts, columns, blocks, x, y)


def subtract(starts: Array, columns: Array, blocks: Array, x: Array, y: Array, fresh: bool, b: Array) -> None:
    """y = b - A x where fresh, else y = b - y - A x."""
    rows = len(starts) - 1
    for first in range(0, rows, ROWS_AT_HAND):
        last = min(first + ROWS_AT_HAND, rows)
        if fresh:
            y[3 * first : 3 * last] = 0
        for row in range(first, last):
            add_row_of_blocks(row, starts, columns, blocks, x, y)
        for r in range(3 * first, 3 * last):
            own, right = y[r], b[r]
            for c in range(x.shape[1]):
                own[c] = right[c] - own[c]


def relax(
    starts: Array,
    columns: Array,
    blocks: Array,
    x: Array,
    y: Array,
    fresh: bool,
    b: Array,
    inverse: Array,
    old: Array,
    shares: Array,
) -> None:
    """y = s_0 x + s_1 old + s_2 D⁻¹ (b - A x), where not fresh (b - y - A x); `inverse` (n,) of D, `shares` (3,)."""
    rows, of_last, of_old = len(starts) - 1, shares[0], shares[1]
    for first in range(0, rows, ROWS_AT_HAND):
        last = min(first + ROWS_AT_HAND, rows)
        if fresh:
            y[3 * first : 3 * last] = 0
        for row in range(first, last):
            add_row_of_blocks(row, starts, columns, blocks, x, y)
        for r in range(3 * first, 3 * last):
            own, right, here, before, weight = y[r], b[r], x[r], old[r], shares[2] * inverse[r]
            for c in range(x.shape[1]):
                own[c] = of_last * here[c] + of_old * before[c] + weight * (right[c] - own[c])


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


def divide(r: Array, scale: Array, into: Array) -> None:
    """into = r / scale for scale (k,) of each column, in the precision of `into`."""
    for row in range(len(r)):
        for c in range(r.shape[1]):
            into[row, c] = r[row, c] / scale[c]


def dots(a: Array, b: Array, sums: Array) -> None:
    """sums (k,) = aᵀb of each pair of columns."""
    for c in range(a.shape[1]):
        sums[c] = 0
    for row in range(len(a)):
        for c in range(a.shape[1]):
            sums[c] += a[row, c] * b[row, c]
