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
    """A sparse matrix of this rank alone (rows, columns), times columns x (columns, k) into y (rows, k).

    Where not `fresh`, y holds what is to be added to the product.
    """

    def __init__(self, rows: scipy.sparse.csr_matrix, size: int = BLOCK):
        self.shape = rows.shape
        blocked = size == BLOCK and not (rows.shape[0] % BLOCK or rows.shape[1] % BLOCK)
        self._matrix = rows.tobsr((BLOCK, BLOCK)) if blocked else rows
        self._arrays = (self._matrix.indptr, self._matrix.indices, self._matrix.data) if blocked else None

    @property
    def transposed(self) -> "LocalBlocks":
        """A copy of the transpose."""
        return LocalBlocks(self._matrix.T.tocsr())

    def _compiled(self, function: Any, x: Array, *given: Any) -> bool | None:
        if self._arrays is None or x.shape[1] % LANES:
            return None
        return _run(function, *self._arrays, x, *given)

    def into(self, x: Array, y: Array, fresh: bool) -> None:
        """y = A x."""
        if self._compiled(loops.multiply, x, y, fresh):
            return
        product = self._matrix @ x
        if fresh:
            y[:] = product
        else:
            y += product

    def residual_into(self, x: Array, y: Array, fresh: bool, b: Array) -> None:
        """y = b - A x."""
        if not self._compiled(loops.subtract, x, y, fresh, b):
            self.into(x, y, fresh)
            np.subtract(b, y, out=y)

    def relaxed_into(
        self, x: Array, y: Array, fresh: bool, b: Array, inverse: Array, old: Array, shares: tuple[float, float, float]
    ) -> None:
        """y = s_0 x + s_1 old + s_2 D⁻¹ (b - A x) for `shares` s and the `inverse` (rows,) of D; old is not y."""
        s = np.array(shares, dtype=x.dtype)
        if not self._compiled(loops.relax, x, y, fresh, b, inverse, old, s):
            self.residual_into(x, y, fresh, b)
            y *= (s[2] * inverse)[:, None]
            y += s[0] * x + s[1] * old


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


def divide(r: Array, scale: Array, into: Array) -> None:
    """into = r / scale for scale (k,) of each column, in the precision of `into`."""
    if not _run(loops.divide, r, scale, into):
        np.divide(r, scale, out=into, casting="same_kind")


def dots(a: Array, b: Array) -> Array:
    """aᵀb (k,) of each pair of columns, on this rank."""
    sums = np.empty(a.shape[1])
    if not _run(loops.dots, a, b, sums):
        sums = np.einsum("ij,ij->j", a, b, dtype=float)
    return sums
