"""Cables and chambers whose strokes are given, and cables that rub at guides, of a body that deforms largely, compiled.

`mechanics.compiled.actuator_forces` finds their forces.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.actuator_forces import CREEP
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill
from fenics_rom.mechanics.compiled.gas import blow_in, keep_gas
from fenics_rom.mechanics.compiled.searched_forces import Actuators, room_for_search
from fenics_rom.runtime.compiled.following import add_pressed_slope, add_pulled_slope
from fenics_rom.runtime.compiled.small_matrices import dot, solve
from fenics_rom.runtime.compiled.strain_tables import set_products


class Pull(NamedTuple):
    """Of n forces that are found, N or Pa, of a body with m modes.

    At a guide it is what a cable from its anchor to there does. So a cable goes on from its last guide, and from one
    guide to the next one.
    """

    actuators: Actuators
    friction: Array  # μ at guides (n,)
    chambers: Array  # which of the polynomials they have (n,); -1: of a cable
    after: Array  # the guide that it goes on from (n,); -1: none
    starts: Array  # of segments from there (n + 1,)
    beyond: Array  # the segment behind a guide (n,)
    at_rest: Array  # segments of cables (s, 3), m
    shapes: Array  # what they are with q, (s, 3, m)
    lengths: Array  # of the cables at rest (n,), m; 0 of chambers
    polynomials: Array  # of forces of 1 Pa in chambers (c, m, N), see `Following`
    products: Array  # of q in these, (N,); set, as are the others:
    forces: Array  # z (n,) of the step before, then of this one
    targets: Array  # rates c (n,), m/s or m³/s
    found: Array  # z (n,)
    strokes: Array  # (n,), m or m³,
    strokes_before: Array  # and those at the start of the step
    bends: Array  # μα at guides (n,)
    lines: Array  # Bᵀ (n, m)
    spread: Array  # what forces move (n, m)
    W: Array  # (n, n)
    search: Array  # numbers of a `Search`


def rooms_for_pull(n: int, m: int) -> tuple[Array, ...]:
    """For what is set, but for products and forces."""
    sizes = (n,), (n,), (n,), (n,), (n,), (n, m), (n, m), (n, n), (room_for_search(n),)
    return tuple(map(np.zeros, sizes))


@jit_part
def own_pull(pull: Pull, forces: Array) -> Pull:
    """Of a body of many, whose forces of the step before are these (n,)."""
    n, m, p = len(forces), pull.lines.shape[1], pull
    fixed = p.actuators, p.friction, p.chambers, p.after, p.starts, p.beyond, p.at_rest, p.shapes, p.lengths
    vectors = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    rest = np.zeros((n, m)), np.zeros((n, m)), np.zeros((n, n)), np.zeros(len(p.search))
    return Pull(*fixed, p.polynomials, np.zeros(len(p.products)), forces, *vectors, *rest)


@jit_part
def set_lines(pull: Pull, q: Array) -> None:
    """Sets what forces of 1 do at q (m,), and strokes there."""
    n, g = len(pull.forces), len(pull.actuators.guides)
    for i in range(n):
        k = n - g + i if i < g else i - g  # guides first, from the anchor on
        line, after, length = pull.lines[k], pull.after[k], 0.0
        if pull.chambers[k] >= 0:
            pull.strokes[k] = _swell(pull.polynomials[pull.chambers[k]], q, pull.products, line)
            continue
        fill(line, 0.0)
        if after >= 0:
            copy(pull.lines[after], line)
            length = pull.lengths[after] - pull.strokes[after]
        for s in range(pull.starts[k], pull.starts[k + 1]):
            x, y, z = _segment(pull, s, q)
            size, shapes = math.sqrt(x * x + y * y + z * z), pull.shapes[s]
            length += size
            for j in range(len(line)):
                line[j] -= (x * shapes[0, j] + y * shapes[1, j] + z * shapes[2, j]) / size
        pull.strokes[k] = pull.lengths[k] - length


@jit_part
def set_chamber_strokes(pull: Pull, q: Array) -> None:
    """Sets strokes of chambers at q (m,)."""
    for k in range(len(pull.forces)):
        if pull.chambers[k] >= 0:
            pull.strokes[k] = _swell(pull.polynomials[pull.chambers[k]], q, pull.products, pull.lines[k])


@jit_part
def blow_at(pull: Pull | None, e: Array, inverse_ω: Array, amounts: Array, u: Array, h: float) -> float:
    """As `gas.blow_in`, where √γ q is e (m,)."""
    if pull is None:
        return 0.0
    if len(pull.actuators.gases) == 0:
        return 0.0
    set_chamber_strokes(pull, e * inverse_ω)
    return blow_in(pull.actuators, pull.strokes, amounts, u, h)


@jit_part
def keep_at(pull: Pull | None, e: Array, inverse_ω: Array, u: Array, amounts: Array) -> float:
    """As `gas.keep_gas`."""
    if pull is None:
        return 0.0
    if len(pull.actuators.gases) == 0:
        return 0.0
    set_chamber_strokes(pull, e * inverse_ω)
    return keep_gas(pull.actuators, pull.strokes, u, amounts)


@jit_part
def _segment(pull: Pull, s: int, q: Array) -> tuple[float, float, float]:
    """A segment of a cable at q (m,), m."""
    shapes, at = pull.shapes[s], pull.at_rest[s]
    return at[0] + dot(shapes[0], q), at[1] + dot(shapes[1], q), at[2] + dot(shapes[2], q)


@jit_part
def set_bends(pull: Pull, q: Array) -> None:
    """Sets μ times what cables turn by at guides at q (m,)."""
    for k in range(len(pull.forces) - len(pull.actuators.guides), len(pull.forces)):
        a, b, c = _segment(pull, pull.starts[k + 1] - 1, q)
        x, y, z = _segment(pull, pull.beyond[k], q)
        across = math.sqrt((b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2)
        pull.bends[k] = pull.friction[k] * math.atan2(across, a * x + b * y + c * z)


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
    given, first = pull.actuators, len(pull.forces) - len(pull.actuators.guides)
    set_lines(pull, q)
    for k in range(len(pull.forces)):
        share, missing = given.share[k], 0.0 if k >= first else u[given.columns[k]] - pull.strokes[k]
        pull.targets[k] = share / h * missing + (1 - share) * dot(pull.lines[k], r)
    copy(pull.forces, pull.found)
    copy(pull.strokes, pull.strokes_before)


@jit_part
def add_pull(pull: Pull, q: Array, size: float, force: Array) -> None:
    """Adds what the forces of the step before do at q to a force (m,), so many times."""
    set_lines(pull, q)
    for k in range(len(pull.forces)):
        add_row(pull.lines[k], size * pull.forces[k], force)


@jit_part
def add_pull_slope(pull: Pull, q: Array, size: float, slope: Array) -> None:
    """Adds, so many times, what the forces that are found do at q changes by with q (m, m)."""
    n, tensions = len(pull.forces), pull.found.copy()
    for i in range(n):
        k = i if i < n - len(pull.actuators.guides) else 2 * n - len(pull.actuators.guides) - 1 - i
        if pull.after[k] >= 0:
            tensions[pull.after[k]] += tensions[k]
        if pull.chambers[k] >= 0:
            add_pressed_slope(pull.polynomials[pull.chambers[k]], q, size * pull.found[k], slope)
        for s in range(pull.starts[k], pull.starts[k + 1]):
            add_pulled_slope(pull.at_rest[s], pull.shapes[s], q, size * tensions[k], slope)


@jit_part
def set_pull(pull: Pull, q: Array, U: Array) -> None:
    """Sets what forces do in the middle q (m,) of a step in which v̂ follows them by the factor U."""
    n = len(pull.forces)
    set_lines(pull, q)
    set_bends(pull, q)
    for k in range(n):
        copy(pull.lines[k], pull.spread[k])
        solve(U, pull.spread[k])
    for k in range(n):
        for j in range(n):
            pull.W[k, j] = (dot(pull.lines[k], pull.spread[j]) + dot(pull.lines[j], pull.spread[k])) / 2
        if k >= n - len(pull.actuators.guides):
            pull.W[k, k] += CREEP * pull.W[k, k]


@jit_part
def end_pull(pull: Pull, v: Array, force: Array) -> float:
    """Has the forces that are found be those of the step, and adds what strokes do to others (m,).

    The power of guides, W, with v̂ (m,): what they dissipate, less than 0.
    """
    power = 0.0
    copy(pull.found, pull.forces)
    for k in range(len(pull.forces)):
        if k < len(pull.forces) - len(pull.actuators.guides):
            add_row(pull.lines[k], pull.found[k], force)
        else:
            power += pull.found[k] * dot(pull.lines[k], v)
    return power
