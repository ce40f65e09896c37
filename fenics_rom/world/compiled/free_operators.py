"""How points of a free soft body answer the forces on them: W = ∂u/∂f of `steppers.pushed_step`."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.contact_points import WHOLE, Points, arm_of
from fenics_rom.runtime.compiled.frame_tables import body_at, loads_at, state_at
from fenics_rom.runtime.compiled.frames import Acting, act, added, cross, dot, put, rotated, rotated_back, vector
from fenics_rom.runtime.compiled.free_balance import lack, set_slopes
from fenics_rom.runtime.compiled.kept_slopes import keep_inverse
from fenics_rom.world.compiled.couples import Turning, map_in, turned_by
from fenics_rom.world.compiled.soft_bodies import (
    CENTRE,
    END,
    MIDDLE,
    RIMS,
    SPUN,
    START,
    TORQUE,
    TURN,
    points_at,
    rows_in,
    step_at,
)

_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Pushes(NamedTuple):
    """Forces on k points of a body, which its nodes carry."""

    nodes: Array  # (k, c)
    weights: Array  # (k, c) of these
    forces: Array  # (k, 3) N
    places: Array  # (k, 3) of other bodies' points, m, and
    follows: Array  # (k,) whether it is pushed there
    rows: Array  # (k,) which contacts they are
    signs: Array  # (k,) of their forces
    couples: Array  # (k,) of which surfaces they are couples; -1: forces on points
    arms_of_turning: Array  # of these, as of `Joined`, in the frame's axes


@jit_part
def acting_on(table: Array) -> Acting:
    """What acts on a body in the step that has begun, but for contact."""
    step, of = step_at(table), act(loads_at(table), step_at(table).u, len(body_at(table).ω))
    force, torque = vector(step.turn, RIMS), vector(step.turn, RIMS + 3)
    force, torque = added(of.force, 1.0, force), added(of.torque, 1.0, torque)
    return Acting(of.modal, force, torque, of.acceleration, of.by_shape, of.at_points)


@jit_part
def mean_arm(points: Points, pushes: Pushes, i: int, R: Rotation, end: Rotation, h: float) -> Vector:
    """Of a point that is pushed, from the frame's origin in the middle of a step, in world axes, m."""
    arm = (0.0, 0.0, 0.0)
    for k in range(pushes.weights.shape[1]):
        if pushes.weights[i, k] != 0.0:
            arm = added(arm, pushes.weights[i, k], arm_of(points, pushes.nodes[i, k], R, end, h))
    return arm


@jit_part
def turning_at(pushes: Pushes, i: int) -> Turning:
    """Of a surface that a couple acts on."""
    return Turning(pushes.nodes[i], pushes.weights[i], pushes.arms_of_turning[pushes.couples[i]])


