"""Linear complementarity problems, w = M z + q, 0 <= w ⟂ z >= 0, by Lemke's pivots (Cottle, Pang & Stone 1992, 4.4).

They lead from one set of numbers that are 0 to the next as an artificial one falls, and so cannot cycle as methods do
that change sets by their signs. A pivot passes over all of (n, 2 n + 2).
"""

import numpy as np
from numpy import ndarray as Array

SMALLEST_PIVOT = 1e-11  # of the largest number in its column
TOGETHER = 1e-9  # numbers that get to 0 so near one another do it together
MOST_PIVOTS = 10  # for each number


def solve_by_pivots(M: Array, q: Array) -> Array | None:
    """z (n,), exactly 0 where w need not be; None where pivots end before there is one.

    Args:
        M: (n, n), of numbers of about one size; need not be symmetric, nor definite.
        q: (n,), of about that size.
    """
    n = len(q)
    if (q >= 0).all():
        return np.zeros(n)
    table, basic, artificial = np.zeros((n, 2 * n + 2)), np.arange(n), 2 * n
    table[:, n:artificial], table[:, artificial], table[:, artificial + 1] = -M, -1.0, q
    for i in range(n):
        table[i, i] = 1.0
    row, enters = int(q.argmin()), artificial
    for _ in range(MOST_PIVOTS * n):
        leaves, basic[row] = basic[row], enters
        table[row] /= table[row, enters]
        column = table[:, enters].copy()
        column[row] = 0.0
        table -= column.reshape(n, 1) * table[row]
        if leaves == artificial:
            z = np.zeros(2 * n)
            z[basic] = table[:, artificial + 1]
            return z[n:]
        enters = leaves + n if leaves < n else leaves - n
        column = table[:, enters].copy()
        falls = np.flatnonzero(column > SMALLEST_PIVOT * np.abs(column).max())
        if len(falls) == 0:
            return None
        for key in range(-1, n):  # of those that get to 0 together the one that is first if q grows by powers of ε
            shares = table[falls, key] / column[falls]
            falls = falls[shares <= shares.min() + TOGETHER]
            if len(falls) == 1 or (basic[falls] == artificial).any():
                break
        row = int(falls[(basic[falls] == artificial).argmax()])
    return None
