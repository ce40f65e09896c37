"""Cables whose strokes are given, that hold or are slack, compiled: `mechanics.actuator_forces` without friction."""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.actuator_forces import SHARE
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.small_matrices import dot, factor, solve


class Pull(NamedTuple):
    """Cables of a body with m modes, and the forces that are found in a step."""

    columns: Array  # of the input, where n strokes are (n,)
    starts: Array  # of their segments (n + 1,)
    at_rest: Array  # segments (s, 3), m
    shapes: Array  # what they are with q, (s, 3, m)
    lengths: Array  # of the cables at rest (n,), m
    forces: Array  # z (n,) of the step before, N; set
    targets: Array  # rates c (n,), m/s; set, as are the others
    found: Array  # z (n,)
    lines: Array  # Bᵀ (n, m)
    spread: Array  # what forces move (n, m)
    W: Array  # (n, n)


@jit_part
def _line(pull: Pull, k: int, q: Array) -> float:
    """Sets what a cable does under a tension of 1 at q (m,); its length there, m."""
    line, length = pull.lines[k], 0.0
    for i in range(len(line)):
        line[i] = 0.0
    for s in range(pull.starts[k], pull.starts[k + 1]):
        shapes, at = pull.shapes[s], pull.at_rest[s]
        x, y, z = at[0] + dot(shapes[0], q), at[1] + dot(shapes[1], q), at[2] + dot(shapes[2], q)
        size = math.sqrt(x * x + y * y + z * z)
        length += size
        for i in range(len(line)):
            line[i] -= (x * shapes[0, i] + y * shapes[1, i] + z * shapes[2, i]) / size
    return length


@jit_part
def aim(pull: Pull, u: Array, q: Array, r: Array, h: float) -> None:
    """Sets the rates of a step of h s from q and r (m,), to the strokes in u (p,)."""
    for k in range(len(pull.columns)):
        stroke = pull.lengths[k] - _line(pull, k, q)
        pull.targets[k] = SHARE / h * (u[pull.columns[k]] - stroke) + (1 - SHARE) * dot(pull.lines[k], r)


@jit_part
def add_pull(pull: Pull, q: Array, size: float, force: Array) -> None:
    """Adds what the cables do at q to a force (m,), so many times."""
    for k in range(len(pull.columns)):
        _line(pull, k, q)
        for i in range(len(q)):
            force[i] += size * pull.forces[k] * pull.lines[k, i]


@jit_part
def find_pull(pull: Pull, q: Array, U: Array, v: Array, force: Array) -> bool:
    """Sets forces in the middle q of a step, and adds what they do to v̂ and to the force (m,); whether they are found.

    v follows forces by the factor U. Of several cables, which one is slack is not found.
    """
    n, z, W = len(pull.columns), pull.found, pull.W
    for k in range(n):
        _line(pull, k, q)
        copy(pull.lines[k], pull.spread[k])
        solve(U, pull.spread[k])
    for k in range(n):
        z[k] = pull.targets[k] - dot(pull.lines[k], v)
        for j in range(n):
            W[k, j] = (dot(pull.lines[k], pull.spread[j]) + dot(pull.lines[j], pull.spread[k])) / 2
    if not factor(W):
        return False
    solve(W, z)
    for k in range(n):
        if not z[k] >= 0:
            if n > 1 or not z[k] < 0:
                return False
            z[k] = 0.0
    copy(z, pull.forces)
    for k in range(n):
        for i in range(len(v)):
            v[i] += z[k] * pull.spread[k, i]
            force[i] += z[k] * pull.lines[k, i]
    return True