@jit_part
def operator_of_free(table: Array, h: float, pushes: Pushes) -> Array:
    """W = ∂u/∂f (3k, 3k) of the points that are pushed by the forces that were tried last, in world axes, m/s/N.

    But for what forces that turn with the body make of its translation.
    """
    body, loads, state, points, step = (
        body_at(table), loads_at(table), state_at(table), points_at(table), step_at(table),
    )  # fmt: skip
    turn, x, q, now, m = step.turn, step.changed, state.halves[0] * body.inverse_ω, state.now[0], len(body.ω)
    k, n, by_force = len(pushes.nodes), 3 + m, h / 2 / body.mass
    R, end, middle, t = rows_in(turn, START), rows_in(turn, END), rows_in(turn, MIDDLE), vector(turn, TURN)
    rows, C = _mean_rows(points, pushes)
    slopes, ρ = np.empty((n, n)), np.empty(n)
    inertia, L_end = lack(body, loads, acting_on(table), q, R, x, now, state.table, ρ)
    set_slopes(body, inertia, L_end, x, now, state.table, slopes)
    by_turn, by_x, levers, W = (
        np.empty((3 * k, 3)),
        np.empty((3 * k, n)),
        np.empty((n, 3 * k)),
        np.zeros((3 * k, 3 * k)),
    )
    for i in range(k):
        b = rotated_back(R, vector(pushes.forces[i], 0))
        for j in range(3):
            _put_column(by_turn, 3 * i, j, h / 2, cross(b, _AXES[j]))  # ∂g/∂ω̂
    slopes[3:, :3] -= np.dot(rows, by_turn)
    yielded = np.dot(C, by_turn) if len(C) else np.zeros((3 * k, 3))
    spun, square = vector(turn, SPUN), 1 + dot(t, t) / 4
    turning = rotated_back(R, vector(turn, TORQUE))
    by_place = np.zeros((3, n))  # R* torque by what moves arms
    along, of_force = np.zeros((3, 3)), np.zeros((3, 3 * k))  # the same by v̂, and by forces
    for i in range(k):
        f, follows, is_couple = vector(pushes.forces[i], 0), pushes.follows[i] != 0.0, pushes.couples[i] >= 0
        outward, u, y, arm = end, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), mean_arm(points, pushes, i, R, end, h)
        for c in range(pushes.weights.shape[1]):
            share, p = pushes.weights[i, c], pushes.nodes[i, c]
            if share != 0.0 and is_couple:
                u = added(u, 1.0, turned_by(turning_at(pushes, i), c, vector(points.inside[p], 0)))
            elif share != 0.0:
                u, y = added(u, share, vector(points.inside[p], 0)), added(y, share, vector(points.start[p], 0))
        if is_couple:
            outward = middle
        elif follows:
            outward, arm = middle, added(vector(pushes.places[i], 0), -1.0, vector(turn, CENTRE))
        for j in range(3):
            lever = cross(arm, _AXES[j])
            if is_couple:
                moving, lever = added(_column(R, j), h / 2, rotated(R, cross(_AXES[j], u))), _AXES[j]
            elif follows:
                moving = added(cross(_column(R, j), arm), h / 2, rotated(R, cross(_AXES[j], u)))
            else:
                far = added((2 * arm[0], 2 * arm[1], 2 * arm[2]), -1.0, rotated(R, y))
                moving = added((0.0, 0.0, 0.0), 1 / square, cross(_column(middle, j), far))
            inner = (yielded[3 * i, j], yielded[3 * i + 1, j], yielded[3 * i + 2, j])
            _put_column(by_x, 3 * i, j, 1.0, added(moving, 1.0, rotated(outward, inner)))
            _put_column(levers, 0, 3 * i + j, 1.0, rotated_back(middle, lever))
        for j in range(m):
            _put_column(by_x, 3 * i, 3 + j, 1.0, rotated(outward, vector(rows[j], 3 * i)))
            put(levers[3 + j], 3 * i, rotated(middle, vector(rows[j], 3 * i)))
        for j in range(k if len(C) else 0):
            for c in range(3):  # C middleᵀ, row by row, then outward
                put(W[3 * i + c], 3 * j, rotated(middle, vector(C[3 * i + c], 3 * j)))
        for j in range(3 * k if len(C) else 0):
            _put_column(W, 3 * i, j, 1.0, rotated(outward, (W[3 * i, j], W[3 * i + 1, j], W[3 * i + 2, j])))
        if is_couple or f == (0.0, 0.0, 0.0):
            continue
        for j in range(3):
            if follows:
                _add_column(along, j, h / 2, cross(_AXES[j], f))
        for j in range(n if not follows else 0):
            _add_column(by_place, j, h / 2, cross((by_x[3 * i, j], by_x[3 * i + 1, j], by_x[3 * i + 2, j]), f))
        for j in range(3 * k if len(C) and not follows else 0):
            _add_column(of_force, j, h / 2, cross((W[3 * i, j], W[3 * i + 1, j], W[3 * i + 2, j]), f))
    for j in range(n):
        _add_column(slopes, j, -1.0, rotated_back(middle, (by_place[0, j], by_place[1, j], by_place[2, j])))
    for j in range(3):
        _add_column(slopes, j, -h / 2, cross(turning, _AXES[j]))
    for j in range(3 * k):
        by_centre = 0.0 if pushes.couples[j // 3] >= 0 else by_force
        less = added((of_force[0, j], of_force[1, j], of_force[2, j]), -by_centre, _column_of(along, j % 3))
        _add_column(levers, j, 1.0, rotated_back(middle, less))
    keep_inverse(slopes, state)
    W += np.dot(by_x, np.dot(state.slopes, levers))
    for i in range(k):
        for j in range(3):
            moving = _AXES[j]
            if pushes.follows[i]:
                moving = added(moving, -h / 2, cross(spun, moving))
            for of in range(k if pushes.couples[i] < 0 else 0):
                if pushes.couples[of] < 0:
                    _add_rows(W, 3 * i, 3 * of + j, by_force, moving)
    return W


@jit_part
def _mean_rows(points: Points, pushes: Pushes) -> tuple[Array, Array]:
    """Vᵀ of what is pushed, (m, 3k), and its compliance C (3k, 3k), m/s/N, or (0, 0); of couples how surfaces turn."""
    (k, wide), m = pushes.nodes.shape, len(points.rows)
    size = 3 * k if len(points.R) else 0
    rows, C = np.zeros((m, 3 * k)), np.zeros((size, size))
    columns, used = _columns_of(pushes, len(points.rest))
    once, whole = np.zeros((size, 3 * len(used))), points.times[WHOLE]  # Q R, of the nodes that carry what is pushed
    for i in range(k):
        for a in range(wide):
            if pushes.weights[i, a] == 0.0:
                continue
            Q, at = _map_of(pushes, i, a), 3 * pushes.nodes[i, a]
            for j in range(m):
                put(rows[j], 3 * i, added(vector(rows[j], 3 * i), 1.0, rotated(Q, vector(points.rows[j], at))))
            for d in range(3 if size else 0):
                for e in range(3):
                    if Q[d][e] != 0.0:
                        _add_columns(once[3 * i + d], Q[d][e], points.R[points.slots[pushes.nodes[i, a]], e], used)
    for j in range(k if size else 0):
        for b in range(wide):
            if pushes.weights[j, b] == 0.0:
                continue
            T, to = _map_of(pushes, j, b), 3 * columns[pushes.nodes[j, b]]
            for row in range(size):
                put(C[row], 3 * j, added(vector(C[row], 3 * j), 1 / whole, rotated(T, vector(once[row], to))))
    return rows, C


@jit_part
def _columns_of(pushes: Pushes, count: int) -> tuple[Array, Array]:
    """Which of so many nodes carry what is pushed, and where each of these is among them, (count,)."""
    columns = np.full(count, -1)
    for i in range(len(pushes.nodes)):
        for a in range(pushes.nodes.shape[1]):
            if pushes.weights[i, a] != 0.0:
                columns[pushes.nodes[i, a]] = 0
    used = np.flatnonzero(columns == 0)
    for u in range(len(used)):
        columns[used[u]] = u
    return columns, used


@jit_part
def _add_columns(to: Array, factor: float, row: Array, used: Array) -> None:
    """Adds what a row has for some nodes."""
    for u in range(len(used)):
        for d in range(3):
            to[3 * u + d] += factor * row[3 * used[u] + d]


@jit_part
def _map_of(pushes: Pushes, i: int, a: int) -> Rotation:
    """By what the a-th node moves what is pushed."""
    share = pushes.weights[i, a]
    if pushes.couples[i] < 0:
        return (share, 0.0, 0.0), (0.0, share, 0.0), (0.0, 0.0, share)
    return map_in(turning_at(pushes, i), a)


@jit_part
def _column(R: Rotation, j: int) -> Vector:
    return R[0][j], R[1][j], R[2][j]


@jit_part
def _column_of(A: Array, j: int) -> Vector:
    return A[0, j], A[1, j], A[2, j]


@jit_part
def _put_column(A: Array, row: int, j: int, factor: float, a: Vector) -> None:
    A[row, j], A[row + 1, j], A[row + 2, j] = factor * a[0], factor * a[1], factor * a[2]


@jit_part
def _add_rows(A: Array, row: int, j: int, factor: float, a: Vector) -> None:
    for k in range(3):
        A[row + k, j] += factor * a[k]


@jit_part
def _add_column(A: Array, j: int, factor: float, a: Vector) -> None:
    _add_rows(A, 0, j, factor, a)
