"""Blocks of columns for multigrid and conjugate gradients: compiled where numba is, else by NumPy and SciPy."""

from typing import Any

import numpy as np
import scipy.sparse
from numpy import ndarray as Array

from fenics_rom.compilation import compiled, jit, or_numpy
from fenics_rom.compiled_products import LANES
from fenics_rom.fem.compiled import block_products as loops

BLOCK = 3


def padded_width(columns: int) -> int:
    """Number of columns to work with in place of so many: full lanes, but for one column."""
    return columns if columns <= 1 else -(-columns // LANES) * LANES


@or_numpy
def _run(function: Any, *arrays: Any) -> bool | None:
    if not compiled():
        return None
    jit(function)(*arrays)
    return True


class LocalBlocks:
    """A sparse matrix of this rank alone (rows, columns), times columns (columns, k) and transposed."""

    def __init__(self, rows: scipy.sparse.csr_matrix, size: int = BLOCK):
        self.shape = rows.shape
        blocked = size == BLOCK and not (rows.shape[0] % BLOCK or rows.shape[1] % BLOCK)
        self._matrix = rows.tobsr((BLOCK, BLOCK)) if blocked else rows
        self._arrays = (self._matrix.indptr, self._matrix.indices, self._matrix.data) if blocked else None

    def into(self, x: Array, y: Array, fresh: bool) -> None:
        """y = A x where fresh, else y += A x."""
        if self._arrays is not None and _run(loops.multiply, *self._arrays, x, y, fresh):
            return
        product = self._matrix @ x
        if fresh:
            y[:] = product
        else:
            y += product

    def add_transposed(self, x: Array, y: Array) -> None:
        """y += Aᵀ x."""
        if self._arrays is None or not _run(loops.add_transposed, *self._arrays, x, y):
            y += self._matrix.T @ x


def relax(product: Array, b: Array, inverse: Array, d: Array, x: Array, kept: float, share: float) -> None:
    """d = kept d + share D⁻¹(b - product), x += d; `inverse` (n,) of D."""
    numbers = np.array([kept], dtype=x.dtype), np.array([share], dtype=x.dtype)
    if not _run(loops.relax, product, b, inverse, d, x, *numbers):
        d *= numbers[0]
        d += (numbers[1] * inverse)[:, None] * (b - product)
        x += d


def advance(α: Array, p: Array, q: Array, x: Array, r: Array) -> Array:
    """x += α p, r -= α q for α (k,) of each column; |r|² (k,) on this rank."""
    squares = np.empty(len(α))
    if not _run(loops.advance, α, p, q, x, r, squares):
        x += α * p
        r -= α * q
        squares = np.einsum("ij,ij->j", r, r)
    return squares


def turn(β: Array, z: Array, scale: Array, p: Array) -> None:
    """p = scale z + β p for β and scale (k,) of each column."""
    if not _run(loops.turn, β, z, scale, p):
        p *= β
        p += scale * z


def dots(a: Array, b: Array) -> Array:
    """aᵀb (k,) of each pair of columns, on this rank."""
    sums = np.empty(a.shape[1])
    if not _run(loops.dots, a, b, sums):
        sums = np.einsum("ij,ij->j", a, b, dtype=float)
    return sums
