"""Copies of arrays by loops: what `to[:] = of`, or `to[k] = (a, b)`, may fail with takes numba a second to compile."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.compiled_arrays import address_of, carray, flat, float_of, integers

MAGNITUDE = 2**63 - 1  # the bits of a number but for its sign


@jit_part
def copy(of: Array, to: Array) -> None:
    """Copies the numbers of an array into another one of the same shape, both in one piece."""
    numbers, copied = flat(of), flat(to)
    for k in range(len(numbers)):
        copied[k] = numbers[k]


@jit_part
def fill(array: Array, number: float) -> None:
    """Sets all numbers of an array in one piece."""
    numbers = flat(array)
    for k in range(len(numbers)):
        numbers[k] = number


@jit_part
def add_row(row: Array, share: float, to: Array) -> None:
    """Adds a share of a row to another one."""
    for k in range(len(to)):
        to[k] += share * row[k]


@jit_part
def add_rows(rows: Array, shares: Array, first: int, end: int, to: Array) -> None:
    """Adds a share of each row (m, n) to (n,), from a first number to an end: each to the bit as among all.

    Four rows at once, so that what they are added to is read less often.
    """
    fours = len(shares) // 4
    for i in range(0, 4 * fours, 4):
        a, b, c, d = shares[i], shares[i + 1], shares[i + 2], shares[i + 3]
        for k in range(first, end):
            to[k] += a * rows[i, k] + b * rows[i + 1, k] + c * rows[i + 2, k] + d * rows[i + 3, k]
    for i in range(4 * fours, len(shares)):
        for k in range(first, end):
            to[k] += shares[i] * rows[i, k]


@jit_part
def largest_of(array: Array) -> float:
    """Of numbers in one piece, without their signs; not a number if one of them is none."""
    bits, most = carray(integers(address_of(array)), (array.size,)), 0
    for k in range(len(bits)):  # by their bits, which vectors compare without a thought of what is no number
        most = max(most, bits[k] & MAGNITUDE)
    return float_of(most)


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


@jit_part
def are_equal(one: Array, other: Array) -> bool:
    """Whether two arrays of as many numbers, both in one piece, have the same ones."""
    here, there = flat(one), flat(other)
    same = True
    for k in range(len(here)):
        same = same and here[k] == there[k]
    return same
