"""Linear equations with few unknowns, by elimination of four of them at once: Gauss's, without a search for pivots.

Rows are as wide as instructions of vectors take numbers, so that no loop over a row has a rest.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_products import LANES, ROWS, subtract_before, subtract_rows
from fenics_rom.mechanics.compiled.work_space import rows_of


class Block(NamedTuple):
    """Four rows that have been eliminated, from row and column k on."""

    k: int
    inverse: tuple[float, float, float, float]  # of what is on the diagonal
    above: tuple[float, float, float, float, float, float]  # it, row after row


@jit_part
def _shares_of(row: Array, block: Block) -> tuple[float, float, float, float]:
    """Of four rows, which a later one has."""
    k, (p, q, r, s), (ab, ac, ad, bc, bd, cd) = block
    a = row[k] * p
    b = (row[k + 1] - a * ab) * q
    c = (row[k + 2] - a * ac - b * bc) * r
    return a, b, c, (row[k + 3] - a * ad - b * bd - c * cd) * s


@jit_part
def numbers_for(n: int) -> Array:
    """Room for a matrix of n equations, or of fewer: see `matrix_in`."""
    return np.empty((n + ROWS) * (n + LANES))


@jit_part
def matrix_in(numbers: Array, n: int) -> Array:
    """Rows for n equations, of which the first n numbers are to be set; whoever keeps the numbers keeps it."""
    return rows_of(numbers, (n + LANES - 1) // LANES * LANES)


@jit_part
def solve(A: Array, x: Array, n: int) -> bool:
    """Solves n equations in place; False where a pivot is 0. What comes of small ones is for whoever asks to look at.

    Args:
        A: of `matrix_in`.
        x: the right-hand sides, with room for three more numbers.
        n: how many.
    """
    end = (n + ROWS - 1) // ROWS * ROWS
    for i in range(n, end):  # further unknowns, which are 0; what is beside them in a row does not matter
        x[i] = 0.0
        for j in range(end):
            A[i, j] = 1.0 if i == j else 0.0
        for j in range(n):
            A[j, i] = 0.0
    for k in range(0, end, ROWS):
        a, b, c, d, x0 = A[k], A[k + 1], A[k + 2], A[k + 3], x[k]
        p, ab, ac, ad = 1 / a[k], a[k + 1], a[k + 2], a[k + 3]
        ba, ca, da = b[k] * p, c[k] * p, d[k] * p
        bb, bc, bd = b[k + 1] - ba * ab, b[k + 2] - ba * ac, b[k + 3] - ba * ad
        q = 1 / bb
        cb, db = (c[k + 1] - ca * ab) * q, (d[k + 1] - da * ab) * q
        cc, cd = c[k + 2] - ca * ac - cb * bc, c[k + 3] - ca * ad - cb * bd
        r = 1 / cc
        dc = (d[k + 2] - da * ac - db * bc) * r
        dd = d[k + 3] - da * ad - db * bd - dc * cd
        if a[k] == 0.0 or bb == 0.0 or cc == 0.0 or dd == 0.0:
            return False
        s, first = 1 / dd, (k + ROWS) // LANES * LANES
        within = (0.0, 0.0, 0.0, 0.0, ba, 0.0, 0.0, 0.0, ca, cb, 0.0, 0.0, da, db, dc, 0.0)
        subtract_before(A, k, first, within)
        a[k], b[k + 1], c[k + 2], d[k + 3] = p, q, r, s
        b[k + 2], b[k + 3], c[k + 3] = bc, bd, cd
        x1 = x[k + 1] - ba * x0
        x2 = x[k + 2] - ca * x0 - cb * x1
        x3 = x[k + 3] - da * x0 - db * x1 - dc * x2
        x[k + 1], x[k + 2], x[k + 3] = x1, x2, x3
        block = Block(k, (p, q, r, s), (ab, ac, ad, bc, bd, cd))
        for i in range(k + ROWS, end, ROWS):
            one, two, three, four = (
                _shares_of(A[i], block),
                _shares_of(A[i + 1], block),
                _shares_of(A[i + 2], block),
                _shares_of(A[i + 3], block),
            )
            subtract_rows(A, i, k, first, one + two + three + four)
            x[i] -= one[0] * x0 + one[1] * x1 + one[2] * x2 + one[3] * x3
            x[i + 1] -= two[0] * x0 + two[1] * x1 + two[2] * x2 + two[3] * x3
            x[i + 2] -= three[0] * x0 + three[1] * x1 + three[2] * x2 + three[3] * x3
            x[i + 3] -= four[0] * x0 + four[1] * x1 + four[2] * x2 + four[3] * x3
    for k in range(end - ROWS, -1, -ROWS):
        a, b, c, d, x0, x1, x2, x3 = A[k], A[k + 1], A[k + 2], A[k + 3], x[k], x[k + 1], x[k + 2], x[k + 3]
        for j in range(k + ROWS, end):
            found = x[j]
            x0, x1, x2, x3 = x0 - a[j] * found, x1 - b[j] * found, x2 - c[j] * found, x3 - d[j] * found
        x3 *= d[k + 3]
        x2 = (x2 - c[k + 3] * x3) * c[k + 2]
        x1 = (x1 - b[k + 2] * x2 - b[k + 3] * x3) * b[k + 1]
        x[k] = (x0 - a[k + 1] * x1 - a[k + 2] * x2 - a[k + 3] * x3) * a[k]
        x[k + 1], x[k + 2], x[k + 3] = x1, x2, x3
    return True
