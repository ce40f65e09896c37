"""Where the bodies of a batch are: rows of arrays, sorted by contact mode, in chunks that stay in the cache.

The coefficients of a step are written out for every row, so that elementwise products need no gathering. A switch only
says which contact mode a body is in; before the next step, the few rows that are then in another mode's place change
places.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from fenics_rom.errors import StepError

Array = np.ndarray
Bodies = int | Sequence[int] | Sequence[bool] | Array | None

CHUNK_BYTES = 1 << 19  # that the six arrays of a chunk may fill: half of a usual second-level cache


class Segment(NamedTuple):
    """The bodies of a chunk that are in the same contact mode; arrays are views."""

    mode: int
    rows: slice
    u: Array
    w: Array
    spare: Array


class Chunk(NamedTuple):
    """Rows that go through the step together; arrays are views, (rows, m)."""

    x: Array
    r: Array
    elastic: Array
    inertial: Array
    w: Array
    spare: Array
    segments: list[Segment]


class BatchLayout:
    """The rows of all bodies, which begin in the first contact mode.

    Args:
        size: number of bodies.
        modes: number of contact modes.
        order: m, of the rows.
        inputs: p.
        dtype: of the arrays.

    Attributes:
        mode: (size,) of each body.
        row: (size,) of each body.
        body: (size,) of each row.
        state: (2, size, m) x and r, by rows.
        inputs: (size, p) by rows, N.
    """

    def __init__(self, size: int, modes: int, order: int, inputs: int, dtype: np.dtype):
        self.mode, self.row, self.body = np.zeros(size, dtype=int), np.arange(size), np.arange(size)
        self.state = np.zeros((2, size, order), dtype)
        self.inputs = np.empty((size, inputs), dtype)
        self._modes = modes
        self._coefficients = np.empty((2, size, order), dtype)
        self._written = np.full(size, -1)  # the mode whose coefficients are in each row
        self._chunks: list[Chunk] | None = None  # None: rows are not sorted, or coefficients not written
        chunks = -(-6 * size * order * dtype.itemsize // CHUNK_BYTES)
        self._buffers = np.empty((2, -(-size // chunks), order), dtype)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_chunks": None}  # its views would be copies of their own

    def select(self, bodies: Bodies) -> Array:
        """Indices of bodies.

        Raises:
            StepError: they are not None (all), a mask or distinct indices.
        """
        size = len(self.mode)
        if bodies is None:
            return np.arange(size)
        selected = np.atleast_1d(bodies)
        if selected.dtype == bool and selected.shape == (size,):
            return np.flatnonzero(selected)
        if selected.size == 0:
            return np.empty(0, dtype=int)
        distinct = selected.ndim == 1 and selected.dtype.kind in "iu" and len(np.unique(selected)) == len(selected)
        if not (distinct and selected.min() >= 0 and selected.max() < size):
            raise StepError(f"bodies: allowed are None, a mask ({size},) or distinct indices below {size}")
        return selected

    def enter(self, bodies: Array, modes: Array) -> None:
        """Says which contact modes bodies are in from now on."""
        if (self.mode[bodies] != modes).any():
            self.mode[bodies] = modes
            self._chunks = None

    def reset(self, bodies: Array) -> None:
        """Puts bodies at rest in the first contact mode; all of them go on as those of a new batch, to the bit."""
        self.state[:, self.row[bodies]] = 0
        self.enter(bodies, np.zeros(len(bodies), dtype=int))
        if len(bodies) == len(self.body):  # products round by the place of a row
            self.row[:] = self.body[:] = np.arange(len(bodies))
            self._chunks = None

    def discard_coefficients(self) -> None:
        """Has the coefficients written anew before the next step."""
        self._written[:] = -1
        self._chunks = None

    def sort(self, factors: Array) -> list[Chunk]:
        """The chunks of the next step; of rows that were not yet sorted, as few as may be change places.

        Args:
            factors: (2, modes, m) coefficients of x and r in each contact mode.
        """
        if self._chunks is not None:
            return self._chunks
        counts = np.bincount(self.mode, minlength=self._modes)
        modes = np.repeat(np.arange(self._modes), counts)
        now = self.mode[self.body]
        places = np.flatnonzero(now != modes)
        sources = places[np.argsort(now[places], kind="stable")]
        self.state[:, places] = self.state[:, sources]
        self.body[places] = self.body[sources]
        self.row[self.body[places]] = places
        places = np.flatnonzero(self._written != modes)
        self._coefficients[:, places] = factors[:, modes[places]]
        self._written = modes
        self._chunks = self._cut(modes, counts)
        return self._chunks

    def _cut(self, modes: Array, counts: Array) -> list[Chunk]:
        """Chunks of sorted rows, whose contact modes are given, (size,), and how many rows each has."""
        size, length = len(modes), self._buffers.shape[1]
        bounds = np.union1d(np.arange(0, size, length), np.cumsum(counts)).tolist()
        chunks = []
        for first in range(0, size, length):
            rows = slice(first, min(first + length, size))
            (x, r), (elastic, inertial) = self.state[:, rows], self._coefficients[:, rows]
            w, spare = self._buffers[:, : rows.stop - first]
            segments = []
            for start, stop in pairwise(bound for bound in bounds if rows.start <= bound <= rows.stop):
                within = slice(start - first, stop - first)
                mode = int(modes[start])
                segments.append(Segment(mode, slice(start, stop), self.inputs[start:stop], w[within], spare[within]))
            chunks.append(Chunk(x, r, elastic, inertial, w, spare, segments))
        return chunks
