"""How rows of joints move one another, factored island by island, and contacts where rows hold.

Rigid bodies add M A F of the rows on each, with A what a body answers forces with, and soft ones D W D. Rows of
neighbouring joints are near to one another: factors are banded. Where that finds a pivot that is none, as where an
island holds something twice, it is factored with pivots, and its forces have no part of what they move nothing by.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.world.compiled.joints import Factor, factor_of, solve_held
from fenics_rom.world.compiled.row_maps import Maps, along, answer_to
from fenics_rom.world.compiled.row_tables import COMPLIANCE, FORCED, HELD, MOTION, Rows, rows_at


@jit_apart
def set_rows(world: Array, maps: Maps, K: int) -> None:
    """Sets what rows make of these maps."""
    rows = rows_at(world)
    fill(rows.maps, 0.0)
    for row in range(len(rows.bodies)):
        for e in range(rows.begins[row], rows.begins[row + 1]):
            i = K + rows.pairs[e]
            for side in range(2):
                b = maps.rigid[i, side]
                if b < 0:
                    continue
                slot = 0
                while rows.bodies[row, slot] != b:
                    slot += 1
                for m in range(3):
                    share = (1.0 - 2 * side) * rows.D[e, m]
                    if share != 0.0:
                        for k in range(6):
                            rows.maps[MOTION, row, 6 * slot + k] += share * maps.motion[i, side, m, k]
                            rows.maps[FORCED, row, 6 * slot + k] += share * maps.forced[i, side, m, k]


@jit_apart
def factor_rows(world: Array, maps: Maps, K: int, least: float) -> None:
    """Factors all islands, of rows that are held; least: pivot that counts, as a share of the own."""
    rows = rows_at(world)
    for island in range(len(rows.islands) - 1):
        begin, end = rows.islands[island], rows.islands[island + 1]
        a = _square_of(rows, island)
        _set_island(rows, maps, K, begin, end, a)
        rows.ranks[island, 0] = rows.ranks[island, 1] = -1
        if not _factor_band(rows, begin, end, a, least):
            _set_island(rows, maps, K, begin, end, a)
            _factor_with_pivots(rows, island, a, least)


@jit_part
def _square_of(rows: Rows, island: int) -> Array:
    n = rows.islands[island + 1] - rows.islands[island]
    return rows.matrix[rows.squares[island] : rows.squares[island + 1]].reshape(n, n)


@jit_part
def _set_island(rows: Rows, maps: Maps, K: int, begin: int, end: int, a: Array) -> None:
    """Sets how rows of an island that are held move one another, (n, n), with their compliance; others stay."""
    fill(a, 0.0)
    held, answered = rows.numbers[HELD], np.empty(6)
    for of in range(begin, end):
        if held[of] == 0.0:
            a[of - begin, of - begin] = 1.0
            continue
        a[of - begin, of - begin] += rows.numbers[COMPLIANCE, of]
        for slot in range(rows.bodies.shape[1]):
            b = rows.bodies[of, slot]
            if b < 0:
                break
            answer_to(maps.answers[b], rows.maps[FORCED, of], 6 * slot, answered)
            for at in range(rows.of_bodies[b], rows.of_bodies[b + 1]):
                row, place = rows.rows_of_bodies[at, 0], 6 * rows.rows_of_bodies[at, 1]
                if held[row] != 0.0:
                    a[row - begin, of - begin] += along(rows.maps[MOTION, row], place, answered)
    for k in range(len(rows.soft)):
        row, e = rows.soft[k]
        if not (begin <= row < end and held[row] != 0.0):
            continue
        for m in range(len(rows.soft)):
            of, other = rows.soft[m]
            if begin <= of < end and held[of] != 0.0:
                pair, by = maps.at[K + rows.pairs[e]], maps.at[K + rows.pairs[other]]
                a[row - begin, of - begin] += _between(maps.softᵀ, pair, by, rows.D[e], rows.D[other])


@jit_part
def _between(Wᵀ: Array, to: int, of: int, along: Array, by: Array) -> float:
    total = 0.0
    for k in range(3):
        for m in range(3):
            if along[m] != 0.0 and by[k] != 0.0:
                total += Wᵀ[3 * of + k, 3 * to + m] * along[m] * by[k]
    return total


@jit_part
def _factor_band(rows: Rows, begin: int, end: int, a: Array, least: float) -> bool:
    """Factors without pivots; whether all of them count."""
    n, own = end - begin, np.empty(end - begin)
    for k in range(n):
        own[k] = a[k, k]
    for k in range(n):
        pivot, reach = a[k, k], rows.reach[begin + k] - begin + 1
        if not pivot > least * own[k]:
            return False
        whole, of = 1 / pivot, a[k]
        for i in range(k + 1, reach):
            share, to = a[i, k] * whole, a[i]
            to[k] = share
            if share != 0.0:
                for j in range(k + 1, reach):
                    to[j] -= share * of[j]
    return True


@jit_part
def _factor_with_pivots(rows: Rows, island: int, a: Array, least: float) -> None:
    """Factors an island of rows that are scaled to own compliances of 1."""
    begin, end = rows.islands[island], rows.islands[island + 1]
    held = np.empty(end - begin, dtype=np.int64)
    n = 0
    for row in range(begin, end):
        if rows.numbers[HELD, row] != 0.0:
            held[n] = row
            n += 1
    matrix = np.empty((n, n))
    for i in range(n):
        rows.scale[held[i]] = 1 / math.sqrt(max(a[held[i] - begin, held[i] - begin], 1e-300))
    for i in range(n):
        for j in range(n):
            scale = rows.scale[held[i]] * rows.scale[held[j]]
            matrix[i, j] = scale * a[held[i] - begin, held[j] - begin]
    factor = factor_of(matrix, least)
    first = rows.squares[island]
    for i in range(n):
        rows.order[begin + i] = factor.order[i]
        for j in range(n):
            rows.matrix[first + n * i + j] = matrix[i, j]
    for i in range(n - factor.rank):
        for j in range(n):
            rows.idle[first + n * i + j] = factor.idle[i, j]
    rows.ranks[island, 0], rows.ranks[island, 1] = n, factor.rank


@jit_apart
def solve_rows(world: Array, island: int, x: Array) -> None:
    """Has x (R,) of an island be forces of rows, of what is asked of those that are held; others stay."""
    rows = rows_at(world)
    begin, end = rows.islands[island], rows.islands[island + 1]
    n, rank = rows.ranks[island]
    if rank >= 0:
        _solve_with_pivots(rows, island, n, rank, x)
        return
    a = _square_of(rows, island)
    for k in range(end - begin):
        share = x[begin + k]
        if share != 0.0:
            for i in range(k + 1, rows.reach[begin + k] - begin + 1):
                x[begin + i] -= a[i, k] * share
    for k in range(end - begin - 1, -1, -1):
        total, of = x[begin + k], a[k]
        for j in range(k + 1, rows.reach[begin + k] - begin + 1):
            total -= of[j] * x[begin + j]
        x[begin + k] = total / of[k]


@jit_part
def _solve_with_pivots(rows: Rows, island: int, n: int, rank: int, x: Array) -> None:
    begin, end, first = rows.islands[island], rows.islands[island + 1], rows.squares[island]
    idle = rows.idle[first : first + n * (n - rank)].reshape(n - rank, n)
    factor = Factor(rows.matrix[first : first + n * n].reshape(n, n), rows.order[begin : begin + n], rank, idle)
    asked, found, i = np.empty(n), np.empty(n), 0
    for row in range(begin, end):
        if rows.numbers[HELD, row] != 0.0:
            asked[i] = rows.scale[row] * x[row]
            i += 1
    solve_held(factor, asked, found)
    i = 0
    for row in range(begin, end):
        if rows.numbers[HELD, row] != 0.0:
            x[row] = rows.scale[row] * found[i]
            i += 1


@jit_part
def solve_all(world: Array, x: Array) -> None:
    """The same of all islands."""
    for island in range(len(rows_at(world).islands) - 1):
        solve_rows(world, island, x)


class HeldContacts(NamedTuple):
    """K contacts where rows hold."""

    across: Array  # (3K, R) velocities of contacts per force of rows
    spreadᵀ: Array  # (3K, R) forces of rows per force of contact, with the other sign
    contactsᵀ: Array  # (3K, 3K) Wᵀ


@jit_apart
def hold_contacts(world: Array, maps: Maps, K: int, of: HeldContacts) -> None:
    """Sets what rows make of contacts."""
    rows = rows_at(world)
    held = rows.numbers[HELD]
    fill(of.across, 0.0)
    fill(of.spreadᵀ, 0.0)
    fill(of.contactsᵀ, 0.0)
    twist, answer = np.empty(6), np.empty(6)
    for i in range(K):
        for k in range(3):
            c = 3 * i + k
            for side in range(2):
                b, sign = maps.rigid[i, side], 1.0 - 2 * side
                if b < 0:
                    continue
                answer_to(maps.answers[b], maps.forced[i, side, k], 0, twist)
                for m in range(6):
                    answer[m] = 0.0
                    for n in range(6):
                        answer[m] += maps.answers[b, n, m] * maps.motion[i, side, k, n]
                for at in range(rows.of_bodies[b], rows.of_bodies[b + 1]):
                    row, place = rows.rows_of_bodies[at, 0], 6 * rows.rows_of_bodies[at, 1]
                    if held[row] != 0.0:
                        of.spreadᵀ[c, row] += sign * along(rows.maps[MOTION, row], place, twist)
                        of.across[c, row] += sign * along(rows.maps[FORCED, row], place, answer)
                for j in range(K):
                    for other in range(2):
                        if maps.rigid[j, other] == b:
                            for m in range(3):
                                moved = along(maps.motion[j, other, m], 0, twist)
                                of.contactsᵀ[c, 3 * j + m] += sign * (1.0 - 2 * other) * moved
            if maps.at[i] >= 0:
                _add_soft_contact(rows, maps, K, i, k, of)
            of.contactsᵀ[c, c] += maps.slack[i]
    for c in range(3 * K):
        for island in range(len(rows.islands) - 1):
            begin, end = rows.islands[island], rows.islands[island + 1]
            is_touched = False
            for row in range(begin, end):
                is_touched = is_touched or of.spreadᵀ[c, row] != 0.0
            if not is_touched:
                continue
            solve_rows(world, island, of.spreadᵀ[c])
            for j in range(3 * K):
                total = 0.0
                for row in range(begin, end):
                    total += of.across[j, row] * of.spreadᵀ[c, row]
                of.contactsᵀ[c, j] -= total


@jit_part
def _add_soft_contact(rows: Rows, maps: Maps, K: int, i: int, k: int, of: HeldContacts) -> None:
    """Adds what soft bodies answer an axis of a contact with, and what they move there."""
    c, at, Wᵀ = 3 * i + k, maps.at[i], maps.softᵀ
    for n in range(len(rows.soft)):
        row, e = rows.soft[n]
        pair = maps.at[K + rows.pairs[e]]
        if rows.numbers[HELD, row] != 0.0:
            for m in range(3):
                of.spreadᵀ[c, row] += Wᵀ[3 * at + k, 3 * pair + m] * rows.D[e, m]
                of.across[c, row] += Wᵀ[3 * pair + m, 3 * at + k] * rows.D[e, m]
    for j in range(K):
        if maps.at[j] >= 0:
            for m in range(3):
                of.contactsᵀ[c, 3 * j + m] += Wᵀ[3 * at + k, 3 * maps.at[j] + m]
