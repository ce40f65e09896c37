"""How rows of joints move one another, factored island by island, and contacts where rows hold.

Rigid bodies add M A F of the rows on each, with A what a body answers forces with, and soft ones D W D. Rows of
neighbouring joints are near to one another: factors are banded. Where that finds a pivot that is none, as where an
island holds something twice, it is factored with pivots, and its forces have no part of what they move nothing by.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.frames import added, rotated, vector
from fenics_rom.world import rigid_answers, turning
from fenics_rom.world.compiled.couples import couple_of
from fenics_rom.world.compiled.joints import Factor, factor_of, solve_held
from fenics_rom.world.compiled.rigid_bodies import rows_of
from fenics_rom.world.compiled.row_tables import COMPLIANCE, FORCED, HELD, MOTION, Rows
from fenics_rom.world.compiled.tables import SLIDES, freedoms_at, joined_at, near_at, rigid_at

_answers_where_held = jit_shared(rigid_answers.answers_where_held)
_product, _transposed = map(jit_shared, (turning.product, turning.transposed))


class Maps(NamedTuple):
    """Of n pairs, K contacts, then points of joints."""

    rigid: Array  # (n, 2) bodies that move freely; -1: others
    motion: Array  # (n, 2, 3, 6) what v̂ and R ω̂ of these move a pair by
    forced: Array  # (n, 2, 3, 6) by which a force of a pair is one, and a torque, on these
    answers: Array  # (B, 6, 6) v̂ and R ω̂ per force and torque
    at: Array  # (n,) of pairs at soft bodies, where they are in: -1: others
    softᵀ: Array  # (3s, 3s) Wᵀ of soft bodies
    slack: Array  # (K,) what is added to the compliance of contacts, m/s/N


@jit_part
def set_maps(world: Array, h: float, among: Array, K: int, f: Array, maps: Maps) -> None:
    """Sets those of rigid bodies as forces f (n, 3) of some pairs (n,) were tried."""
    near, rigid, freedoms = near_at(world), rigid_at(world), freedoms_at(world)
    B, n = len(rigid.mass), len(among)
    pushed, held = np.zeros((B, 3)), np.zeros((B, 3, 3))
    for i in range(n):
        c = among[i]
        couples = couple_of(near.meetings, near.features, c) >= 0
        for side in range(2):
            b = near.rigid[c, side]
            maps.rigid[i, side] = b
            if b < 0 or couples:
                continue
            for k in range(3):
                force = (1.0 - 2 * side) * f[i, k]
                if i < K or (side == 0 and near.features[c] == SLIDES):
                    pushed[b, k] += force
                else:
                    for m in range(3):
                        held[b, m, k] += near.arms[c, side, m] * force
    spun, bent, ends = np.empty((B, 3, 3)), np.empty((B, 3, 3)), np.empty((B, 3, 3))
    for b in range(B):
        tried, R = freedoms.tries[b], rows_of(rigid.rotation[b])
        of_body = rigid.mass[b], rows_of(rigid.inertia[b]), R
        loads = vector(pushed[b], 0), vector(tried[1], 0), rows_of(held[b]), vector(tried[3], 0)
        found, answer = _answers_where_held(h, *of_body, *loads), maps.answers[b]
        fill(answer, 0.0)
        for i in range(3):
            answer[i, i] = found.per_force
            for k in range(3):
                answer[3 + i, k], answer[3 + i, 3 + k] = found.levered[i][k], found.turning[i][k]
                spun[b, i, k], bent[b, i, k], ends[b, i, k] = found.spun[i][k], found.bent[i][k], found.end[i][k]
    for i in range(n):
        c = among[i]
        couples = couple_of(near.meetings, near.features, c) >= 0
        for side in range(2):
            b = maps.rigid[i, side]
            if b < 0:
                continue
            motion, forced = maps.motion[i, side], maps.forced[i, side]
            if couples:
                set_couple(motion)
                set_couple(forced)
            elif i < K or (side == 0 and near.features[c] == SLIDES):
                middle = added(vector(rigid.motion[b, 0], 0), h / 2, vector(freedoms.tries[b, 2], 0))
                arm = added(vector(near.places[c], 0), -1.0, middle)
                set_point(motion, arm)
                set_point(forced, arm)
                for m in range(3):
                    for k in range(3):
                        motion[m, k] -= spun[b, m, k]
            else:
                y = vector(near.arms[c, side], 0)
                begin, end = rotated(rows_of(rigid.rotation[b]), y), rotated(rows_of(ends[b]), y)
                arm = (begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2, (begin[2] + end[2]) / 2
                set_point(motion, arm)
                set_point(forced, arm)
                more = _product(_product(rows_of(spun[b]), _crossed(end)), rows_of(bent[b]))
                for m in range(3):
                    for k in range(3):
                        motion[m, 3 + k] += more[m][k]


@jit_part
def _crossed(a: Vector) -> Rotation:
    """C with C ω = ω × a."""
    return (0.0, a[2], -a[1]), (-a[2], 0.0, a[0]), (a[1], -a[0], 0.0)


@jit_part
def set_point(of: Array, arm: Vector) -> None:
    """Sets what a body's velocity and turning (6,) move a point at an arm by, (3, 6)."""
    rows = _crossed(arm)
    for m in range(3):
        for k in range(3):
            of[m, k], of[m, 3 + k] = 1.0 if m == k else 0.0, rows[m][k]


