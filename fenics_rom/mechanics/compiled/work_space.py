"""Arrays that a compiled function works with, as parts of one: one allocation, and nothing counts who holds a part.

A work space (n,) begins with how many of its numbers are taken. Whoever has allocated it keeps it as long as its parts
are used. Who takes some gives them back by `release`.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import address_of, carray, flags, floats, integers


@jit_part
def work_space(numbers: int) -> Array:
    """For so many numbers."""
    space = np.empty(1 + numbers)
    space[0] = 1.0
    return space


@jit_part
def taken(space: Array) -> float:
    """How much is taken, for `release`."""
    return space[0]


@jit_part
def release(space: Array, taken: float) -> None:
    """Gives back what was taken since then."""
    space[0] = taken


@jit_part
def _take(space: Array, numbers: int) -> int:
    """The address of so many of them."""
    first = int(space[0])
    if first + numbers > len(space):
        raise MemoryError("a compiled function has too small a work space")
    space[0] = first + numbers
    return address_of(space) + 8 * first


@jit_part
def take(space: Array, n: int) -> Array:
    """An array (n,)."""
    return carray(floats(_take(space, n)), (n,))


@jit_part
def take_rows(space: Array, n: int, width: int) -> Array:
    """An array (n, width)."""
    return carray(floats(_take(space, n * width)), (n, width))


@jit_part
def take_frames(space: Array, n: int) -> Array:
    """An array (n, 3, 3)."""
    return carray(floats(_take(space, 9 * n)), (n, 3, 3))


@jit_part
def take_integers(space: Array, n: int) -> Array:
    """An array (n,) of whole numbers."""
    return carray(integers(_take(space, n)), (n,))


@jit_part
def take_flags(space: Array, n: int) -> Array:
    """An array (n,) of booleans, in the room of n // 8 + 1 numbers."""
    return carray(flags(_take(space, n // 8 + 1)), (n,))


@jit_part
def rows_of(numbers: Array, width: int) -> Array:
    """Numbers in one piece as rows (n, width), which whoever keeps the numbers keeps."""
    return carray(floats(address_of(numbers)), (numbers.size // width, width))
