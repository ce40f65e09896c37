"""What forces on few points do by a matrix that is kept by blocks, `rom.block_matrix`: of blocks that they meet alone.

Points are numbered here by their places in the order of the blocks. `before` (P + 1,) has how many of some places are
ahead of each, so that those in a block are known at once.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums
from fenics_rom.mechanics.compiled.copying import add_row, fill
from fenics_rom.runtime.compiled.small_matrices import dot

WHOLE = -1  # as of `rom.block_matrix`


class Blocks(NamedTuple):
    """B of P points."""

    order: Array  # of the points (P,)
    table: Array  # (b, 6): `BlockMatrix.blocks`, and where the values of each begin
    values: Array


@jit_part
def places_of(order: Array, are_meant: Array) -> tuple[Array, Array]:
    """The places (s,) of those points (P,) that are meant, in order, and `before`."""
    P = len(order)
    before = np.zeros(P + 1, dtype=np.int64)
    for place in range(P):
        before[place + 1] = before[place] + are_meant[order[place]]
    places, count = np.empty(before[P], dtype=np.int64), 0
    for place in range(P):
        if are_meant[order[place]]:
            places[count] = place
            count += 1
    return places, before


@jit_part
def set_among(blocks: Blocks, places: Array, before: Array, A: Array) -> None:
    """Sets B of some places (s,), (3 s, 3 s)."""
    for one in blocks.table:
        first, left, rank, start = one[0], one[2], one[4], one[5]
        width = 3 * (one[3] - left)
        V = start + 3 * (one[1] - first) * rank
        for i in range(before[first], before[one[1]]):
            for j in range(before[left], before[one[3]]):
                row, column = 3 * (places[i] - first), 3 * (places[j] - left)
                for x in range(3):
                    for y in range(3):
                        if rank == WHOLE:
                            number = blocks.values[start + (row + x) * width + column + y]
                        else:
                            U = start + (row + x) * rank
                            of_row = blocks.values[U : U + rank]
                            number = _along(of_row, blocks.values, V + column + y, width)
                        A[3 * i + x, 3 * j + y] = A[3 * j + y, 3 * i + x] = number


@jit_sums
def _along(row: Array, values: Array, start: int, width: int) -> float:
    """A row (r,) times a column of r numbers that lie so far apart."""
    total = 0.0
    for k in range(len(row)):
        total += row[k] * values[start + k * width]
    return total


@jit_part
def set_moved(blocks: Blocks, places: Array, before: Array, f: Array, moved: Array) -> None:
    """Sets B f (3P,) of forces f (3P,) on points at some places (s,)."""
    in_order, most = np.zeros(len(f)), 1
    for one in blocks.table:
        most = max(most, one[4])
    room = np.empty(most)
    for one in blocks.table:
        first, end, left, right, rank, start = one
        rows, width = in_order[3 * first : 3 * end], in_order[3 * left : 3 * right]
        V = start + len(rows) * rank
        beside, own = places[before[left] : before[right]], places[before[first] : before[end]]
        if rank == WHOLE:
            for place in beside:
                p, at = 3 * blocks.order[place], start + 3 * (place - left)
                for x in range(3):
                    for i in range(len(rows)):
                        rows[i] += blocks.values[at + x + i * len(width)] * f[p + x]
            for place in own if first != left else own[:0]:
                p, at = 3 * blocks.order[place], start + 3 * (place - first) * len(width)
                for x in range(3):
                    add_row(blocks.values[at + x * len(width) : at + (x + 1) * len(width)], f[p + x], width)
            continue
        inner = room[:rank]
        if len(beside) > 0:
            fill(inner, 0.0)
            for place in beside:
                p, at = 3 * blocks.order[place], V + 3 * (place - left)
                for k in range(rank):
                    j = at + k * len(width)
                    x, y, z = blocks.values[j], blocks.values[j + 1], blocks.values[j + 2]
                    inner[k] += x * f[p] + y * f[p + 1] + z * f[p + 2]
            for i in range(len(rows)):
                rows[i] += dot(blocks.values[start + i * rank : start + (i + 1) * rank], inner)
        if len(own) > 0:
            fill(inner, 0.0)
            for place in own:
                p, at = 3 * blocks.order[place], start + 3 * (place - first) * rank
                for x in range(3):
                    add_row(blocks.values[at + x * rank : at + (x + 1) * rank], f[p + x], inner)
            for k in range(rank):
                add_row(blocks.values[V + k * len(width) : V + (k + 1) * len(width)], inner[k], width)
    for place in range(len(blocks.order)):
        p = 3 * blocks.order[place]
        for x in range(3):
            moved[p + x] = in_order[3 * place + x]
