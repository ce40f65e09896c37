"""Arrays that compiled functions find at their addresses: so many of different sizes are one table of numbers.

Functions of many arrays are slow to compile and to call; those of a table are neither. Whoever makes a table keeps its
arrays.
"""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import carray, floats, integers


def table_of(arrays: Sequence[Array]) -> Array:
    """Rows (n, 4) of addresses and lengths of arrays of floats or whole numbers of one to three axes, in one piece."""
    rows = np.zeros((len(arrays), 4), dtype=np.int64)
    for row, array in zip(rows, arrays, strict=True):
        if array.dtype not in (np.float64, np.int64) or not array.flags.c_contiguous or not 1 <= array.ndim <= 3:
            raise TypeError(f"an array of {array.dtype} and shape {array.shape} is of no kind that tables have")
        row[0], row[1 : 1 + array.ndim] = array.ctypes.data, array.shape
    return rows


@jit_part
def vector_at(row: Array) -> Array:
    """The array of one axis that a row of a table tells of."""
    return carray(floats(row[0]), (row[1],))


@jit_part
def matrix_at(row: Array) -> Array:
    """That of two axes."""
    return carray(floats(row[0]), (row[1], row[2]))


@jit_part
def cube_at(row: Array) -> Array:
    """That of three axes."""
    return carray(floats(row[0]), (row[1], row[2], row[3]))


@jit_part
def integers_at(row: Array) -> Array:
    """That of one axis, of whole numbers."""
    return carray(integers(row[0]), (row[1],))


@jit_part
def integer_rows_at(row: Array) -> Array:
    """That of two axes, of whole numbers."""
    return carray(integers(row[0]), (row[1], row[2]))


@jit_part
def integer_cube_at(row: Array) -> Array:
    """That of three axes, of whole numbers."""
    return carray(integers(row[0]), (row[1], row[2], row[3]))
