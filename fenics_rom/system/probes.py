"""Random columns to measure matrices with, the same for any number of ranks."""

import numpy as np

from fenics_rom.system.protocols import Algebra, Array


def probe_columns(algebra: Algebra, count: int) -> Array:
    """Normally distributed columns, (rows here, count)."""
    rows = algebra.rows()
    return np.random.default_rng(0).standard_normal((rows.stop, count))[rows]
