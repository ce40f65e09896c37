"""Many steps of the finer model at once, and the norm of its residual over them; see error_maps.

A block is of some parts, a part of L steps. Parts are taken in coordinates y of the eigenvectors of a step, which go on
by themselves: y⁺ = λ y + push u. So what is pushed is one product for many parts, and then all of them go on, compiled
where that is worth it. Most coordinates have no residual, as their directions are eigenvectors of the body: the others
are heard, and what is left out is bounded by the norm of its columns, times that of its coordinates.

The sum of squares over a block is, with z = [u, y] of each part, u those of its steps,

    Σ ρᵀD⁻¹ρ = Σ over parts |F z|² + |X y|²,        y those that the block begins with:

of the last part by a triangle that has the columns of u first. The part before gets X y⁺ as further rows, of the
y⁺ = λ y + push u that it leads to, and is made a triangle, too; and so on to the first one.
"""

import math
import threading
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import in_plain, or_numpy

SILENT = 1e-9  # of the residual of all coordinates, of those that F has no columns of
SKEWED = 1e6  # condition of eigenvectors that are of no use
RUN = 16  # most parts in a row that go on by themselves, before what came before them is added
SHARES = 4  # of rows of F in one product each, so that most of its zeros are not multiplied
ROWS = 24  # in fewer shares than these
FEW = 8  # blocks that are not worth shares
AT_ONCE = 2**15  # steps whose z are held
IN_LOOPS = 2**12  # the same in loops: what fits the cache


class Coordinates(NamedTuple):
    """y (f,), complex, of [e, r], as real and imaginary parts in turn, (2f,).

    Some hold two real coordinates each: those come first that have a residual, and last that have none.
    """

    λ: Array  # (2, f), of real and of imaginary parts: they differ where two are held
    into: Array  # (2f, 2f)
    back: Array  # (2f, 2f)
    two: tuple[int, int]  # how many of the first ones do, and from where on the last ones
    heard: int  # how many have a residual, which come first


class Block(NamedTuple):
    """What steps make of coordinates and of their inputs (parts, q), q = p L."""

    length: int  # steps
    parts: int
    powers: Array  # of λ of a part (RUN, f), of those that hold two the mean
    apart: Array  # half of how these two differ (RUN, f)
    two: tuple[int, int]  # they do before the first of these, and from the second on
    push: Array  # (q, 2f)
    rows: tuple[tuple[int, Array], ...]  # of F, from which column of z on (parts, columns, any)
    begun: Array  # X (2 heard, any)
    whole: Array  # F and X in one (columns, any), of a block of one part
    silent: float  # norm of the columns of all other coordinates


