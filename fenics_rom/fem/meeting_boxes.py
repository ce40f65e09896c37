"""Pairs of boxes that meet, found by a hierarchy of boxes along Morton's curve (Lauterbach et al., 2009)."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

BITS = 20  # of each coordinate, three times of which a whole number has


class _Level(NamedTuple):
    """Boxes around 2^l neighbours each, with the lowest and the highest of their groups, and whether one is open."""

    low: Array
    high: Array
    first: Array
    last: Array
    is_open: Array


def meeting_boxes(low: Array, high: Array, group: Array, is_open: Array) -> Array:
    """Pairs (P, 2) of boxes that meet and are of different groups, or both open.

    Args:
        low, high: corners of the boxes, (n, 3).
        group: of each, (n,).
        is_open: whether it is also paired within its group, (n,).
    """
    order = np.argsort(_along_curve((low + high) / 2), kind="stable")
    levels = [_Level(low[order], high[order], group[order], group[order], is_open[order])]
    while len(levels[-1].low) > 1:
        levels.append(_pairwise(levels[-1]))
    pairs = np.zeros((1, 2), dtype=np.int64)
    for k, level in enumerate(reversed(levels)):
        if k:
            pairs = _children(pairs, len(level.low))
        pairs = pairs[_may_meet(level, *pairs.T)]
    return order[pairs[pairs[:, 0] < pairs[:, 1]]]


def _along_curve(centres: Array) -> Array:
    """Places (n,) along Morton's curve: bits of the three coordinates in turns."""
    start = centres.min(axis=0)
    width = max(float(np.ptp(centres, axis=0).max()), np.finfo(float).tiny)
    grid = ((centres - start) / width * (2**BITS - 1)).astype(np.int64)
    code = np.zeros(len(centres), dtype=np.int64)
    for bit in range(BITS):
        for axis in range(3):
            code |= (grid[:, axis] >> bit & 1) << (3 * bit + axis)
    return code


def _pairwise(level: _Level) -> _Level:
    """The next level: two neighbours in each box, the last one alone where their number is odd."""
    start = np.arange(0, len(level.low), 2)
    return _Level(
        np.minimum.reduceat(level.low, start),
        np.maximum.reduceat(level.high, start),
        np.minimum.reduceat(level.first, start),
        np.maximum.reduceat(level.last, start),
        np.logical_or.reduceat(level.is_open, start),
    )


def _children(pairs: Array, count: int) -> Array:
    """Pairs of what is in pairs of boxes, each once."""
    steps = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
    children = (2 * pairs[:, None] + steps).reshape(-1, 2)
    return children[(children[:, 1] < count) & (children[:, 0] <= children[:, 1])]


def _may_meet(level: _Level, a: Array, b: Array) -> Array:
    """Rows of those pairs whose boxes meet, and that are of different groups or both open."""
    of_interest = (
        (level.first[a] != level.last[a]) | (level.first[b] != level.last[b]) | (level.first[a] != level.first[b])
    )
    of_interest |= level.is_open[a] & level.is_open[b]
    rows = of_interest.nonzero()[0]
    for low, high in zip(level.low.T, level.high.T, strict=True):
        one, other = a[rows], b[rows]
        rows = rows[(low[one] <= high[other]) & (low[other] <= high[one])]
    return rows
