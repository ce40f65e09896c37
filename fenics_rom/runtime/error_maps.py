"""Steps of the finer model, one by one and in blocks, and the norm of its residual over them; see rom.error_model.

A step of a linear model is linear in z = [e, r, u], and so is its residual: ρᵀD⁻¹ρ = |F z|². Over a block of steps the
sum of all of them is one such square, too, of z = [e, r, u_1, ..., u_L], and F a triangle; error_blocks has these.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import compiled
from fenics_rom.rom.error_model import ErrorModel
from fenics_rom.rom.midpoint_map import compliance, matrices
from fenics_rom.rom.rom import Rom
from fenics_rom.runtime.error_blocks import Block, BlockMaker, Coordinates, coordinates_of, triangular

LONGEST = 64  # steps of a block
SPREAD = 8  # numbers of inputs in a block, for each of the state that has a residual
PART = 48  # numbers of inputs in a part of a block, where parts go on in loops
PARTS = 4  # most of them in a block
MANY = 2**18  # steps of runs that are worth loops: these take a second to load
MAX_KEPT = 32  # maps of step sizes that never come back must not pile up


class Step(NamedTuple):
    """What a step of the finer model makes of its state [e, r] (2f,) and of its inputs."""

    carry: Array  # (2f, 2f)
    push: Array  # (p, 2f)
    residual: Array  # F (any, 2f + p), upper triangular, W^1/2


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


class ErrorMaps:
    """Of a ROM with an error model, each found when it is first asked for; runs of the ROM may share them.

    Where the body is touched, inputs are followed by forces on contact points, and there is no residual.
    """

    def __init__(self, rom: Rom, *, touched: bool = False):
        self._rom, self.touched = rom, touched
        self._steps: dict[tuple[str, float], Step] = {}
        self._coordinates: dict[tuple[str, float], Coordinates | None] = {}
        self._makers: dict[tuple[str, float, bool], BlockMaker] = {}
        self._blocks: dict[tuple[str, float, bool], list[Block]] = {}
        self._lifts: dict[str, tuple[Array, Array]] = {}
        self._taken = 0  # steps in blocks

    def step(self, contact: str, h: float) -> Step:
        """Of h s under the inputs of a contact mode."""
        key = contact, h
        if key not in self._steps:
            if len(self._steps) >= MAX_KEPT:
                for kept in (self._steps, self._coordinates, self._makers, self._blocks):
                    kept.clear()
            errors = self._rom.error_model
            assert errors is not None
            model = errors.finer_model(contact, touched=self.touched)
            f, p = model.inputs.shape
            F = np.empty((0, 2 * f + p)) if self.touched else residual_map(errors, contact, h)
            state = matrices(model, h)[0]
            parts = np.ascontiguousarray(state[:, : 2 * f]), np.ascontiguousarray(state[:, 2 * f :].T)
            self._steps[key] = Step(*parts, F)
        return self._steps[key]

    def coordinates(self, contact: str, h: float) -> Coordinates | None:
        """In which blocks of steps of h s are taken; None where eigenvectors are of no use."""
        key = contact, h
        if key not in self._coordinates:
            step = self.step(contact, h)
            self._coordinates[key] = coordinates_of(step.carry, step.residual)
        return self._coordinates[key]

    def in_loops(self, steps: int) -> bool:
        """Whether so many further steps are to be taken in loops: all are, once runs have become long."""
        self._taken += steps
        return self._taken > MANY and compiled()

    def blocks(self, contact: str, h: float, steps: int, *, loops: bool = False) -> list[Block]:
        """At most so many steps of h s under the inputs of a contact mode: the most at once, half as many, .. two."""
        key, at, step = (contact, h, loops), self.coordinates(contact, h), self.step(contact, h)
        if at is None:
            return []
        blocks, p = self._blocks.setdefault(key, []), max(len(step.push), 1)
        part = max(2, PART // p if loops else SPREAD * 2 * at.heard // p)  # longer ones have larger triangles
        longest = min(steps, LONGEST, PARTS * part if loops else part)
        if key not in self._makers:
            self._makers[key] = BlockMaker(at, np.hstack([step.carry, step.push.T]), step.residual, part)
        while 2 * (blocks[0].length if blocks else 1) <= longest:  # each takes as long to make as all before it
            blocks.insert(0, self._makers[key].next())
        return [block for block in blocks if block.length <= steps]

    def lift(self, contact: str) -> tuple[Array, Array]:
        """Maps of e and of r of a contact mode to those of the finer model, (f, m) each."""
        if contact not in self._lifts:
            errors, model = self._rom.error_model, self._rom.contact_models[contact]
            assert errors is not None
            r = errors.coordinates @ model.coordinates
            self._lifts[contact] = np.sqrt(errors.eigenvalues)[:, None] * r / model.safe_frequencies, r
        return self._lifts[contact]
