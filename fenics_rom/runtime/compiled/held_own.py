"""A held body that touches itself, in its compiled step: `mechanics.self_contact`, of the pairs that are near alone.

Where points are to be held that would go through a triangle, NumPy takes the step.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.contact_law import (
    FOUND,
    MOST_ROUNDS,
    NOTHING,
    OTHERWISE,
    Found,
    Law,
    Pairs,
    find_forces,
)
from fenics_rom.mechanics.compiled.copying import add_row, add_rows, copy, fill, largest_of
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.compiled.own_pairs import add_up_pairs, ask_pairs, set_corner_maps, set_operator
from fenics_rom.mechanics.compiled.own_surface import (
    NONE,
    Candidates,
    Surface,
    find_facing,
    look_for,
    margin_among,
    set_boxes,
)
from fenics_rom.mechanics.compiled.work_space import rows_of
from fenics_rom.mechanics.surface_pairs import DEEPEST
from fenics_rom.runtime.compiled.small_matrices import dot, solve, solve_rows, squares
from fenics_rom.runtime.compiled.touching import Begun, StepContact, Touched, forget_pairs, move_points, place_points
from fenics_rom.runtime.compiled.yielding import set_yielding_of


class Own(NamedTuple):
    """What of a body with P contact points touches itself."""

    surface: Surface
    known: Candidates  # changed
    nodes: Array  # corners (P, 3) of what each point that takes part meets, set,
    weights: Array  # and of these there (P, 3)
    nodes_before: Array  # both in the last of steps in a row that was taken
    weights_before: Array


@jit_part
def keep_opposite(own: Own | None) -> None:
    """Notes what points meet in a step that is taken, of steps in a row."""
    if own is not None:
        copy(own.nodes, own.nodes_before)
        copy(own.weights, own.weights_before)


@jit_part
def find_own(
    own: Own,
    touch: Touched,
    law: Law,
    begun: Begun,
    q: Array,
    r: Array,
    v: Array,
    factor: Array,
    beyond: Array,
    pull: Array,
    found: StepContact,
    pushed: Array,
) -> Found:
    """Finds forces of a body on itself; sets what is found, and what they do (m,).

    Args:
        own, touch, law, begun: of the body.
        q, r, v: shape and rates at the start, and v̂ without contact (m,).
        factor: of the step's matrix (m, m).
        beyond, pull: as of `touching.ask_points`.
        found: set, of P pairs.
        pushed: set.
    """
    P, h = len(touch.places), law.h
    places, moves, normals = np.empty((P, 3)), np.empty((2, P, 3)), np.empty((P, 3))
    place_points(touch, q, beyond, found.motion[0], places)
    move_points(touch, r, v, beyond, pull, found.motion[1], found.motion[2])
    copy(rows_of(found.motion[2], 3), moves[0])
    copy(rows_of(found.motion[1], 3), moves[1])
    forget_pairs(found.pairs)
    fill(found.pairs.forces, 0.0)
    fill(found.pairs.target, 0.0)
    fill(found.pairs.relative, 0.0)
    fill(found.forces, 0.0)
    near, moved = _look_around(own, h, places, moves, normals, found.gaps), np.zeros(3 * P)
    contact = Found(NOTHING, 0, 0.0)
    if len(near) > 0:
        contact = _find_of(own, touch, law, begun, near, places, moves, normals, factor, found, pushed, moved)
    if contact.status == NOTHING:
        fill(pushed, 0.0)
        fill(moved, 0.0)
    if contact.status == OTHERWISE or _may_go_through(own, law, places, moves[0], moved):
        return Found(OTHERWISE, 0, 0.0)
    return contact


@jit_part
def _look_around(own: Own, h: float, places: Array, moves: Array, normals: Array, gaps: Array) -> Array:
    """Sets gaps (P,) and normals (P, 3) of pairs, and what they meet; points (C,) of those that may take part.

    `places` (P, 3), m; `moves` (2, P, 3): velocities without contact and at the start, m/s.
    """
    (surface, known, nodes, weights, _, _), P, t = own, len(places), len(own.surface.triangles)
    low, high, of_triangles, ways = np.empty((t, 3)), np.empty((t, 3)), np.empty((t, 3)), np.empty(moves.shape)
    for p in range(P):
        for k in range(3):
            ways[0, p, k], ways[1, p, k] = 8 * h * moves[0, p, k], 2 * h * moves[1, p, k]
    size, most = set_boxes(places, surface.triangles, low, high, of_triangles), _goes(ways[0]) + _goes(ways[1])
    count = look_for(surface, known, places, low, high, size, most)
    rows = known.row[:count], known.triangle[:count]
    margin, reach = margin_among(places, ways, rows[0], rows[1], surface.triangles, low, high), DEEPEST * size
    count = look_for(surface, known, places, low, high, size, margin + reach)
    on, twin, plain, away = np.empty(P, np.int64), np.empty(P, np.int64), np.empty((P, 3)), np.empty(P)
    facing, near = (surface.triangles, of_triangles, surface.outer), (known.row[:count], known.triangle[:count])
    border, into = (surface.sides, surface.corners), (on, twin, weights, plain, normals, away)
    find_facing(places, *facing, *near, low, high, *border, size, margin, reach, *into)
    due = h * math.sqrt(3.0) * (2 * largest_of(moves[0]) + largest_of(moves[1]))
    farthest, rows_near, C = max(due, margin / 2), np.empty(P, np.int64), 0
    for p in range(P):
        gaps[p] = math.inf
        if on[p] != NONE and (twin[p] == NONE or p < twin[p]):
            gaps[p] = away[p]
            for k in range(3):
                nodes[p, k] = surface.triangles[on[p], k]
            if gaps[p] <= farthest:
                rows_near[C] = p
                C += 1
    return rows_near[:C]


@jit_part
def _goes(ways: Array) -> float:
    """How far points that go (P, 3), m, go relative to one another at most, m."""
    x = y = z = most = 0.0
    for p in range(len(ways)):
        x, y, z = x + ways[p, 0], y + ways[p, 1], z + ways[p, 2]
    x, y, z = x / len(ways), y / len(ways), z / len(ways)
    for p in range(len(ways)):
        most = max(most, (ways[p, 0] - x) ** 2 + (ways[p, 1] - y) ** 2 + (ways[p, 2] - z) ** 2)
    return 2 * math.sqrt(most)


@jit_part
def _find_of(
    own: Own,
    touch: Touched,
    law: Law,
    begun: Begun,
    near: Array,
    places: Array,
    moves: Array,
    normals: Array,
    factor: Array,
    found: StepContact,
    pushed: Array,
    moved: Array,
) -> Found:
    """Forces of pairs at some points (C,), which are set, and by how much they move points, (3P,), m/s.

    The law is asked of all of them. Forces are found of those that take part, and of others that these forces bring in.
    """
    C, (nodes, maps), still = len(near), _moved_by(own, near, places), np.zeros((1, 3))
    pairs, before, gaps, swung = _room_for(C), np.empty((C, 3)), np.empty(C), np.empty(C, np.int64)
    for c in range(C):
        p = near[c]
        gaps[c], swung[c], pairs.friction[c] = found.gaps[p], begun.swung[p], found.pairs.friction[p]
        for k in range(3):
            pairs.axes[c, 0, k] = normals[p, k]
            pairs.forces[c, k] = before[c, k] = begun.forces[p, k]
    none, rests = np.empty(0), Beside(still, still, still[:0])
    nothing = pairs.chosen[:0], pairs.chosen[:0], none
    ask_pairs(law, law, moves, nodes, maps, 0, gaps, rests, before, none, nothing, pairs)
    sweeps = 0
    for _ in range(MOST_ROUNDS):
        some = pairs.chosen.nonzero()[0]
        if len(some) == 0:
            break
        few, operator = _room_for(len(some)), np.empty((3 * len(some), 3 * len(some)))
        for c in range(len(some)):
            _copy_pair(pairs, some[c], few, c)
        of_few = nodes[some], maps[some]
        _set_operator(touch, factor, of_few[0], of_few[1], operator)
        contact = find_forces(law, operator, in_one_piece(np.empty((0, 0))), len(some), swung[some], few)
        sweeps += contact.sweeps
        if contact.status != FOUND:
            return Found(OTHERWISE, sweeps, 0.0)
        add_up_pairs(contact, of_few[0], of_few[1], few, rows_of(found.forces, 3))
        _answer(touch, factor, found.forces, pushed, moved)
        if not choose_missed(pairs, nodes, maps, moved):
            for c in range(len(some)):
                _copy_pair(few, c, found.pairs, near[some[c]])
            return Found(FOUND, sweeps, contact.normal_power)
    return Found(NOTHING if len(some) == 0 else OTHERWISE, sweeps, 0.0)


@jit_part
def _moved_by(own: Own, near: Array, places: Array) -> tuple[Array, Array]:
    """Points (C, 4) that pairs at some points (C,) move with, and what the velocity of each adds, (C, 4, 3, 3)."""
    C = len(near)
    nodes, maps, of_corners = np.empty((C, 4), np.int64), np.zeros((C, 4, 3, 3)), np.zeros((C, 3, 3, 3))
    set_corner_maps(places, near, own.nodes[near], own.weights[near], of_corners)
    for c in range(C):
        nodes[c, 0] = near[c]
        for i in range(3):
            maps[c, 0, i, i], nodes[c, 1 + i] = 1.0, own.nodes[near[c], i]
            for k in range(3):
                for j in range(3):
                    maps[c, 1 + k, i, j] = -of_corners[c, k, i, j]
    return nodes, maps


@jit_part
def _room_for(C: int) -> Pairs:
    """So many pairs, of which nothing is known."""
    vectors, flags, axes = np.zeros((4, C, 3)), np.zeros((2, C), np.bool_), np.empty((C, 3, 3))
    return Pairs(axes, vectors[0], vectors[1], vectors[2], np.empty(C), flags[0], flags[1], np.empty(C), vectors[3])


@jit_part
def _copy_pair(pairs: Pairs, c: int, to: Pairs, number: int) -> None:
    """Copies all that is known of a pair."""
    copy(pairs.axes[c], to.axes[number])
    to.level[number], to.chosen[number], to.helped[number] = pairs.level[c], pairs.chosen[c], pairs.helped[c]
    to.friction[number] = pairs.friction[c]
    for k in range(3):
        to.free[number, k], to.relative[number, k] = pairs.free[c, k], pairs.relative[c, k]
        to.target[number, k], to.forces[number, k] = pairs.target[c, k], pairs.forces[c, k]


@jit_part
def choose_missed(pairs: Pairs, nodes: Array, maps: Array, moved: Array) -> bool:
    """Whether forces that move points by (3P,), m/s, have other pairs take part, which are chosen."""
    missed = False
    for c in range(len(nodes)):
        if not pairs.chosen[c]:
            outwards = pairs.free[c, 0]
            for k in range(4):
                at, by = 3 * nodes[c, k], maps[c, k]
                for i in range(3):
                    along = by[i, 0] * moved[at] + by[i, 1] * moved[at + 1] + by[i, 2] * moved[at + 2]
                    outwards += pairs.axes[c, 0, i] * along
            if outwards < pairs.level[c]:
                pairs.chosen[c] = missed = True
    return missed


@jit_part
def _answer(touch: Touched, factor: Array, forces: Array, pushed: Array, moved: Array) -> None:
    """Sets what forces on the points (3P,) do, (m,), and how they move points in the step, (3P,), m/s."""
    for i in range(len(pushed)):
        pushed[i] = dot(touch.points[i], forces)
    answer = pushed.copy()
    solve(factor, answer)
    fill(moved, 0.0)
    if len(touch.R) > 0:
        rates = np.empty(len(moved))
        set_yielding_of(touch.R, forces, rates)
        add_row(rates, 1 / touch.whole, moved)
    add_rows(touch.points, answer, 0, len(moved), moved)


@jit_part
def _set_operator(touch: Touched, factor: Array, nodes: Array, maps: Array, operator: Array) -> None:
    """Sets relative velocities of pairs per force of each (3C, 3C), by the factor of the step's matrix."""
    m, C, (points, R) = len(factor), len(nodes), (touch.points, touch.R)
    rows = np.zeros((m, 3 * C))
    for n in range(m):
        row, into = points[n], rows[n]
        for c in range(C):
            for k in range(4):
                at, by = 3 * nodes[c, k], maps[c, k]
                for i in range(3):
                    into[3 * c + i] += by[i, 0] * row[at] + by[i, 1] * row[at + 1] + by[i, 2] * row[at + 2]
    solve_rows(factor, rows)
    squares(rows, operator)
    if len(R) > 0:
        beyond = np.empty(operator.shape)
        set_operator(R, nodes, maps, beyond)
        for i in range(3 * C):
            add_row(beyond[i], 1 / touch.whole, operator[i])


@jit_part
def _may_go_through(own: Own, law: Law, places: Array, free: Array, moved: Array) -> bool:
    """Whether points, with velocities (P, 3) and (3P,) beside these, m/s, go so far that they may pass triangles."""
    ways, flat, little = np.empty((1, len(places), 3)), rows_of(moved, 3), law.radius
    for p in range(len(places)):
        for k in range(3):
            ways[0, p, k] = law.h * (free[p, k] + flat[p, k])
    goes = _goes(ways[0])
    if goes <= little:
        return False
    surface, known, t = own.surface, own.known, len(own.surface.triangles)
    low, high, normals = np.empty((t, 3)), np.empty((t, 3)), np.empty((t, 3))
    size = set_boxes(places, surface.triangles, low, high, normals)
    count = look_for(surface, known, places, low, high, size, goes)
    given = places, ways, known.row[:count], known.triangle[:count]
    return margin_among(*given, surface.triangles, low, high) > little
