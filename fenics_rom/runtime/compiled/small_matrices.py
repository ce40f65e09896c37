"""Products with few rows, and symmetric matrices, by compiled loops: these are sooner done than calls."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums
from fenics_rom.mechanics.compiled.copying import fill

NEAREST = 512  # numbers of a row: six of them fit into the nearest cache


@jit_sums
def dot(a: Array, b: Array) -> float:
    """a·b."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@jit_sums
def multiply(A: Array, x: Array, into: Array) -> None:
    """Sets A x."""
    for i in range(len(A)):
        row, total = A[i], 0.0
        for k in range(len(x)):
            total += row[k] * x[k]
        into[i] = total


@jit_part
def add_products(a: Array, x: Array, b: Array, y: Array, c: Array, z: Array, into: Array) -> None:
    """Adds the products of three pairs of arrays (n,), each number with that beside it."""
    for k in range(len(into)):
        into[k] += a[k] * x[k] + b[k] * y[k] + c[k] * z[k]


@jit_part
def set_row_products(A: Array, B: Array, upper: bool, into: Array) -> None:
    """Sets A Bᵀ (m, m) of rows (m, n), or at least what of it is on and above the diagonal.

    Two rows by four at once, of parts that stay in the nearest cache, so that numbers are read less often.
    """
    m, n = len(into), A.shape[1]
    fill(into, 0.0)
    for first in range(0, n, NEAREST):
        end = min(first + NEAREST, n)
        for j in range(0, m // 4 * 4, 4):
            for i in range(0, min(j + 4, m) if upper else m // 2 * 2, 2):
                _add_products_of_rows(A, i, B, j, first, end, into)
        for i in range(m):
            for j in range(m // 4 * 4, m):
                into[i, j] += dot(A[i, first:end], B[j, first:end])
        for j in range(0 if upper or m % 2 == 0 else m // 4 * 4):
            into[m - 1, j] += dot(A[m - 1, first:end], B[j, first:end])


@jit_sums
def _add_products_of_rows(A: Array, i: int, B: Array, j: int, begin: int, end: int, into: Array) -> None:
    """Adds the products of two rows from i on and four from j on, of some numbers, where they are in a matrix."""
    row, next_row = A[i, begin:end], A[i + 1, begin:end]
    first, second, third, fourth = B[j, begin:end], B[j + 1, begin:end], B[j + 2, begin:end], B[j + 3, begin:end]
    a = b = c = d = e = f = g = h = 0.0
    for k in range(len(row)):
        x, y = row[k], next_row[k]
        a, b, c, d = a + x * first[k], b + x * second[k], c + x * third[k], d + x * fourth[k]
        e, f, g, h = e + y * first[k], f + y * second[k], g + y * third[k], h + y * fourth[k]
    for n, sums in enumerate(((a, b, c, d), (e, f, g, h))):
        for k, added in enumerate(sums):
            into[i + n, j + k] += added


@jit_part
def square_by(A: Array, x: Array) -> float:
    """x·A x."""
    total = 0.0
    for i in range(len(x)):
        total += x[i] * dot(A[i], x)
    return total


@jit_part
def factor(A: Array) -> bool:
    """Sets U above the diagonal of A = UᵀU, with 1/U on it; whether A is positive definite."""
    m = len(A)
    for k in range(m):
        row = A[k]
        if not row[k] > 0:
            return False
        row[k] = 1 / math.sqrt(row[k])
        for j in range(k + 1, m):
            row[j] *= row[k]
        for i in range(k + 1, m):
            below, share = A[i], row[i]
            for j in range(i, m):
                below[j] -= share * row[j]
    return True


@jit_part
def solve(U: Array, x: Array) -> None:
    """Sets A⁻¹ x, by the factor of A."""
    m = len(x)
    for i in range(m):
        row = U[i]
        x[i] *= row[i]
        for j in range(i + 1, m):
            x[j] -= row[j] * x[i]
    for i in range(m - 1, -1, -1):
        row = U[i]
        x[i] = (x[i] - dot(row[i + 1 :], x[i + 1 :])) * row[i]


@jit_part
def solve_rows(U: Array, X: Array) -> None:
    """Sets U⁻ᵀ X of rows (m, n), by the factor U with 1/U on its diagonal."""
    for i in range(len(U)):
        row, own = U[i], X[i]
        for k in range(i):
            share, other = U[k, i], X[k]
            for j in range(len(own)):
                own[j] -= share * other[j]
        for j in range(len(own)):
            own[j] *= row[i]


@jit_part
def squares(X: Array, into: Array) -> None:
    """Sets XᵀX (n, n) of rows (m, n), symmetric to the bit."""
    for i in range(len(into)):
        row = into[i, i:]
        for j in range(len(row)):
            row[j] = 0.0
        for k in range(len(X)):
            share, other = X[k, i], X[k, i:]
            for j in range(len(row)):
                row[j] += share * other[j]
    for i in range(len(into)):
        for j in range(i):
            into[i, j] = into[j, i]


@jit_part
def invert(U: Array, into: Array) -> None:
    """Sets A⁻¹ by the factor of A, symmetric to the bit."""
    X = np.zeros(U.shape)
    for i in range(len(U)):
        X[i, i] = 1.0
    solve_rows(U, X)
    squares(X, into)
