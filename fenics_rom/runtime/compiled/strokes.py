"""Cables whose strokes are given, that hold or are slack, compiled: `mechanics.actuator_forces` without friction."""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.actuator_forces import SHARE, TOLERANCE
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.following import add_pressed_slope, add_pulled_slope
from fenics_rom.runtime.compiled.small_matrices import dot, factor, solve, solve_rows
from fenics_rom.runtime.compiled.strain_tables import set_products


class Pull(NamedTuple):
    """Cables and chambers of a body with m modes, and the forces that are found in a step, N or Pa."""

    columns: Array  # of the input, where n strokes are (n,)
    chambers: Array  # which of the polynomials they have (n,); -1: of a cable
    starts: Array  # of segments (n + 1,)
    at_rest: Array  # segments of cables (s, 3), m
    shapes: Array  # what they are with q, (s, 3, m)
    lengths: Array  # of the cables at rest (n,), m; 0 of chambers
    polynomials: Array  # of forces of 1 Pa in chambers (c, m, N), see `Following`
    products: Array  # of q in these, (N,); set, as are the others:
    forces: Array  # z (n,) of the step before, then of this one
    targets: Array  # rates c (n,), m/s or m³/s
    found: Array  # z (n,)
    lines: Array  # Bᵀ (n, m)
    spread: Array  # what forces move (n, m)
    W: Array  # (n, n)
    holds: Array  # 1 of those that go as they are to (n,), 0 of cables that are slack


@jit_part
def own_pull(pull: Pull, forces: Array) -> Pull:
    """Of a body of many, whose forces of the step before are these (n,)."""
    n, m, c = len(pull.columns), pull.lines.shape[1], pull.chambers
    fixed = pull.columns, c, pull.starts, pull.at_rest, pull.shapes, pull.lengths, pull.polynomials
    rates = np.zeros(len(pull.products)), forces, np.zeros(n), np.zeros(n)
    return Pull(*fixed, *rates, np.zeros((n, m)), np.zeros((n, m)), np.zeros((n, n)), np.zeros(n))


@jit_part
def _line(pull: Pull, k: int, q: Array) -> float:
    """Sets what a cable does under a tension of 1, or a chamber under a pressure, at q (m,); its stroke there."""
    line, length = pull.lines[k], 0.0
    if pull.chambers[k] >= 0:
        return _swell(pull.polynomials[pull.chambers[k]], q, pull.products, line)
    for i in range(len(line)):
        line[i] = 0.0
    for s in range(pull.starts[k], pull.starts[k + 1]):
        shapes, at = pull.shapes[s], pull.at_rest[s]
        x, y, z = at[0] + dot(shapes[0], q), at[1] + dot(shapes[1], q), at[2] + dot(shapes[2], q)
        size = math.sqrt(x * x + y * y + z * z)
        length += size
        for i in range(len(line)):
            line[i] -= (x * shapes[0, i] + y * shapes[1, i] + z * shapes[2, i]) / size
    return pull.lengths[k] - length


@jit_part
def _swell(polynomial: Array, q: Array, products: Array, force: Array) -> float:
    """Sets the force (m,) of a pressure of 1 at q; by how much the volume is larger than at rest, m³: ∫ force·dq."""
    m, volume = len(q), 0.0
    set_products(1.0, q, products)
    for i in range(m):
        row = polynomial[i]
        constant, linear = row[0] * products[0], dot(row[1 : m + 1], products[1 : m + 1])
        square = dot(row[m + 1 :], products[m + 1 :])
        force[i] = constant + linear + square
        volume += q[i] * (constant + linear / 2 + square / 3)
    return volume


@jit_part
def aim(pull: Pull, u: Array, q: Array, r: Array, h: float) -> None:
    """Sets the rates of a step of h s from q and r (m,), to the strokes in u (p,)."""
    for k in range(len(pull.columns)):
        stroke = _line(pull, k, q)
        pull.targets[k] = SHARE / h * (u[pull.columns[k]] - stroke) + (1 - SHARE) * dot(pull.lines[k], r)


@jit_part
def add_pull(pull: Pull, q: Array, size: float, force: Array) -> None:
    """Adds what the cables do at q to a force (m,), so many times."""
    for k in range(len(pull.columns)):
        _line(pull, k, q)
        for i in range(len(q)):
            force[i] += size * pull.forces[k] * pull.lines[k, i]


