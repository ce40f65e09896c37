"""Blocks of columns side by side, so that one product or solve serves them all."""

from collections.abc import Iterable

import numpy as np

from fenics_rom.system.protocols import Array


def block_starts(blocks: Iterable[Array]) -> Array:
    """Index of the first column of each block, and the number of all columns at the end."""
    return np.cumsum([0, *(block.shape[1] for block in blocks)])


def split_like(columns: Array, blocks: Iterable[Array]) -> list[Array]:
    """Columns in parts as wide as the blocks."""
    return np.split(columns, block_starts(blocks)[1:-1], axis=1)
