"""How all bodies move under forces that are tried, and pairs with them: `contact_step._attempt`."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.mechanics.frame_motion import Vector
from fenics_rom.runtime.compiled.contact_points import Points, arm_of
from fenics_rom.runtime.compiled.frames import added, cross, dot, put, rotated, vector
from fenics_rom.world.compiled.bodies import velocity_of_driven, velocity_of_driven_at
from fenics_rom.world.compiled.couples import are_couples, couple_of, pushed_by, turned_by, turning_of
from fenics_rom.world.compiled.free_bodies import try_free
from fenics_rom.world.compiled.operators import pushes_on
from fenics_rom.world.compiled.pulled_bodies import pull_soft
from fenics_rom.world.compiled.rigid_bodies import Pushed, attempt
from fenics_rom.world.compiled.row_tables import rows_at
from fenics_rom.world.compiled.soft_bodies import (
    CENTRE,
    END,
    MIDDLE,
    POWER,
    SPUN,
    START,
    is_pulled,
    moving_of,
    points_at,
    rows_in,
    step_at,
    try_soft,
    turn_at,
    velocity_at,
)
from fenics_rom.world.compiled.tables import (
    DRIVEN,
    FREE,
    SLIDES,
    SPIN,
    bodies_at,
    driven_at,
    freedoms_at,
    is_followed,
    is_soft,
    joined_at,
    near_at,
    rigid_at,
    softs_at,
)

NONE = (0.0, 0.0, 0.0)


@jit_part
def try_forces(world: Array, C: int, h: float, f: Array, free: bool) -> float:
    """Sets velocities of C contacts and all joints under forces (n, 3); the fastest of a body, m/s.

    It is no number where no step is found.
    """
    fastest = try_others(world, C, h, f, free)
    return max(fastest, try_rigid(world, C, h, f)) if np.isfinite(fastest) else fastest


@jit_part
def try_others(world: Array, C: int, h: float, f: Array, free: bool) -> float:
    """The same of bodies that are soft or driven alone."""
    bodies, near, fastest = bodies_at(world), near_at(world), 0.0
    fill(near.u[: len(f)], 0.0)
    for b in range(len(bodies.kinds)):  # free ones say where their points are, which others go by
        if is_soft(bodies.kinds[b]):
            moving = _try_free_body(world, h, b, f) if bodies.kinds[b] == FREE else _try_soft_body(world, h, b, f)
            fastest = max(fastest, moving) if np.isfinite(moving) else moving
    return max(fastest, _look_at_driven(world, C, len(f))) if np.isfinite(fastest) else fastest


@jit_part
def try_rigid(world: Array, C: int, h: float, f: Array) -> float:
    """Adds what rigid bodies do under forces (n, 3); the fastest, m/s, no number without a step."""
    near, rigid, freedoms, n = near_at(world), rigid_at(world), freedoms_at(world), len(f)
    if not len(rigid.mass):
        return 0.0
    are, rows = are_couples(near, np.arange(n)), rows_at(world)
    slides = rows.slides + C
    pushed = Pushed(C, near.rigid[:n], near.places[:n], near.arms[:n], freedoms.inverse, are, slides, rows.turns)
    fastest = attempt(rigid, h, pushed, f, freedoms.tries, near.u[:n])
    return max(fastest, _look_at_rails(world, slides)) if np.isfinite(fastest) else fastest


@jit_part
def _look_at_rails(world: Array, slides: Array) -> float:
    """Adds what bodies that are driven do where others slide on them; the fastest, m/s."""
    bodies, near, fastest = bodies_at(world), near_at(world), 0.0
    for c in slides:
        body = near.ends[c, 0]
        if bodies.kinds[body] == DRIVEN:
            v = velocity_of_driven(driven_at(world), bodies.numbers[body], vector(near.places[c], 0))
            put(near.u[c], 0, added(vector(near.u[c], 0), 1.0, v))
            fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]))
    return fastest


@jit_part
def _look_at_driven(world: Array, C: int, n: int) -> float:
    """Adds what bodies that are driven do at C contacts and joints, n in all; the fastest, m/s."""
    bodies, near, driven, fastest = bodies_at(world), near_at(world), driven_at(world), 0.0
    for c in range(n):
        for side in range(2):
            body = near.ends[c, side]
            is_rail = side == 0 and near.features[c] == SLIDES and c >= C  # which is looked at as what slides is tried
            if bodies.kinds[body] == DRIVEN and not is_rail:
                d, place = bodies.numbers[body], vector(near.places[c], 0)
                if couple_of(near.meetings, near.features, c) >= 0:
                    v = vector(driven.step[d], SPIN)
                elif c < C:
                    v = velocity_of_driven(driven, d, place)
                else:
                    v = velocity_of_driven_at(driven, d, vector(near.arms[c, side], 0))
                put(near.u[c], 0, added(vector(near.u[c], 0), 1.0 - 2 * side, v))
                fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]))
    return fastest


@jit_part
def _spread(world: Array, b: int, f: Array, is_free: bool) -> None:
    """Sets the forces on the points of a soft body, but for couples on a free one, whose frame sees them turn."""
    near, points = near_at(world), points_at(softs_at(world)[bodies_at(world).numbers[b]])
    fill(points.forces, 0.0)
    for c in range(len(f)):
        pushed = vector(f[c], 0)
        if pushed == NONE:
            continue
        for side in range(2):
            if near.ends[c, side] == b and couple_of(near.meetings, near.features, c) < 0:
                for k in range(near.weights.shape[2]):
                    share = (1.0 - 2 * side) * near.weights[c, side, k]
                    if share != 0.0:
                        to = points.forces[near.nodes[c, side, k]]
                        put(to, 0, added(vector(to, 0), share, pushed))
        if near.ends[c, 0] == b and couple_of(near.meetings, near.features, c) >= 0 and not is_free:
            _push_surface(world, b, c, f)


@jit_apart
def _push_surface(world: Array, b: int, c: int, f: Array) -> None:
    """Adds the forces of a couple to the points of a soft body."""
    near, joined, points = near_at(world), joined_at(world), points_at(softs_at(world)[bodies_at(world).numbers[b]])
    of = turning_of(near, c, joined.arms_of_turning[near.features[c]])
    for k in range(len(of.nodes)):
        to = points.forces[of.nodes[k]]
        put(to, 0, added(vector(to, 0), 1.0, pushed_by(of, k, vector(f[c], 0))))


@jit_apart
def _try_soft_body(world: Array, h: float, b: int, f: Array) -> float:
    """The same of a soft body that is not free."""
    near, table, fastest = near_at(world), softs_at(world)[bodies_at(world).numbers[b]], 0.0
    _spread(world, b, f, False)
    try_soft(table)
    goes = is_pulled(table)  # with what is tried, so that places go along
    if goes and not pull_soft(table, h):
        return np.nan
    points, turn, ends = points_at(table), turn_at(table), near.ends
    moving, start, inside, places = moving_of(turn, h), points.start, points.inside, step_at(table).places
    for c in range(len(f)):
        for side in range(2):
            if ends[c, side] == b:
                if couple_of(near.meetings, near.features, c) >= 0:
                    fastest = max(fastest, _turn_surface(world, h, b, c))
                    continue
                v, sign, nodes, weights = NONE, 1.0 - 2 * side, near.nodes[c, side], near.weights[c, side]
                place = NONE
                for k in range(near.weights.shape[2]):
                    share, p = weights[k], nodes[k]
                    if share != 0.0:
                        v = added(v, share, velocity_at(moving, vector(start[p], 0), vector(inside[p], 0)))
                        place = added(place, share if goes else 0.0, vector(places[p], 0))
                if goes:
                    put(near.places[c], 0, added(place, h / 2, v))
                put(near.u[c], 0, added(vector(near.u[c], 0), sign, v))
                fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]))
    return fastest


@jit_apart
def _try_free_body(world: Array, h: float, b: int, f: Array) -> float:
    """The same of a free one."""
    bodies, near, table = bodies_at(world), near_at(world), softs_at(world)[bodies_at(world).numbers[b]]
    points, turn, fastest, power = points_at(table), turn_at(table), 0.0, 0.0
    _spread(world, b, f, True)
    points.pushed[:] = 0.0
    pushes = pushes_on(world, np.arange(len(f)), f, b)
    for i in range(len(pushes.nodes)):
        for k in range(pushes.weights.shape[1]):
            is_pushed = pushes.weights[i, k] != 0.0 and vector(pushes.forces[i], 0) != (0.0, 0.0, 0.0)
            if is_pushed:
                points.pushed[pushes.nodes[i, k]] = 1.0
    if not try_free(table, h, pushes):
        return np.nan
    moving, start, inside, ends = moving_of(turn, h), points.start, points.inside, near.ends
    for c in range(len(f)):
        for side in range(2):
            if ends[c, side] == b:
                v, sign, arm, nodes, weights = NONE, 1.0 - 2 * side, NONE, near.nodes[c, side], near.weights[c, side]
                for k in range(near.weights.shape[2] if couple_of(near.meetings, near.features, c) < 0 else 0):
                    share, p = weights[k], nodes[k]
                    if share != 0.0:
                        v = added(v, share, velocity_at(moving, vector(start[p], 0), vector(inside[p], 0)))
                        arm = added(arm, share, arm_of(points, p, rows_in(turn, START), rows_in(turn, END), h))
                place = added(vector(turn, CENTRE), 1.0, arm)
                if couple_of(near.meetings, near.features, c) >= 0:
                    inward = _turning_inside(world, c, points)
                    v = added(vector(turn, SPUN), 1.0, rotated(rows_in(turn, MIDDLE), inward))
                elif is_followed(bodies, near, c, side):
                    v = added(v, 1.0, cross(vector(turn, SPUN), added(vector(near.places[c], 0), -1.0, place)))
                else:
                    put(near.places[c], 0, place)
                power += sign * dot(vector(f[c], 0), v)
                put(near.u[c], 0, added(vector(near.u[c], 0), sign, v))
                fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]))
    turn[POWER] = power
    return fastest


@jit_apart
def _turn_surface(world: Array, h: float, b: int, c: int) -> float:
    """Adds how the surface of a soft body turns that a couple holds, rad/s; the largest of the three."""
    near, table, turning = near_at(world), softs_at(world)[bodies_at(world).numbers[b]], NONE
    points, moving = points_at(table), moving_of(turn_at(table), h)
    of = turning_of(near, c, joined_at(world).arms_of_turning[near.features[c]])
    for k in range(len(of.nodes)):
        p = of.nodes[k]
        v = velocity_at(moving, vector(points.start[p], 0), vector(points.inside[p], 0))
        turning = added(turning, 1.0, turned_by(of, k, v))
    put(near.u[c], 0, added(vector(near.u[c], 0), 1.0, turning))
    return max(abs(turning[0]), abs(turning[1]), abs(turning[2]))


@jit_part
def _turning_inside(world: Array, c: int, points: Points) -> Vector:
    """The same within the frame of a free body, in its axes."""
    near, turning = near_at(world), NONE
    of = turning_of(near, c, joined_at(world).arms_of_turning[near.features[c]])
    for k in range(len(of.nodes)):
        turning = added(turning, 1.0, turned_by(of, k, vector(points.inside[of.nodes[k]], 0)))
    return turning