@jit_part
def set_couple(of: Array) -> None:
    """The same of a pair that stands for how bodies turn."""
    for m in range(3):
        for k in range(3):
            of[m, k], of[m, 3 + k] = 0.0, 1.0 if m == k else 0.0


@jit_part
def move(maps: Maps, f: Array, u: Array) -> None:
    """Adds W f to velocities u (n, 3)."""
    B, n = len(maps.answers), len(f)
    wrenches, twists = np.zeros((B, 6)), np.zeros((B, 6))
    for i in range(n):
        for side in range(2):
            b = maps.rigid[i, side]
            if b >= 0:
                for m in range(3):
                    share = (1.0 - 2 * side) * f[i, m]
                    if share != 0.0:
                        for k in range(6):
                            wrenches[b, k] += share * maps.forced[i, side, m, k]
    for b in range(B):
        for k in range(6):
            for m in range(6):
                twists[b, k] += maps.answers[b, k, m] * wrenches[b, m]
    for i in range(n):
        for side in range(2):
            b = maps.rigid[i, side]
            if b >= 0:
                for m in range(3):
                    for k in range(6):
                        u[i, m] += (1.0 - 2 * side) * maps.motion[i, side, m, k] * twists[b, k]
        if i < len(maps.slack):
            for m in range(3):
                u[i, m] += maps.slack[i] * f[i, m]
    for i in range(n if len(maps.softᵀ) else 0):
        for j in range(n if maps.at[i] >= 0 else 0):
            if maps.at[j] >= 0:
                _add_soft(maps.softᵀ, maps.at[j], maps.at[i], f[j], u[i])


@jit_part
def _add_soft(Wᵀ: Array, of: int, to: int, f: Array, u: Array) -> None:
    """Adds what a pair moves by a force (3,) on another one to u (3,)."""
    for k in range(3):
        for m in range(3):
            u[m] += Wᵀ[3 * of + k, 3 * to + m] * f[k]


@jit_part
def set_rows(rows: Rows, maps: Maps, K: int) -> None:
    """Sets what rows make of these maps."""
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


@jit_part
def factor_rows(rows: Rows, maps: Maps, K: int, least: float) -> None:
    """Factors all islands, of rows that are held; least: pivot that counts, as a share of the own."""
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
def answer_to(answer: Array, of: Array, at: int, twist: Array) -> None:
    """Sets the twist (6,) that a body answers a force and torque with, which begin in a row at some place."""
    for k in range(6):
        twist[k] = 0.0
        for m in range(6):
            twist[k] += answer[k, m] * of[at + m]


@jit_part
def along(of: Array, at: int, twist: Array) -> float:
    """What a twist (6,) moves by a map, which begins in a row at some place."""
    total = 0.0
    for k in range(6):
        total += of[at + k] * twist[k]
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


@jit_part
def solve_rows(rows: Rows, island: int, x: Array) -> None:
    """Has x (R,) of an island be forces of rows, of what is asked of those that are held; others stay."""
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
def solve_all(rows: Rows, x: Array) -> None:
    """The same of all islands."""
    for island in range(len(rows.islands) - 1):
        solve_rows(rows, island, x)


class HeldContacts(NamedTuple):
    """K contacts where rows hold."""

    across: Array  # (3K, R) velocities of contacts per force of rows
    spreadᵀ: Array  # (3K, R) forces of rows per force of contact, with the other sign
    contactsᵀ: Array  # (3K, 3K) Wᵀ


@jit_part
def hold_contacts(rows: Rows, maps: Maps, K: int, of: HeldContacts) -> None:
    """Sets what rows make of contacts."""
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
            solve_rows(rows, island, of.spreadᵀ[c])
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


@jit_part
def maps_of(world: Array, K: int, at: Array, softᵀ: Array) -> Maps:
    """Room for those of K contacts and all points of joints."""
    n, B = K + len(joined_at(world).ends), len(rigid_at(world).mass)
    rigid, answers = np.full((n, 2), -1), np.zeros((B, 6, 6))
    return Maps(rigid, np.zeros((n, 2, 3, 6)), np.zeros((n, 2, 3, 6)), answers, at, softᵀ, np.zeros(K))
