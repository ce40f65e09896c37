"""Steps of the finer model, one by one and in blocks, and the norm of its residual over them; see rom.error_model.

A step of a linear model is linear in z = [e, r, u], and so is its residual: ρᵀD⁻¹ρ = |F z|². Over a block of steps the
sum of all of them is one such square, too, of z = [e, r, u_1, ..., u_L], and F a triangle of so many columns.

Blocks are taken in coordinates y of the eigenvectors of a step, which goes on by y⁺ = λ y + c: so many blocks go on at
once (`onward`). Most of these coordinates have no residual, as their directions are eigenvectors of the body: F has
columns of the others alone, and what it lacks is bounded by the norm of its columns, times that of their coordinates.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.error_model import ErrorModel
from fenics_rom.rom.midpoint_map import compliance, matrices
from fenics_rom.rom.rom import Rom

LONGEST = 64  # steps of a block
SPREAD = 8  # numbers of inputs in a block, for each of the state that has a residual
MAX_KEPT = 32  # maps of step sizes that never come back must not pile up
PARTS = 4  # in which a triangle is multiplied, so that most of its zeros are not
FEW = 8  # rows that are not worth that
AT_ONCE = 512  # blocks whose z are held: what fits the cache
RUN = 16  # most blocks in a row that go on by themselves, before what came before them is added
SILENT = 1e-9  # of the residual of all coordinates, of those that F has no columns of
SKEWED = 1e6  # condition of eigenvectors that are of no use


class Step(NamedTuple):
    """What a step of the finer model makes of its state [e, r] (2f,) and of its inputs."""

    carry: Array  # (2f, 2f)
    push: Array  # (p, 2f)
    residual: Array  # F (any, 2f + p), upper triangular, W^1/2


class Block(NamedTuple):
    """What L steps make of coordinates y (n,), complex, and of their inputs (p L,)."""

    length: int  # L
    powers: Array  # λᴸ, λ²ᴸ, ... (RUN, n)
    push: Array  # (p L, 2 n) real and imaginary parts in turn
    residual: Array  # F (any, k + p L), upper triangular, of `Coordinates.heard` and of inputs, W^1/2
    silent: float  # norm of its columns for all others


class Coordinates(NamedTuple):
    """y (n,), complex, of [e, r], as real and imaginary parts in turn, (2n,)."""

    λ: Array  # (n,)
    into: Array  # (2n, 2f)
    back: Array  # (2f, 2n)
    audible: int  # how many have a residual, which come first
    heard: Array  # (k,) which of their parts do


def residual_map(errors: ErrorModel, contact: str, h: float) -> Array:
    """F (any, 2f + p), upper triangular: |F z|² is ρᵀD⁻¹ρ, W, of a step of h s that begins with z = [e, r, u]."""
    model = errors.finer_model(contact)
    f, p = model.inputs.shape
    ω, a = np.sqrt(model.eigenvalues), compliance(model, h)[0]
    e, r, u = np.split(np.eye(2 * f + p), [f, 2 * f])
    driven = model.inputs @ u + 2 / h * r - ω[:, None] * e
    v = a[:, None] * driven if a.ndim == 1 else a @ driven
    q = e / model.safe_frequencies[:, None] + h / 2 * v
    rows = errors.residual_inputs[contact] @ u - errors.residual_damping @ v - errors.residual_stiffness @ q
    return triangular(rows)


def triangular(rows: Array) -> Array:
    """F (any, c), upper triangular, with |F z|² = |rows z|²; not from a Gram matrix, which loses half the digits."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def squared_length(F: Array, z: Array) -> float:
    """Sum of |F z|² over rows z (n, c) of a triangle F (any, c)."""
    total, height = 0.0, len(F) if len(z) < FEW else max(1, -(-len(F) // PARTS))
    for first in range(0, len(F), height or 1):
        product = z[:, first:] @ F[first : first + height, first:].T
        total += float(np.vdot(product, product))
    return total


class ErrorMaps:
    """Of a ROM with an error model, each found when it is first asked for; runs of the ROM may share them.

    Where the body is touched, inputs are followed by forces on contact points, and there is no residual.
    """

    def __init__(self, rom: Rom, *, touched: bool = False):
        self._rom, self.touched = rom, touched
        self._steps: dict[tuple[str, float], Step] = {}
        self._coordinates: dict[tuple[str, float], Coordinates | None] = {}
        self._blocks: dict[tuple[str, float], list[Block]] = {}
        self._longest: dict[tuple[str, float], tuple[Array, Array]] = {}  # maps of z to [e, r] and to the residual
        self._lifts: dict[str, tuple[Array, Array]] = {}

    def step(self, contact: str, h: float) -> Step:
        """Of h s under the inputs of a contact mode."""
        key = contact, h
        if key not in self._steps:
            if len(self._steps) >= MAX_KEPT:
                for kept in (self._steps, self._coordinates, self._blocks, self._longest):
                    kept.clear()
            errors = self._rom.error_model
            assert errors is not None
            model = errors.finer_model(contact, touched=self.touched)
            f, p = model.inputs.shape
            F = np.empty((0, 2 * f + p)) if self.touched else residual_map(errors, contact, h)
            state = matrices(model, h)[0]
            parts = np.ascontiguousarray(state[:, : 2 * f]), np.ascontiguousarray(state[:, 2 * f :].T)
            self._steps[key], self._longest[key] = Step(*parts, F), (state, F)
        return self._steps[key]

    def coordinates(self, contact: str, h: float) -> Coordinates | None:
        """In which blocks of steps of h s are taken; None where eigenvectors are of no use."""
        key = contact, h
        if key not in self._coordinates:
            step = self.step(contact, h)
            self._coordinates[key] = coordinates_of(step.carry, step.residual)
        return self._coordinates[key]

    def blocks(self, contact: str, h: float, steps: int) -> list[Block]:
        """At most so many steps of h s under the inputs of a contact mode: the most at once, half as many, .. two."""
        key, at = (contact, h), self.coordinates(contact, h)
        if at is None:
            return []
        blocks, p = self._blocks.setdefault(key, []), len(self.step(contact, h).push)
        longest = min(steps, LONGEST, max(2, SPREAD * len(at.heard) // max(p, 1)))  # longer ones have larger triangles
        while 2 * (blocks[0].length if blocks else 1) <= longest:  # each takes as long as all before it
            self._longest[key] = both = _doubled(*self._longest[key])
            blocks.insert(0, _block(at, 2 * (blocks[0].length if blocks else 1), *both))
        return [block for block in blocks if block.length <= steps]

    def lift(self, contact: str) -> tuple[Array, Array]:
        """Maps of e and of r of a contact mode to those of the finer model, (f, m) each."""
        if contact not in self._lifts:
            errors, model = self._rom.error_model, self._rom.contact_models[contact]
            assert errors is not None
            r = errors.coordinates @ model.coordinates
            self._lifts[contact] = np.sqrt(errors.eigenvalues)[:, None] * r / model.safe_frequencies, r
        return self._lifts[contact]


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
    kept = λ.imag >= 0  # the others are conjugates
    W, V = np.linalg.inv(V), np.where(λ.imag > 0, 2.0, 1.0)[:, None, :] * V
    into, back = np.zeros((2, int(kept.sum()), 2 * f), dtype=complex)
    block, column = kept.nonzero()
    own = np.arange(len(block))[:, None]
    into[own, rows[block]], back[own, rows[block]] = W[block, column], V[block, :, column]
    sizes = np.sqrt(sum(np.square(F[:, : 2 * f] @ part.T).sum(axis=0) for part in (back.real, back.imag)))
    order = np.argsort(-sizes)
    left = np.sqrt(np.cumsum(np.square(sizes[order])[::-1])[::-1])  # of each and those after it
    audible = int(np.count_nonzero(left > SILENT * left[0]))
    into, back = into[order], back[order]
    parts_in_turn = np.stack([into.real, into.imag], axis=1).reshape(-1, 2 * f)
    back_in_turn = np.ascontiguousarray(np.stack([back.real, -back.imag], axis=1).reshape(-1, 2 * f).T)
    heard = np.flatnonzero(back_in_turn[:, : 2 * audible].any(axis=0))
    return Coordinates(λ[kept][order], parts_in_turn, back_in_turn, audible, heard)


def onward(powers: Array, start: Array, pushed: Array, audible: int) -> tuple[Array, Array, float]:
    """Lets coordinates y (n,) go on through T blocks that push them by (T, n).

    Returns:
        The first of them before each block (T, audible), all after the last (n,), and what the sum of |y|² of all
        before each block is no larger than.
    """
    times, n = pushed.shape
    if times == 1:
        return start[None, :audible], powers[0] * start + pushed[0], np.vdot(start, start).real
    row = min(RUN, 1 << (times.bit_length() - 1) // 2)
    rows, last = -(-times // row), (times - 1) % row
    y = np.zeros((rows, row, n), dtype=complex) if rows * row > times else pushed.reshape(rows, row, n)
    if rows * row > times:
        y.reshape(-1, n)[:times] = pushed
    for k in range(1, row):  # all rows at once, each from 0
        y[:, k] += powers[0] * y[:, k - 1]
    begins = np.empty((rows, n), dtype=complex)
    begins[0] = start
    for before, own, after in zip(begins[:-1], y[:, -1], begins[1:], strict=False):
        np.multiply(powers[row - 1], before, after)
        after += own
    heard = np.empty((rows, row, audible), dtype=complex)
    heard[:, 0] = begins[:, :audible]
    np.multiply(powers[: row - 1, :audible], begins[:, None, :audible], heard[:, 1:])
    heard[:, 1:] += y[:, :-1, :audible]
    squares = 2 * (row * np.vdot(begins, begins).real + np.vdot(y, y).real)  # as |λ| is at most 1
    return heard.reshape(rows * row, audible)[:times], y[-1, last] + powers[last] * begins[-1], float(squares)


def _block(at: Coordinates, length: int, state: Array, F: Array) -> Block:
    size = len(state)
    by_y = F[:, :size] @ at.back
    residual = triangular(np.hstack([by_y[:, at.heard], F[:, size:]]))
    push = np.ascontiguousarray((at.into @ state[:, size:]).T)
    powers = (at.λ**length) ** np.arange(1, RUN + 1)[:, None]
    return Block(length, powers, push, residual, float(np.linalg.norm(by_y[:, 2 * at.audible :])))


def _doubled(state: Array, F: Array) -> tuple[Array, Array]:
    """The maps of twice as many steps, from z to the state and to what has the squared length of all residuals."""
    (size, columns), added = state.shape, state.shape[1] - state.shape[0]
    lift = np.zeros((columns, columns + added))  # of z to that of the second half
    lift[:size, :columns], lift[size:, columns:] = state, np.eye(added)
    return state @ lift, triangular(np.vstack([np.pad(F, ((0, 0), (0, added))), F @ lift]))
