"""Products with few rows, and symmetric matrices, by compiled loops: these are sooner done than calls."""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums


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
    for i in range(len(U)):
        into[i] = 0.0
        into[i, i] = 1.0
        solve(U, into[i])
        for j in range(i):
            into[i, j] = into[j, i] = (into[i, j] + into[j, i]) / 2
