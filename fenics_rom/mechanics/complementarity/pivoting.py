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
    table = np.hstack([np.eye(n), -M, -np.ones((n, 1)), q[:, None]])
    basic, artificial = np.arange(n), 2 * n
    row, enters = int(q.argmin()), artificial
    for _ in range(MOST_PIVOTS * n):
        leaves, basic[row] = basic[row], enters
        table[row] /= table[row, enters]
        column = table[:, enters].copy()
        column[row] = 0.0
        table -= np.multiply.outer(column, table[row])
        if leaves == artificial:
            z = np.zeros(2 * n)
            z[basic] = table[:, -1]
            return z[n:]
        enters = leaves + n if leaves < n else leaves - n
        column = table[:, enters]
        falls = np.flatnonzero(column > SMALLEST_PIVOT * np.abs(column).max())
        if not len(falls):
            return None
        for key in range(-1, n):  # of those that get to 0 together the one that is first if q grows by powers of ε
            shares = table[falls, key] / column[falls]
            falls = falls[shares <= shares.min() + TOGETHER]
            if len(falls) == 1 or artificial in basic[falls]:
                break
        row = int(falls[(basic[falls] == artificial).argmax()])
    return None
