"""A symmetric matrix of points in space as a `BlockMatrix`: what is left out of it is known, and bounded.

Points are halved along the longest edge of their box until few are left. Two clusters whose boxes are far from each
other, beside how large they are, make a block that is kept by its leading singular vectors (Hackbusch 1999). Of a block
E that is left out, and its mirror image, no more than its norm |E| can be missed along any vector, at its points alone:
so that A + ε is no smaller than the matrix that was given, with ε the largest sum of |E| at a point.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.block_matrix import WHOLE, BlockMatrix

LEAF = 16  # points that are not halved any more
FAR = 4.0  # of the distance between two boxes: the diagonal of the smaller one, at most


class _Cluster(NamedTuple):
    """Points in a row, of those in order."""

    first: int
    end: int
    low: Array  # corners of their box, (3,) each
    high: Array
    halves: tuple["_Cluster", ...]  # none of few points

    @property
    def diagonal(self) -> float:
        return float(np.linalg.norm(self.high - self.low))


def compressed(A: Array, places: Array, tolerance: float) -> tuple[BlockMatrix, float]:
    """A symmetric matrix (3P, 3P) of points (P, 3), m, by blocks without singular values below a tolerance, and ε."""
    order = np.arange(len(places))
    root = _cluster(places, order, 0, len(order))
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    blocks, values, missed = [], [], np.zeros(len(order))
    for one, other, is_far in _pairs(root, root):
        block = A[rows[3 * one.first : 3 * one.end, None], rows[3 * other.first : 3 * other.end]]
        rank, kept = WHOLE, [block]
        if is_far:
            U, σ, V = np.linalg.svd(block, full_matrices=False)
            count = int(np.count_nonzero(σ > tolerance))
            if count * sum(block.shape) < block.size:
                rank, kept = count, [U[:, :count] * σ[:count], V[:count]]
                for cluster in (one, other):
                    missed[cluster.first : cluster.end] += σ[count : count + 1].sum()
        blocks.append([one.first, one.end, other.first, other.end, rank])
        values += [part.ravel() for part in kept]
    return BlockMatrix(order, np.array(blocks), np.concatenate(values)), float(missed.max())


def _cluster(places: Array, order: Array, first: int, end: int) -> _Cluster:
    """Of points in a row, which are put in order."""
    own = order[first:end]
    low, high = places[own].min(axis=0), places[own].max(axis=0)
    if end - first <= LEAF:
        return _Cluster(first, end, low, high, ())
    own[:] = own[np.argsort(places[own, (high - low).argmax()], kind="stable")]
    bounds = (first, (first + end) // 2, end)
    return _Cluster(first, end, low, high, tuple(_cluster(places, order, *bounds[k : k + 2]) for k in (0, 1)))


def _pairs(one: _Cluster, other: _Cluster) -> Iterator[tuple[_Cluster, _Cluster, bool]]:
    """Pairs of clusters that make up a pair, and whether they are far; one of two that mirror each other."""
    if one is other and one.halves:
        first, last = one.halves
        for pair in ((first, first), (last, last), (first, last)):
            yield from _pairs(*pair)
        return
    apart = float(np.linalg.norm(np.maximum(np.maximum(one.low - other.high, other.low - one.high), 0.0)))
    if one is not other and min(one.diagonal, other.diagonal) <= FAR * apart:
        yield one, other, True
    elif not (one.halves or other.halves):
        yield one, other, False
    elif len(one.halves) and (not other.halves or one.end - one.first >= other.end - other.first):
        for half in one.halves:
            yield from _pairs(half, other)
    else:
        for half in other.halves:
            yield from _pairs(one, half)
