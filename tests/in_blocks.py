"""ROMs whose residual compliance is kept by blocks, of those that keep its shapes."""

from dataclasses import replace

import numpy as np

import fenics_rom as fr
from fenics_rom.rom.block_matrix import WHOLE, BlockMatrix
from fenics_rom.rom.residual_part import ResidualPart, residual_part, strained_points
from fenics_rom.rom.rom import Rom


def in_blocks(rom: Rom) -> Rom:
    """The same body, with S K⁻¹ Sᵀ in four blocks that leave nothing out, two of which mirror each other."""
    kept, body = rom.residual_compliance, fr.Simulator(rom, 1e-3)
    rows = body.integrator.interface.rows
    H = strained_points(body.rom.stiffness, rows)
    A, P = kept.factor @ kept.factor.T + H @ H.T, len(rows) // 3
    order, n = np.random.default_rng(0).permutation(P), P // 2
    blocks = np.array([[0, n, 0, n, WHOLE], [0, n, n, P, WHOLE], [n, P, n, P, WHOLE]])
    at = (3 * order[:, None] + np.arange(3)).ravel()
    A = A[np.ix_(at, at)]
    values = np.concatenate([A[3 * a : 3 * b, 3 * c : 3 * d].ravel() for a, b, c, d, _ in blocks])
    return replace(rom, residual_compliance=replace(kept, factor=None, static=BlockMatrix(order, blocks, values)))


def whole_part(*given: object) -> ResidualPart:
    """In place of `residual_part`: its operator as a whole."""
    part = residual_part(*given)
    return replace(part, operator=part.operator.whole())


def made_as_a_whole(rows: object) -> None:
    """In place of what makes all rows of an operator, where nothing is to ask for them."""
    raise AssertionError("an operator is made as a whole")
