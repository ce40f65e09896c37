"""Many steps under known inputs at once, as products of matrices.

L steps of one contact mode and step size are one affine map. With the state s = [e, r] at their start, the inputs
U = [u_1, ..., u_L] and the outputs Y,

    s⁺ = [Φᴸ Γ] z,    Y = O z,    supplied = zᵀ S z,    dissipated = zᵀ H z,    z = [s, U].

What comes of the inputs is found for all blocks at once, the state is carried from block to block, and then outputs and
account are read off for all blocks at once. The map of many steps is composed of the maps of few.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fenics_rom.errors import StepError
from fenics_rom.rom.rom import ContactModel
from fenics_rom.runtime.steppers.midpoint import matrices

Array = np.ndarray

MAX_BLOCK_STEPS = 32  # longer blocks have fewer states to carry, but larger maps
BLOCKS_PER_PRODUCT = 128  # whose z are held at once: what fits the cache


@dataclass(frozen=True)
class BlockPropagator:
    """The map of L steps.

    Attributes:
        length: L.
        state: [Φᴸ Γ] (2m, 2m + p L).
        outputs: O (rows, 2m + p L), of every instant at which the outputs are read.
        supplied, dissipated: S and H (2m + p L, 2m + p L), J; None where no account is kept.
    """

    length: int
    state: Array
    outputs: Array
    supplied: Array | None = None
    dissipated: Array | None = None


def build_step(model: ContactModel, h: float, rows: Array, ledger: bool) -> BlockPropagator:
    """The map of a step.

    Args:
        model: the reduced model.
        h: time step, s.
        rows: (R, m) of the outputs that are read after it, acting on e.
        ledger: whether the account is kept.
    """
    m, (state, account) = model.order, matrices(model, h)
    outputs = rows @ state[:m]
    if not ledger:
        return BlockPropagator(1, state, outputs)
    heat, work = account[:m], np.zeros((state.shape[1], state.shape[1]))
    work[2 * m :] = account[m:]
    return BlockPropagator(1, state, outputs, work, heat.T @ heat)


def compose(first: BlockPropagator, second: BlockPropagator, *, silent: bool = False) -> BlockPropagator:
    """The map of one block after the other; `silent`: without the outputs of the first."""
    size, added = first.state.shape[1], second.state.shape[1] - first.state.shape[0]
    lift = np.zeros((second.state.shape[1], size + added))  # of z to the second block's
    lift[: len(first.state), :size] = first.state
    lift[len(first.state) :, size:] = np.eye(added)
    outputs = second.outputs @ lift
    if not silent:
        outputs = np.vstack([np.pad(first.outputs, ((0, 0), (0, added))), outputs])

    def sum_works(of_first: Array | None, of_second: Array | None) -> Array | None:
        if of_first is None or of_second is None:
            return None
        return np.pad(of_first, (0, added)) + lift.T @ of_second @ lift

    return BlockPropagator(
        first.length + second.length,
        second.state @ lift,
        outputs,
        sum_works(first.supplied, second.supplied),
        sum_works(first.dissipated, second.dissipated),
    )


def repeat(block: BlockPropagator, times: int) -> BlockPropagator:
    """The map of a block taken some times, with the outputs of the last one only."""
    if times == 1:
        return block
    half = repeat(block, times // 2)
    whole = compose(half, half, silent=True)
    return compose(whole, block, silent=True) if times % 2 else whole


def build_doubling_blocks(block: BlockPropagator) -> list[BlockPropagator]:
    """A block, twice it, four times it, and so on to the longest one worth having; the longest first."""
    blocks = [block]
    while 2 * blocks[0].length <= MAX_BLOCK_STEPS:
        blocks.insert(0, compose(blocks[0], blocks[0]))
    return blocks


def run_blocks(block: BlockPropagator, state: Array, inputs: Array) -> tuple[Array, Array, float, float]:
    """Takes a block's steps again and again.

    Args:
        block: their map.
        state: (2m,) at the start; overwritten by that at the end.
        inputs: (times, p L) N.

    Returns:
        The outputs (times, rows), the states at each start (times, 2m), and what was supplied and dissipated, J.
    """
    times, size = len(inputs), len(state)
    propagate, forcing = np.ascontiguousarray(block.state[:, :size]).dot, block.state[:, size:].T
    outputs, states = np.empty((times, len(block.outputs))), np.empty((times + 1, size))
    states[0] = state
    supplied = dissipated = 0.0
    for first in range(0, times, BLOCKS_PER_PRODUCT):
        u = inputs[first : first + BLOCKS_PER_PRODUCT]
        bounds = states[first : first + len(u) + 1]
        for before, after, push in zip(bounds[:-1], bounds[1:], u @ forcing, strict=True):
            propagate(before, after)
            np.add(after, push, after)
        z = np.hstack([bounds[:-1], u])
        np.dot(z, block.outputs.T, out=outputs[first : first + BLOCKS_PER_PRODUCT])
        if block.supplied is not None and block.dissipated is not None:
            supplied += float(np.vdot(z @ block.supplied, z))
            dissipated += float(np.vdot(z @ block.dissipated, z))
    state[:] = states[-1]
    return outputs, states[:-1], supplied, dissipated


class ConstantInterval(NamedTuple):
    """Steps `start` to `stop` in one contact mode, of one size dt, s."""

    start: int
    stop: int
    contact: str
    dt: float


def find_constant_intervals(
    steps: int, contact: str | Sequence[str], dt: float | Sequence[float] | Array
) -> list[ConstantInterval]:
    """The steps between changes of contact mode or step size.

    Raises:
        StepError: one of them is neither one for all steps nor one for each.
    """
    columns = []
    for name, values in (("contact", contact), ("dt", dt)):
        column = np.asarray(values, dtype=object)
        if column.shape not in ((), (steps,)):
            raise StepError(f"{name}: allowed is one for all {steps} steps, or one of each, given: {column.shape}")
        columns.append(np.broadcast_to(column, (steps,)))
    if not steps:
        return []
    names, sizes = columns
    changes = np.flatnonzero((names[1:] != names[:-1]) | (sizes[1:] != sizes[:-1])) + 1
    bounds = [0, *map(int, changes), steps]
    return [ConstantInterval(start, stop, names[start], sizes[start]) for start, stop in pairwise(bounds)]