@jit_part
def add_pull_slope(pull: Pull, q: Array, size: float, slope: Array) -> None:
    """Adds, so many times, what the forces that are found do at q changes by with q (m, m)."""
    for k in range(len(pull.columns)):
        if pull.chambers[k] >= 0:
            add_pressed_slope(pull.polynomials[pull.chambers[k]], q, size * pull.found[k], slope)
        for s in range(pull.starts[k], pull.starts[k + 1]):
            add_pulled_slope(pull.at_rest[s], pull.shapes[s], q, size * pull.found[k], slope)


@jit_part
def find_pull(pull: Pull, q: Array, U: Array, v: Array) -> bool:
    """Sets forces with which cables go as they are to, in the middle q of a step with v̂ (m,); whether there are any.

    v follows forces by the factor U. What is found is negative where a cable would push, or a chamber sucks.
    """
    for k in range(len(pull.columns)):
        _line(pull, k, q)
        copy(pull.lines[k], pull.spread[k])
        solve(U, pull.spread[k])
        pull.holds[k] = 1.0
    return find_held(pull, v)


@jit_part
def find_held(pull: Pull, v: Array) -> bool:
    """The same of those that hold, where lines are known; others have none."""
    n, z, W, holds = len(pull.columns), pull.found, pull.W, pull.holds
    for k in range(n):
        z[k] = holds[k] * (pull.targets[k] - dot(pull.lines[k], v))
        for j in range(n):
            W[k, j] = (dot(pull.lines[k], pull.spread[j]) + dot(pull.lines[j], pull.spread[k])) / 2
            if not (holds[k] and holds[j]):
                W[k, j] = 1.0 if k == j else 0.0
    if not factor(W):
        return False
    solve(W, z)
    return True


@jit_part
def is_settled(pull: Pull, v: Array) -> bool:
    """Whether all cables pull, or are shorter than they have to be, with v̂ of a step (m,); others let go, or hold."""
    scale, settled = 0.0, True
    for k in range(len(pull.columns)):
        scale = max(scale, abs(pull.targets[k]), abs(dot(pull.lines[k], v)))
    for k in range(len(pull.columns)):
        if pull.holds[k]:
            goes_on = pull.found[k] >= 0 or pull.chambers[k] >= 0
        else:
            goes_on = pull.targets[k] - dot(pull.lines[k], v) <= TOLERANCE * scale
        if not goes_on:
            pull.holds[k], settled = 1.0 - pull.holds[k], False
    return settled


@jit_part
def move_by(pull: Pull, size: float, v: Array) -> None:
    """Adds to v̂ (m,) what the forces that are found do, so many times."""
    for k in range(len(pull.columns)):
        for i in range(len(v)):
            v[i] += size * pull.found[k] * pull.spread[k, i]


@jit_part
def end_pull(pull: Pull, force: Array) -> None:
    """Has the forces that are found be those of the step, and adds what they do to others (m,)."""
    copy(pull.found, pull.forces)
    for k in range(len(pull.columns)):
        for i in range(len(force)):
            force[i] += pull.found[k] * pull.lines[k, i]


@jit_part
def hold_back(pull: Pull, points: Array, W: Array) -> None:
    """Has W (3P, 3P) be that of points Sᵀ (m, 3P) while cables that hold go as they are to, W - X W⁻¹ Xᵀ."""
    X = np.zeros((len(pull.columns), len(W)))
    for k in range(len(X)):
        for i in range(len(points) if pull.holds[k] else 0):
            row, share = points[i], pull.spread[k, i]
            for j in range(len(W)):
                X[k, j] += share * row[j]
    solve_rows(pull.W, X)
    for k in range(len(X)):
        for i in range(len(W) if pull.holds[k] else 0):
            for j in range(len(W)):
                W[i, j] -= X[k, i] * X[k, j]


@jit_part
def hold(pull: Pull, pushed: Array, v: Array) -> None:
    """Has strokes that are held go as they are to under other forces (m,), too, and adds to v̂ what that takes."""
    change = np.empty(len(pull.columns))
    for k in range(len(change)):
        change[k] = -pull.holds[k] * dot(pull.spread[k], pushed)
    solve(pull.W, change)
    for k in range(len(change)):
        pull.found[k] += change[k]
        for i in range(len(v)):
            v[i] += change[k] * pull.spread[k, i]
