"""The Delassus operator of contacts that take part in a step, of all bodies, and its inverse.

The part of soft bodies is kept with the contacts that it is of. Where the step before had the same, and no soft body
turns, so is its inverse: Newton's method then has that of the whole, with six freedoms of each rigid body beside it.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.mechanics.compiled.newton import Inverse, in_one_piece
from fenics_rom.mechanics.frame_motion import Rotation
from fenics_rom.runtime.compiled.frames import rotated, vector
from fenics_rom.world.compiled.couples import are_couples, couple_of
from fenics_rom.world.compiled.free_operators import Pushes, operator_of_free
from fenics_rom.world.compiled.rigid_bodies import Pushed, add_answers, inverse_with, look_at_answers
from fenics_rom.world.compiled.row_tables import rows_at
from fenics_rom.world.compiled.soft_bodies import MIDDLE, has_residual, outward_of, rows_in, turn_at
from fenics_rom.world.compiled.soft_operators import Places, operator_of
from fenics_rom.world.compiled.tables import (
    COUNT,
    FREE,
    IS_INVERSE_KNOWN,
    OF_JOINT,
    SOFT,
    YIELDS,
    Near,
    Operators,
    bodies_at,
    freedoms_at,
    is_followed,
    is_soft,
    joined_at,
    near_at,
    operators_at,
    rigid_at,
    softs_at,
)
from fenics_rom.world.tolerances import PROXIMAL

MOST = 100  # pairs of which operators are kept
SLID = 1e-6  # of a triangle: by so much contacts may have moved there since


@jit_part
def square_in(numbers: Array, n: int) -> Array:
    """A matrix (n, n) that begins many numbers."""
    return numbers[: n * n].reshape(n, n)


class Operator(NamedTuple):
    """Of n pairs that take part: K contacts, then points of joints."""

    Wᵀ: Array  # (3n, 3n)
    inverse: Inverse  # of it, if it is known
    maps: Array  # (B, 6, 3n) of rigid bodies, and
    answers: Array  # (B, 6, 6), as of `rigid_bodies.look_at_answers`
    slack: Array  # (K,) what is added to the compliance of each contact, m/s/N


@jit_part
def pushed_among(world: Array, C: int, among: Array) -> Pushed:
    """Where rigid bodies are pushed by some pairs (n,), of which C are contacts."""
    near = near_at(world)
    inverse, are = freedoms_at(world).inverse, are_couples(near, among)
    none, order = np.empty(0, dtype=np.int64), rows_at(world).turns
    return Pushed(C, near.rigid[among], near.places[among], near.arms[among], inverse, are, none, order)


@jit_part
def operator_among(world: Array, h: float, among: Array, C: int, free: bool) -> Operator:
    """That of some pairs (n,), of which C are contacts, at the forces that bodies tried last."""
    bodies, operators, rigid = bodies_at(world), operators_at(world), rigid_at(world)
    K, known = len(among), operators.known
    n, is_kept = 3 * K, len(among) <= MOST
    same = not free and is_kept and _are_same(world, among)  # what free ones answer changes in each try
    of_soft = square_in(operators.soft, n) if is_kept else np.empty((n, n))
    Wᵀ, inverse = square_in(operators.whole, n) if is_kept else np.empty((n, n)), in_one_piece(np.empty((0, 0)))
    if not same:
        fill(of_soft, 0.0)
        yields = np.zeros(K, dtype=np.bool_)
        for b in range(len(bodies.kinds)):
            if bodies.kinds[b] == SOFT:
                add_soft(world, h, among, b, of_soft, yields)
            elif bodies.kinds[b] == FREE:
                add_free(world, h, among, b, of_soft, yields)
        known[IS_INVERSE_KNOWN], known[YIELDS] = 0.0, yields[:C].all()
        _keep(world, among, is_kept)
    if same and C == K and known[YIELDS] and not known[IS_INVERSE_KNOWN]:
        known[IS_INVERSE_KNOWN] = 1.0 if _invert_definite(of_soft, square_in(operators.inverse, n)) else -1.0
    B = len(rigid.mass)
    maps, answers, slack = np.empty((B, 6, n)), np.empty((B, 6, 6)), np.zeros(C)
    look_at_answers(rigid, h, pushed_among(world, C, among), freedoms_at(world).tries, maps, answers)
    add_answers(maps, answers, C, of_soft, Wᵀ)
    if same and C == K and known[IS_INVERSE_KNOWN] > 0:
        inverse = inverse_with(square_in(operators.inverse, n), maps, answers)
    if not known[YIELDS]:
        _make_regular(world, among[:C], Wᵀ, slack)
    return Operator(Wᵀ, inverse, maps, answers, slack)


@jit_part
def be_ready(world: Array, h: float) -> None:
    """Has all be compiled that soft bodies need where something touches them, before it does."""
    bodies, nobody = bodies_at(world), np.empty(0, dtype=np.int64)
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == SOFT:
            add_soft(world, h, nobody, b, np.empty((0, 0)), np.empty(0, dtype=np.bool_))
        elif bodies.kinds[b] == FREE:
            add_free(world, h, nobody, b, np.empty((0, 0)), np.empty(0, dtype=np.bool_))


@jit_part
def _are_same(world: Array, among: Array) -> bool:
    """Whether the part of soft bodies is that which is kept."""
    near, operators, softs = near_at(world), operators_at(world), softs_at(world)
    if operators.known[COUNT] != len(among):
        return False
    for i in range(len(among)):
        c = among[i]
        if operators.slots[i] != near.slots[c] or not _is_there(operators, i, near, c):
            return False
    for s in range(len(softs)):
        turn = turn_at(softs[s])
        for k in range(30):
            if operators.frames[s, k] != turn[k]:
                return False
    return True


@jit_part
def _is_there(operators: Operators, i: int, near: Near, c: int) -> bool:
    """Whether a pair is where that was which is kept, next to: between points of a soft body it slides in its slot."""
    if near.meetings[c] == OF_JOINT:
        return True
    for side in range(2):
        for k in range(operators.nodes.shape[2]):
            share = near.weights[c, side, k]
            if abs(share - operators.weights[i, side, k]) > SLID:
                return False
            if share != 0.0 and near.nodes[c, side, k] != operators.nodes[i, side, k]:
                return False
    return True


@jit_part
def _keep(world: Array, among: Array, is_kept: bool) -> None:
    near, operators, softs = near_at(world), operators_at(world), softs_at(world)
    operators.known[COUNT] = len(among) if is_kept else 0
    if not is_kept:
        return
    for i in range(len(among)):
        c = among[i]
        operators.slots[i] = near.slots[c]
        for side in range(2):
            for k in range(operators.nodes.shape[2]):
                operators.nodes[i, side, k] = near.nodes[c, side, k]
                operators.weights[i, side, k] = near.weights[c, side, k]
    for s in range(len(softs)):
        turn = turn_at(softs[s])
        for k in range(30):
            operators.frames[s, k] = turn[k]


@jit_apart
def add_soft(world: Array, h: float, among: Array, b: int, Wᵀ: Array, yields: Array) -> None:
    """Adds the part of a soft body that is not free, and notes which contacts yield by it."""
    near, table, K = near_at(world), softs_at(world)[bodies_at(world).numbers[b]], len(among)
    rows, signs, count = np.empty(2 * K, dtype=np.int64), np.empty(2 * K), 0
    wide = near.weights.shape[2]
    nodes, weights = np.zeros((2 * K, wide), dtype=np.int64), np.zeros((2 * K, wide))
    turns = np.full(2 * K, -1)
    yields_itself = has_residual(table)
    for i in range(K):
        for side in range(2):
            if near.ends[among[i], side] == b:
                rows[count], signs[count] = i, 1.0 - 2 * side
                copy(near.nodes[among[i], side], nodes[count])
                copy(near.weights[among[i], side], weights[count])
                turns[count], count = couple_of(near.meetings, near.features, among[i]), count + 1
                yields[i] = yields[i] or yields_itself
    if count == 0:
        return
    turn, arms = turn_at(table), joined_at(world).arms_of_turning
    outward, middle = outward_of(turn, h), rows_in(turn, MIDDLE)
    some = Places(nodes[:count], weights[:count], turns[:count], arms)
    inside = operator_of(table, some, outward, middle)
    for i in range(count):
        for j in range(count):
            _add_block(inside, i, j, outward, middle, signs[i] * signs[j], Wᵀ, rows[i], rows[j])


@jit_apart
def add_free(world: Array, h: float, among: Array, b: int, Wᵀ: Array, yields: Array) -> None:
    """The same of a free one, under the forces of now."""
    near, table = near_at(world), softs_at(world)[bodies_at(world).numbers[b]]
    pushes, yields_itself = pushes_on(world, among, near.forces, b), has_residual(table)
    if not len(pushes.nodes):
        return
    W = operator_of_free(table, h, pushes)
    for i in range(len(pushes.nodes)):
        yields[pushes.rows[i]] = yields[pushes.rows[i]] or yields_itself
        for j in range(len(pushes.nodes)):
            sign, to, of = pushes.signs[i] * pushes.signs[j], 3 * pushes.rows[i], 3 * pushes.rows[j]
            for k in range(3):
                for n in range(3):
                    Wᵀ[of + n, to + k] += sign * W[3 * i + k, 3 * j + n]


@jit_part
def pushes_on(world: Array, among: Array, f: Array, b: int) -> Pushes:
    """What some contacts (K,) do to a free body by forces f (C, 3)."""
    bodies, near, K, count = bodies_at(world), near_at(world), len(among), 0
    rows, signs, follows = np.empty(2 * K, dtype=np.int64), np.empty(2 * K), np.zeros(2 * K)
    turns = np.full(2 * K, -1)
    wide = near.weights.shape[2]
    nodes, weights = np.zeros((2 * K, wide), dtype=np.int64), np.zeros((2 * K, wide))
    forces, places = np.empty((2 * K, 3)), np.empty((2 * K, 3))
    for i in range(K):
        c = among[i]
        for side in range(2):
            if near.ends[c, side] == b:
                rows[count], signs[count] = i, 1.0 - 2 * side
                copy(near.nodes[c, side], nodes[count])
                copy(near.weights[c, side], weights[count])
                copy(near.places[c], places[count])
                turns[count] = couple_of(near.meetings, near.features, c)
                follows[count] = is_followed(bodies, near, c, side)
                for k in range(3):
                    forces[count, k] = signs[count] * f[c, k]
                count += 1
    own = nodes[:count], weights[:count], forces[:count], places[:count], follows[:count]
    return Pushes(*own, rows[:count], signs[:count], turns[:count], joined_at(world).arms_of_turning)


@jit_part
def _add_block(
    inside: Array, i: int, j: int, outward: Rotation, middle: Rotation, sign: float, Wᵀ: Array, to: int, of: int
) -> None:
    """Adds ± outward W middleᵀ of a block (3, 3) to that of two contacts, transposed."""
    a, b, c = inside[3 * i], inside[3 * i + 1], inside[3 * i + 2]
    rows = vector(a, 3 * j), vector(b, 3 * j), vector(c, 3 * j)
    once = rotated(middle, rows[0]), rotated(middle, rows[1]), rotated(middle, rows[2])  # rows of W middleᵀ
    for k in range(3):
        moved = rotated(outward, (once[0][k], once[1][k], once[2][k]))
        row = Wᵀ[3 * of + k]
        for n in range(3):
            row[3 * to + n] += sign * moved[n]


@jit_part
def _invert_definite(Wᵀ: Array, inverse: Array) -> bool:
    """Sets the inverse of the symmetric part of a matrix (n, n); whether it is definite (Cholesky)."""
    n = len(Wᵀ)
    L = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = (Wᵀ[i, j] + Wᵀ[j, i]) / 2
            row, other = L[i], L[j]
            for k in range(j):
                total -= row[k] * other[k]
            if i == j:
                if not total > 1e-12 * Wᵀ[i, i]:
                    return False
                L[i, i] = total**0.5
            else:
                L[i, j] = total / L[j, j]
    X = np.zeros((n, n))  # L⁻¹, row after row
    for i in range(n):
        X[i, i] = 1 / L[i, i]
        for k in range(i):
            share, of = -L[i, k] / L[i, i], X[k]
            for j in range(k + 1):
                X[i, j] += share * of[j]
    inverse[:] = 0.0
    for k in range(n):
        of = X[k]
        for i in range(k + 1):
            share, to = of[i], inverse[i]
            for j in range(k + 1):
                to[j] += share * of[j]
    return True


@jit_part
def _make_regular(world: Array, among: Array, W: Array, slack: Array) -> None:
    """Adds a compliance, which is set, to each pair whose points do not yield by themselves, as a Guide does."""
    bodies, near, softs = bodies_at(world), near_at(world), softs_at(world)
    K = len(among)
    own, least = np.zeros(K), 0.0
    for i in range(K):
        own[i] = (W[3 * i, 3 * i] + W[3 * i + 1, 3 * i + 1] + W[3 * i + 2, 3 * i + 2]) / 3
        least = max(least, 1e-12 * own[i])
    for i in range(K):
        yields = False
        for side in range(2):
            body = near.ends[among[i], side]
            if is_soft(bodies.kinds[body]) and has_residual(softs[bodies.numbers[body]]):
                yields = True
        if not yields:
            slack[i] = PROXIMAL * max(own[i], least)
            for k in range(3 * i, 3 * i + 3):
                W[k, k] += slack[i]
