"""A PETSc matrix as blocks of this rank, times many columns at once, with what it needs of other ranks' columns."""

from typing import Any

import numpy as np
import scipy.sparse
from numpy import ndarray as Array
from petsc4py import PETSc

from fenics_rom.fem.column_products import BLOCK, LocalBlocks


class RankedBlocks:
    """Rows of a matrix that are here, times columns of which each rank has some; every rank must call every method.

    Args:
        comm: of the ranks.
        whole: rows (rows here, all columns).
        own: the first of the columns that are here, and how many these are.
        size: of blocks, BLOCK or 1.

    Attributes:
        rows, columns: how many are here.
    """

    def __init__(self, comm: Any, whole: scipy.sparse.csr_matrix, own: tuple[int, int], size: int = BLOCK):
        self._comm, self.rows = comm, whole.shape[0]
        first, self.columns = own
        self._transposes: list[LocalBlocks] | None = None  # made when they are needed
        if self._comm.size == 1:
            self._own, self._halo = LocalBlocks(whole, size), None
            return
        column = whole.indices
        is_own = (column >= first) & (column < first + self.columns)
        divisible = not (self.rows % BLOCK or self.columns % BLOCK)
        size = size if self._comm.allreduce(divisible, min) else 1
        needed = np.unique(column[~is_own] // size)
        needed = (size * needed[:, None] + np.arange(size)).ravel()
        self._own = LocalBlocks(whole[:, first : first + self.columns], size)
        place = np.zeros(whole.shape[1], dtype=whole.indices.dtype)
        place[needed] = np.arange(len(needed))
        rest = np.concatenate([[0], np.cumsum(~is_own)])[whole.indptr]
        outer = whole.data[~is_own], place[column[~is_own]], rest
        self._outer = LocalBlocks(scipy.sparse.csr_matrix(outer, shape=(self.rows, len(needed))), size)
        self._halo = _Halo(self._comm, needed, self.columns, first)

    @classmethod
    def of(cls, mat: PETSc.Mat, dtype: Any) -> "RankedBlocks":
        """A copy of a matrix, in a precision of its own."""
        start, column, values = mat.getValuesCSR()
        (rows, _), (columns, size) = mat.getSizes()
        whole = scipy.sparse.csr_matrix((values.astype(dtype), column, start), shape=(rows, size))
        del start, column, values
        return cls(mat.comm.tompi4py(), whole, (mat.getOwnershipRangeColumn()[0], columns))

    def times(self, x: Array, y: Array | None = None) -> Array:
        """A x (rows, k), in y where that is given."""
        if y is None:
            y = np.empty((self.rows, x.shape[1]), dtype=x.dtype)
        if self._halo is None:
            self._own.into(x, y, True)
            return y
        waiting, others = self._halo.ask(x)
        self._own.into(x, y, True)
        self._halo.wait(waiting)
        self._outer.into(others, y, False)
        return y

    def add_times(self, x: Array, y: Array) -> None:
        """y += A x."""
        self._add_elsewhere(x, y, False)
        self._own.into(x, y, False)

    def residual(self, x: Array, y: Array, b: Array) -> None:
        """y = b - A x."""
        self._own.residual_into(x, y, self._add_elsewhere(x, y, True), b)

    def relaxed(
        self, x: Array, y: Array, b: Array, inverse: Array, old: Array, shares: tuple[float, float, float]
    ) -> None:
        """y = s_0 x + s_1 old + s_2 D⁻¹ (b - A x), as `LocalBlocks.relaxed_into`."""
        self._own.relaxed_into(x, y, self._add_elsewhere(x, y, True), b, inverse, old, shares)

    def _add_elsewhere(self, x: Array, y: Array, fresh: bool) -> bool:
        """Puts into y what other ranks' columns make; whether y is as fresh as it was, as there are none."""
        if self._halo is None:
            return fresh
        waiting, others = self._halo.ask(x)
        self._halo.wait(waiting)
        self._outer.into(others, y, fresh)
        return False

    def transposed_times(self, x: Array) -> Array:
        """Aᵀ x (columns, k)."""
        if self._transposes is None:
            self._transposes = [part.transposed for part in (self._own, *([] if self._halo is None else [self._outer]))]
        y = np.zeros((self.columns, x.shape[1]), dtype=x.dtype)
        if self._halo is not None:
            others = np.empty((self._outer.shape[1], x.shape[1]), dtype=x.dtype)
            self._transposes[1].into(x, others, True)
            self._halo.add(others, y)
        self._transposes[0].into(x, y, False)
        return y


class _Halo:
    """Which rows of columns go to which rank, and come from it."""

    def __init__(self, comm: Any, needed: Array, count: int, first: int):
        self._comm, self._size = comm, len(needed)
        starts = np.array(comm.allgather(first))
        bounds = np.searchsorted(needed, np.append(starts[1:], np.iinfo(needed.dtype).max))
        begins = np.concatenate([[0], bounds[:-1]])
        self._come = {rank: slice(a, b) for rank, (a, b) in enumerate(zip(begins, bounds, strict=True)) if b > a}
        asked = comm.alltoall([needed[a:b] for a, b in zip(begins, bounds, strict=True)])
        self._go = {rank: rows - first for rank, rows in enumerate(asked) if len(rows)}

    def ask(self, x: Array) -> tuple[tuple[Any, ...], Array]:
        """What to wait for, and rows (needed, k) of columns that will be there then."""
        others = np.empty((self._size, x.shape[1]), dtype=x.dtype)
        come = [self._comm.Irecv(others[rows], source=rank) for rank, rows in self._come.items()]
        sent = [(rank, x[rows]) for rank, rows in self._go.items()]
        go = [self._comm.Isend(rows, dest=rank) for rank, rows in sent]
        return (come, go, sent), others

    def wait(self, waiting: tuple[Any, ...]) -> None:
        """Until all is there, and gone."""
        for request in (*waiting[0], *waiting[1]):
            request.Wait()

    def add(self, others: Array, y: Array) -> None:
        """Adds rows (needed, k) to those of the ranks whose they are, in y here."""
        come = {rank: np.empty((len(rows), y.shape[1]), dtype=y.dtype) for rank, rows in self._go.items()}
        requests = [self._comm.Irecv(rows, source=rank) for rank, rows in come.items()]
        requests += [self._comm.Isend(others[rows], dest=rank) for rank, rows in self._come.items()]
        for request in requests:
            request.Wait()
        for rank, rows in come.items():
            y[self._go[rank]] += rows
