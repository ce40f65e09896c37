"""What soft bodies of a world that are not free do between two steps, where impulses stop joints."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.carried_step import ANGULAR_MOMENTUM, MOMENTUM, OF_BASE, SPIN, move_with
from fenics_rom.runtime.compiled.frame_tables import body_at, state_at
from fenics_rom.runtime.compiled.frames import (
    DRIFT,
    MOVED,
    TURNING,
    VELOCITY,
    State,
    added,
    cross,
    dot,
    put,
    rotated,
    rotated_back,
    rotation_in,
    rotation_of,
    shape_at,
    vector,
)
from fenics_rom.world.compiled.soft_bodies import SQUARE, WITHIN, points_at, step_at


@jit_part
def velocities_between(table: Array, p: int) -> Vector:
    """Of a point between two steps within the basis, in world axes, m/s: beyond it there is next to no mass."""
    body, state, points = body_at(table), state_at(table), points_at(table)
    now, e, r = state.now[0], state.halves[0], state.halves[1]
    y, û = vector(points.rest[p], 0), (0.0, 0.0, 0.0)
    for i in range(len(r)):
        row = vector(points.rows[i], 3 * p)
        y, û = added(y, e[i] * body.inverse_ω[i], row), added(û, r[i], row)
    if len(points.R):
        y = added(y, 1.0, vector(points.beyond[1], 3 * p))
    R = rotation_of(*rotation_in(now))
    moving = added(vector(now, VELOCITY), 1.0, cross(vector(now, TURNING), rotated(R, y)))
    return added(moving, 1.0, rotated(R, û))


@jit_part
def kick_soft(table: Array, impulses: Array) -> float:
    """Adds impulses (P, 3) in world axes on points between two steps; by how much that changes its energy, J.

    The base stays as it moves.
    """
    body, state, points, told = body_at(table), state_at(table), points_at(table), step_at(table).told
    now, e, r, R = state.now[0], state.halves[0], state.halves[1], rotation_of(*rotation_in(state.now[0]))
    inside, before = np.empty(3 * len(impulses)), told[SQUARE]
    for p in range(len(impulses)):
        put(inside, 3 * p, rotated_back(R, vector(impulses[p], 0)))
    square, within = _square_of(state), r.dot(r)
    r += np.dot(points.rows, inside)
    shape_at(body, e * body.inverse_ω, r, state.table, now)
    move_with(body.mass, R, now)
    within = r.dot(r) - within
    told[WITHIN] += within
    told[SQUARE] += _square_of(state) - square + within
    return (told[SQUARE] - before) / 2


@jit_part
def _square_of(state: State) -> float:
    """Twice the kinetic energy of a body but for that of its shape within the frame, J."""
    now = state.now[0]
    v, ω = vector(now, OF_BASE), vector(now, SPIN)
    square = dot(vector(now, MOMENTUM), v) + dot(vector(now, ANGULAR_MOMENTUM), ω)
    return square + dot(vector(now, DRIFT), v) + dot(vector(now, MOVED), ω)
