"""Blocks of columns: random ones to measure matrices with, and complex ones where an operation takes real ones only."""

from collections.abc import Callable, Iterable
from functools import reduce
from operator import add

import numpy as np
from numpy import ndarray as Array

from fenics_rom.system.protocols import Algebra


def probe_columns(algebra: Algebra, count: int) -> Array:
    """Normally distributed columns, (rows here, count), the same for any number of ranks."""
    rows = algebra.rows()
    return np.random.default_rng(0).standard_normal((rows.stop, count))[rows]


def column_dots(algebra: Algebra, left: Array, right: Array) -> Array:
    """Of each pair of columns (rows here, c), (c,), summed over the ranks."""
    dots: Array = algebra.total(np.einsum("ij,ij->j", left, right))
    return dots


def sum_of(blocks: Iterable[Array]) -> Array:
    """Of arrays of which there is room for two."""
    return reduce(add, blocks)


def apply_to_complex(operation: Callable[[Array], Array], block: Array) -> Array:
    """A real linear operation on complex columns (any, k): one call on their real and imaginary parts side by side."""
    result, count = operation(np.hstack([block.real, block.imag])), block.shape[1]
    return result[:, :count] + 1j * result[:, count:]
