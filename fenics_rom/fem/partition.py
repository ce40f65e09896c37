"""Which rank gets which cell, by recursive coordinate bisection (Berger & Bokhari 1987).

PT-SCOTCH, which dolfinx would ask, can wait for itself for ever where a rank has a dozen cells: its ranks then disagree
on which of its methods comes next (7.0, seen on 4 ranks, once in ten meshes).
"""

import numpy as np
from numpy import ndarray as Array


def bisect_cells(centres: Array, ranks: int) -> Array:
    """Rank of each cell (n,): halves of equal numbers across the longest side of their box, and so on.

    Args:
        centres: of the cells, (n, 3), m.
        ranks: how many there are.
    """
    owner = np.zeros(len(centres), dtype=np.int32)
    _bisect(centres, np.arange(len(centres)), 0, ranks, owner)
    return owner


def _bisect(centres: Array, cells: Array, first: int, ranks: int, owner: Array) -> None:
    if ranks == 1 or not len(cells):
        owner[cells] = first
        return
    place = centres[cells]
    order = np.argsort(place[:, np.argmax(np.ptp(place, axis=0))], kind="stable")
    half = ranks // 2
    cut = len(cells) * half // ranks
    _bisect(centres, cells[order[:cut]], first, half, owner)
    _bisect(centres, cells[order[cut:]], first + half, ranks - half, owner)