def triangular(rows: Array) -> Array:
    """F (any, c), upper triangular, with |F z|² = |rows z|²; not from a Gram matrix, which loses half the digits."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def doubled(state: Array, F: Array) -> tuple[Array, Array]:
    """The maps of twice as many steps, from z to the state and to what has the squared length of all residuals."""
    (size, columns), added = state.shape, state.shape[1] - state.shape[0]
    lift = np.zeros((columns, columns + added))  # of z to that of the second half
    lift[:size, :columns], lift[size:, columns:] = state, np.eye(added)
    return state @ lift, triangular(np.vstack([np.pad(F, ((0, 0), (0, added))), F @ lift]))


def coordinates_of(Φ: Array, F: Array) -> Coordinates | None:
    """Of a step [e, r] -> Φ [e, r] (2f, 2f) with a residual F (any, 2f + p); None where eigenvectors are too skewed.

    Where Φ couples e and r of each direction alone, so do the eigenvectors, also of directions of the same frequency.
    """
    f = len(Φ) // 2
    rows = np.arange(2 * f).reshape(2, f).T
    parts = Φ[rows[:, :, None], rows[:, None]]  # (f, 2, 2)
    if np.count_nonzero(parts) < np.count_nonzero(Φ):
        parts, rows = Φ[None], np.arange(2 * f)[None]
    λ, V = np.linalg.eig(parts)
    if np.linalg.cond(V).max() > SKEWED:
        return None
    all_V = np.zeros((2 * f, 2 * f), dtype=complex)
    all_V[rows[:, :, None], np.arange(2 * f).reshape(len(λ), 1, -1)] = V
    λ, sizes = λ.ravel(), np.linalg.norm(F[:, : 2 * f] @ all_V, axis=0)
    real, upper = np.flatnonzero(λ.imag == 0), np.flatnonzero(λ.imag > 0)
    real = real[np.argsort(-sizes[real])].reshape(-1, 2)  # those beside one another of like sizes
    one, other = np.r_[real[:, 0], upper], np.r_[real[:, 1], upper]
    second = np.hstack([all_V[:, real[:, 1]].real, -all_V[:, upper].imag])
    order = np.argsort(-sizes[one])
    left = np.sqrt(np.cumsum(np.square(sizes[one[order]])[::-1])[::-1])  # of each and those after it
    heard = int(np.count_nonzero(left > SILENT * left[:1]))
    two = order < len(real)
    order = np.r_[*(order[:heard][two[:heard] == of] for of in (True, False)), order[heard:][np.argsort(two[heard:])]]
    back = np.stack([all_V[:, one].real, second], axis=2)[:, order].reshape(2 * f, 2 * f)
    held = int(two[:heard].sum()), f - int(two[heard:].sum())
    return Coordinates(np.stack([λ[one], λ[other]])[:, order], np.linalg.inv(back), back, held, heard)


class BlockMaker:
    """Makes blocks of twice, four times, .. as many steps; of more than `longest` in one part they get more parts.

    Args:
        at: coordinates of a step.
        state: its map of [e, r, u] (2f, 2f + p).
        F: of its residual (any, 2f + p).
        longest: steps of a part.
    """

    def __init__(self, at: Coordinates, state: Array, F: Array, longest: int):
        self._at, self._longest, self._length = at, longest, 1
        self._map = state, F
        self._parts: list[Array] = []  # F of parts, the last one first
        self._left = np.zeros((0, 2 * at.heard))  # X

    def next(self) -> Block:
        """Of twice as many steps as the last one."""
        at = self._at
        if 2 * self._length <= self._longest:
            self._map, self._length = doubled(*self._map), 2 * self._length
            self._parts, self._left = [], self._left[:0]
        (state, F), own = self._map, 2 * at.heard
        size, q = len(state), state.shape[1] - len(state)
        by_y, push, carry = F[:, :size] @ at.back, at.into @ state[:, size:], at.into[:own] @ state[:, :size]
        last = np.hstack([F[:, size:], by_y[:, :own]])
        for _ in range(max(1, len(self._parts))):
            before = self._left @ np.hstack([push[:own], carry @ at.back[:, :own]])
            triangle = triangular(np.vstack([last, before]))
            self._parts.append(np.pad(triangle, ((0, max(0, q - len(triangle))), (0, 0)))[:q])
            self._left = triangle[q:, q:]
        parts, λ = np.stack(self._parts[::-1]), at.λ**self._length
        powers = λ ** np.arange(1, RUN + 1)[:, None, None]
        return Block(
            self._length * len(parts),
            len(parts),
            powers.mean(axis=1),
            (powers[:, 0] - powers[:, 1]).real / 2,
            at.two,
            np.ascontiguousarray(push.T),
            _shares(parts),
            np.ascontiguousarray(self._left.T),
            np.ascontiguousarray(triangle.T),
            float(np.linalg.norm(by_y[:, own:])),
        )


def take_blocks(block: Block, heard: int, y: Array, inputs: Array, loops: bool) -> tuple[float, float]:
    """Takes the steps of T blocks under inputs (T, parts q), from coordinates y (f,), which are set; in loops or not.

    Returns:
        Sums of squares: of the residual of coordinates that are heard, and what those of all coordinates before each
        part are no larger than.
    """
    q, times = len(block.push), max(1, min(len(inputs), (IN_LOOPS if loops else AT_ONCE) // block.length))
    squares, before = 0.0, 0.0
    for first in range(0, len(inputs), times):
        u = in_plain(inputs[first : first + times]).reshape(-1, q)
        z, pushed = ROOM.array(0, len(u), q + 2 * heard), ROOM.array(1, len(u), 2 * len(y))
        given = block.powers, block.apart, block.two, y, _product(u, block.push, pushed), u, z
        most = _in_loops(*given) if loops else None
        before += go_on(*given) if most is None else most
        if block.parts == 1 and len(z) < FEW:
            found = np.dot(z, block.whole)
        else:
            found = _products(block, z.reshape(-1, block.parts, z.shape[1]).transpose(1, 0, 2), q)
        squares += float(np.vdot(found, found))
    return squares, before


def go_on(powers: Array, apart: Array, two: tuple[int, int], y: Array, pushed: Array, inputs: Array, z: Array) -> float:
    """Lets coordinates y (f,) go on through T parts.

    Args:
        powers, apart, two: as of Block.
        y: before the first part, set to those after the last one.
        pushed: what inputs do (T, 2f), overwritten.
        inputs: (T, q).
        z: set to them and the first coordinates before each part (T, q + any).

    Returns:
        What the sum of |y|² of all before each part is no larger than.
    """
    (times, q), own = inputs.shape, (z.shape[1] - inputs.shape[1]) // 2
    z[:, :q], ys = inputs, pushed.view(complex)
    if times == 1:
        z[0, q:], before = y[:own].view(float), np.vdot(y, y).real
        y[:] = _turned(powers[0], apart[0], y, two) + ys[0]
        return float(before)
    row = min(RUN, 1 << (times.bit_length() - 1) // 2)
    rows, last = -(-times // row), (times - 1) % row
    if rows * row > times:
        ys = np.concatenate([ys, np.zeros((rows * row - times, len(y)))])
    ys = ys.reshape(rows, row, -1)
    for k in range(1, row):  # all rows at once, each from 0
        ys[:, k] += _turned(powers[0], apart[0], ys[:, k - 1], two)
    begins = np.empty((rows, len(y)), dtype=complex)
    begins[0] = y
    for begun, after, then in zip(begins[:-1], ys[:, -1], begins[1:], strict=False):
        np.add(_turned(powers[row - 1], apart[row - 1], begun, two), after, out=then)
    told = np.empty((rows, row, own), dtype=complex)
    told[:, 0] = begins[:, :own]
    told[:, 1:] = _turned(powers[: row - 1, :own], apart[: row - 1, :own], begins[:, None, :own], two)
    told[:, 1:] += ys[:, :-1, :own]
    z[:, q:] = told.reshape(rows * row, own)[:times].view(float)
    y[:] = _turned(powers[last], apart[last], begins[-1], two) + ys[-1, last]
    return float(2 * (row * np.vdot(begins, begins).real + np.vdot(ys, ys).real))  # as |λ| is at most 1


@or_numpy
def _in_loops(*given: Any) -> float | None:
    from fenics_rom.runtime.compiled.error_parts import take_parts  # here, as few runs are that long

    return float(take_parts(*given))


def _turned(powers: Array, apart: Array, y: Array, two: tuple[int, int]) -> Array:
    """λ y; two real coordinates are held up to a first place, and from a second one on."""
    after, (end, start) = powers * y, two
    if end:
        after[..., :end] += apart[..., :end] * y[..., :end].conj()
    if start < y.shape[-1]:
        after[..., start:] += apart[..., start:] * y[..., start:].conj()
    return after


class _Room(threading.local):
    """What products are written to: memory that is new each time takes as long as they do."""

    def __init__(self) -> None:
        self._arrays = [np.empty(0)] * 3

    def array(self, place: int, *shape: int) -> Array:
        """One of such a shape, with any numbers."""
        size = math.prod(shape)
        if len(self._arrays[place]) < size:
            self._arrays[place] = np.empty(size)
        return self._arrays[place][:size].reshape(shape)


ROOM = _Room()


def _shares(rows: Array) -> tuple[tuple[int, Array], ...]:
    """Of upper triangles (.., rows, columns), in columns (.., columns, rows): shares of rows, and where they begin."""
    size = rows.shape[-2]
    share = max(ROWS, -(-size // SHARES))
    return tuple(
        (k, np.ascontiguousarray(np.swapaxes(rows[..., k : k + share, k:], -1, -2))) for k in range(0, size, share)
    )


def _products(block: Block, z: Array, q: int) -> Array:
    """F z and X y in a row, of z (parts, T, columns)."""
    sizes = [z.shape[0] * z.shape[1] * rows.shape[2] for _, rows in block.rows]
    found, begin = ROOM.array(2, sum(sizes) + z.shape[1] * block.begun.shape[1]), 0
    for (k, rows), size in zip(block.rows, sizes, strict=True):
        np.matmul(z[:, :, k:], rows, found[begin : begin + size].reshape(*z.shape[:2], -1))
        begin += size
    np.dot(z[0, :, q:], block.begun, found[begin:].reshape(z.shape[1], -1))
    return found


def _product(rows: Array, columns: Array, into: Array) -> Array:
    """Theirs, in pieces that the fastest products are for."""
    pieces = 2
    if len(rows) % pieces:
        return np.dot(rows, columns, into)
    np.matmul(rows.reshape(pieces, -1, rows.shape[1]), columns, into.reshape(pieces, -1, into.shape[1]))
    return into
