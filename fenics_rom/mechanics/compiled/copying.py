"""Copies of arrays by loops: what `to[:] = of`, or `to[k] = (a, b)`, may fail with takes numba a second to compile."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part


@jit_part
def copy(of: Array, to: Array) -> None:
    """Copies the numbers of an array into another one of the same shape, both in one piece."""
    numbers, copied = of.reshape(of.size), to.reshape(to.size)
    for k in range(len(numbers)):
        copied[k] = numbers[k]


@jit_part
def copy_rows(rows: Array, to: Array) -> None:
    """Copies rows (n, k) that need not be in one piece."""
    for i in range(len(rows)):
        for k in range(rows.shape[1]):
            to[i, k] = rows[i, k]


@jit_part
def put(numbers: Array, a: float, b: float, c: float) -> None:
    """Sets three numbers."""
    numbers[0], numbers[1], numbers[2] = a, b, c
