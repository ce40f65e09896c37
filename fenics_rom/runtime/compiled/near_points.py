"""Contact forces of a linear body of many points, whose operators are never made as a whole.

The law is asked of the points that take part alone. Where their forces move others so that these are to take part,
forces are found anew, as `contact_law` does of pairs. Of the Delassus operator and the residual compliance

    W = T Tᵀ + R/a,    A⁻¹ = L Lᵀ,    T = S L,    R = B + ε - S γ⁻¹ Sᵀ

rows of T are known, and B by blocks. Rows of R are kept of points that touched before (`rom.block_rows`). Points
that are not among these are noted, so that Python keeps theirs for the steps that follow.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.compiled_arrays import unowned
from fenics_rom.mechanics.compiled.contact_law import FOUND, MOST_ROUNDS, NOTHING, OTHERWISE, Law, Pairs, find_forces
from fenics_rom.mechanics.compiled.copying import add_row, add_rows, copy, fill
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.runtime.compiled.block_products import Blocks, places_of, set_among, set_moved
from fenics_rom.runtime.compiled.small_matrices import dot


class Yielding(NamedTuple):
    """How P points yield, of a body with m modes; arrays are empty where R is whole."""

    blocks: Blocks
    roots: Array  # T (3P, m)
    slots: Array  # of each point where its rows of R are kept, (P,); -1: they are not
    rows: Array  # these, (slots, 3, 3P)
    missing: Array  # (P,) 1 of points that touched, and of which they were not; set
    farthest: float  # |T| of a point, at most
    floor: float  # ε


class FoundNear(NamedTuple):
    """What came of a search; see `Found`."""

    status: int
    sweeps: int
    normal_power: float  # W
    fastest: float  # m/s: how fast forces move any point within the basis, at most


@jit_apart
def find_near_forces(
    law: Law,
    points: Array,
    inverse_ω: Array,
    rigid: int,
    a: float,
    yielding: Yielding,
    swung: Array,
    pairs: Pairs,
    f: Array,
    by_contact: Array,
    yields: Array,
) -> FoundNear:
    """As `find_forces`.

    Args:
        law, swung, pairs: as there.
        points, inverse_ω: Sᵀ (m, 3P), and γ^-½ (m,) but of the rigid modes, which come first.
        a: as above.
        yielding: how points yield.
        f: forces on the points (3P,), N; set.
        by_contact, yields: Sᵀ f (m,) and R f (3P,); set.
    """
    pairs, points, yielding = unowned(pairs), unowned(points), unowned(yielding)
    P, sweeps = len(yielding.slots), 0
    are_near, pushed = np.zeros(P, dtype=np.int64), np.empty(len(points))
    for _ in range(MOST_ROUNDS):
        for c in range(len(pairs.chosen)):
            if pairs.chosen[c]:
                are_near[c % P] = 1
        places, before = places_of(yielding.blocks.order, are_near)
        if len(places) == 0:
            return FoundNear(NOTHING, 0, 0.0, 0.0)
        near = yielding.blocks.order[places]
        are_kept = _are_kept(yielding, near)
        W = _operator_among(points, inverse_ω, rigid, a, yielding, near, places, before, are_kept)
        few, swings = _some_of(pairs, near, P), np.empty(len(pairs.chosen) // P * len(near), dtype=np.int64)
        for k in range(len(swings)):
            swings[k] = swung[_pair_of(k, near, P)]
        found = find_forces(law, W, in_one_piece(np.empty((0, 0))), len(near), swings, few)
        sweeps += found.sweeps
        if found.status != FOUND:
            return FoundNear(found.status, sweeps, 0.0, 0.0)
        fill(f, 0.0)
        fill(pairs.forces, 0.0)
        for k in range(len(swings)):
            c = _pair_of(k, near, P)
            copy(few.forces[k], pairs.forces[c])
            pairs.chosen[c] = few.chosen[k]
            for x in range(3):
                f[3 * (c % P) + x] += few.forces[k, x]
        _push(points, yielding, near, f, by_contact, pushed)
        if are_kept:
            fill(yields, 0.0)
            for p in near:
                for x in range(3):
                    add_row(yielding.rows[yielding.slots[p], x], f[3 * p + x], yields)
        else:
            set_moved(yielding.blocks, places, before, f, yields)
            _add_rest(points, inverse_ω, rigid, yielding.floor, f, by_contact, yields)
        if not _choose_missed(pairs, yielding, are_near, pushed, yields, a):
            for k in range(len(swings)):
                c = _pair_of(k, near, P)
                copy(few.target[k], pairs.target[c])
                pairs.helped[c] = few.helped[k]
            fastest = yielding.farthest * math.sqrt(dot(pushed, pushed))
            return FoundNear(FOUND, sweeps, found.normal_power, fastest)
    return FoundNear(OTHERWISE, sweeps, 0.0, 0.0)


@jit_part
def _are_kept(yielding: Yielding, near: Array) -> bool:
    """Whether rows of all these points are; those that are not are noted."""
    are_kept = True
    for p in near:
        if yielding.slots[p] < 0:
            yielding.missing[p], are_kept = 1, False
    return are_kept


@jit_part
def _operator_among(
    points: Array,
    inverse_ω: Array,
    rigid: int,
    a: float,
    yielding: Yielding,
    near: Array,
    places: Array,
    before: Array,
    are_kept: bool,
) -> Array:
    """W of some points (3 s, 3 s), m/s/N."""
    s, m = len(near), len(points)
    W, T = np.empty((3 * s, 3 * s)), np.empty((3 * s, m))
    for k in range(s):
        for x in range(3):
            copy(yielding.roots[3 * near[k] + x], T[3 * k + x])
    if are_kept:
        for k in range(s):
            for x in range(3):
                row, to = yielding.rows[yielding.slots[near[k]], x], W[3 * k + x]
                for j in range(s):
                    for y in range(3):
                        to[3 * j + y] = row[3 * near[j] + y]
    else:
        set_among(yielding.blocks, places, before, W)
        S = np.empty((3 * s, m))
        for k in range(3 * s):
            at = 3 * near[k // 3] + k % 3
            W[k, k] += yielding.floor
            for i in range(m):
                S[k, i] = 0.0 if i < rigid else points[i, at] * inverse_ω[i]
        W -= np.dot(S, S.T)
    by_basis = np.dot(T, T.T)
    for i in range(3 * s):
        for j in range(i + 1):
            W[i, j] = W[j, i] = (W[i, j] + W[j, i]) / (2 * a) + by_basis[i, j]
    return W


@jit_part
def _push(points: Array, yielding: Yielding, near: Array, f: Array, by_contact: Array, pushed: Array) -> None:
    """Sets Sᵀ f and Tᵀ f (m,)."""
    fill(pushed, 0.0)
    for p in near:
        for x in range(3):
            add_row(yielding.roots[3 * p + x], f[3 * p + x], pushed)
    for i in range(len(points)):
        row, total = points[i], 0.0
        for p in near:
            total += row[3 * p] * f[3 * p] + row[3 * p + 1] * f[3 * p + 1] + row[3 * p + 2] * f[3 * p + 2]
        by_contact[i] = total


@jit_part
def _add_rest(
    points: Array, inverse_ω: Array, rigid: int, floor: float, f: Array, by_contact: Array, yields: Array
) -> None:
    """Adds (ε - S γ⁻¹ Sᵀ) f (3P,)."""
    held = np.zeros(len(by_contact))
    for i in range(rigid, len(held)):
        held[i] = -by_contact[i] * inverse_ω[i] ** 2
    add_row(f, floor, yields)
    add_rows(points, held, 0, len(yields), yields)


@jit_part
def _pair_of(k: int, points: Array, P: int) -> int:
    """Which of all pairs that of some points is."""
    return k // len(points) * P + points[k % len(points)]


@jit_part
def _some_of(pairs: Pairs, points: Array, P: int) -> Pairs:
    """Copies of the pairs of some points, obstacle after obstacle."""
    n = len(pairs.chosen) // P * len(points)
    vectors, flags = np.empty((3, n, 3)), np.empty((2, n), dtype=np.bool_)
    asked = vectors[0], vectors[1], vectors[2], np.empty(n), flags[0], flags[1], np.empty(n), np.empty((n, 3))
    few = Pairs(np.empty((n, 3, 3)), *asked)
    for k in range(n):
        c = _pair_of(k, points, P)
        copy(pairs.axes[c], few.axes[k])
        copy(pairs.free[c], few.free[k])
        copy(pairs.relative[c], few.relative[k])
        copy(pairs.target[c], few.target[k])
        copy(pairs.forces[c], few.forces[k])
        few.level[k], few.chosen[k], few.helped[k] = pairs.level[c], pairs.chosen[c], pairs.helped[c]
        few.friction[k] = pairs.friction[c]
    return few


@jit_part
def _choose_missed(pairs: Pairs, yielding: Yielding, are_near: Array, pushed: Array, yields: Array, a: float) -> bool:
    """Whether forces have pairs of other points take part, which are chosen.

    Most are known not to, as T moves no point faster than `farthest` |Tᵀ f|.
    """
    P, missed, fastest = len(are_near), False, yielding.farthest * math.sqrt(dot(pushed, pushed))
    for c in range(len(pairs.chosen)):
        p = c % P
        if not are_near[p] and pairs.level[c] > -np.inf:
            n, at = pairs.axes[c, 0], 3 * p
            x, y, z = yields[at] / a, yields[at + 1] / a, yields[at + 2] / a
            outwards = pairs.free[c, 0] + n[0] * x + n[1] * y + n[2] * z
            if outwards - fastest < pairs.level[c]:
                for k in range(3):
                    outwards += n[k] * dot(yielding.roots[at + k], pushed)
                if outwards < pairs.level[c]:
                    pairs.chosen[c] = missed = True
    return missed
