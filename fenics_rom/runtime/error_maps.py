"""Steps of the finer model in blocks, and the norm of its residual over them; see rom.error_model.

A step of a linear model is linear in z = [e, r, u], and so is its residual: ρᵀD⁻¹ρ = |F z|². Over a block of steps the
sum of all of them is one such square, too, of z = [e, r, u_1, ..., u_L], and F a triangle of so many columns.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.error_model import ErrorModel
from fenics_rom.rom.midpoint_map import compliance, matrices
from fenics_rom.rom.rom import Rom

LONGEST = 128  # steps of a block
SPREAD = 6  # numbers of inputs in a block, for each of the finer model
MAX_KEPT = 32  # maps of step sizes that never come back must not pile up
PARTS = 4  # in which a triangle is multiplied, so that most of its zeros are not
FEW = 8  # rows that are not worth that


class Block(NamedTuple):
    """What steps of the finer model make of its state [e, r] (2f,) and of their inputs."""

    length: int  # L
    carry: Callable[[Array, Array], Array]  # product with (2f, 2f), and where to put it
    push: Array  # (p L, 2f)
    residual: Array  # F (any, 2f + p L), upper triangular, W^1/2


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
        self._blocks: dict[tuple[str, float], list[Block]] = {}
        self._states: dict[tuple[str, float], Array] = {}  # of the longest, from [e, r] and inputs to [e, r]
        self._lifts: dict[str, tuple[Array, Array]] = {}

    def blocks(self, contact: str, h: float, steps: int) -> list[Block]:
        """At most so many steps of h s under the inputs of a contact mode: the most at once, half as many, .. one."""
        key = contact, h
        if key not in self._blocks:
            if len(self._blocks) >= MAX_KEPT:
                self._blocks.clear()
                self._states.clear()
            errors = self._rom.error_model
            assert errors is not None
            model = errors.finer_model(contact, touched=self.touched)
            f, p = model.inputs.shape
            F = np.empty((0, 2 * f + p)) if self.touched else residual_map(errors, contact, h)
            self._states[key] = matrices(model, h)[0]
            self._blocks[key] = [_block(1, self._states[key], F)]
        blocks, state = self._blocks[key], self._states[key]
        f, p = len(state) // 2, blocks[-1].push.shape[0] // blocks[-1].length
        longest = min(steps, LONGEST, max(1, SPREAD * f // max(p, 1)))  # longer blocks have the larger triangles
        while 2 * blocks[0].length <= longest:  # each takes as long as all before it
            state, F = _doubled(state, blocks[0].residual)
            self._states[key] = state
            blocks.insert(0, _block(2 * blocks[0].length, state, F))
        return [block for block in blocks if block.length <= steps]

    def lift(self, contact: str) -> tuple[Array, Array]:
        """Maps of e and of r of a contact mode to those of the finer model, (f, m) each."""
        if contact not in self._lifts:
            errors, model = self._rom.error_model, self._rom.contact_models[contact]
            assert errors is not None
            r = errors.coordinates @ model.coordinates
            self._lifts[contact] = np.sqrt(errors.eigenvalues)[:, None] * r / model.safe_frequencies, r
        return self._lifts[contact]


def _block(length: int, state: Array, F: Array) -> Block:
    size = len(state)
    carried, pushed = np.ascontiguousarray(state[:, :size]), np.ascontiguousarray(state[:, size:].T)
    return Block(length, carried.dot, pushed, F)


def _doubled(state: Array, F: Array) -> tuple[Array, Array]:
    """The maps of twice as many steps, from z to the state and to what has the squared length of all residuals."""
    (size, columns), added = state.shape, state.shape[1] - state.shape[0]
    lift = np.zeros((columns, columns + added))  # of z to that of the second half
    lift[:size, :columns], lift[size:, columns:] = state, np.eye(added)
    return state @ lift, triangular(np.vstack([np.pad(F, ((0, 0), (0, added))), F @ lift]))
