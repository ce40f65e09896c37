"""Rigid bodies of a world as they begin a step and end it: `world.rigid` and `world.driven`, in arrays."""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.mechanics import base_fit, frame_motion
from fenics_rom.mechanics.base_fit import NEGLIGIBLE
from fenics_rom.mechanics.base_path import UNIT_TOLERANCE
from fenics_rom.mechanics.frame_motion import LEAST_COSINE, Rotation, Vector
from fenics_rom.mechanics.largest_turn import LARGEST_TURN
from fenics_rom.runtime.compiled.frames import (
    POSITION,
    TURNING,
    VELOCITY,
    added,
    cross,
    dot,
    length,
    mean,
    put,
    rotated,
    rotated_back,
    rotation_in,
    rotation_of,
    turned,
    vector,
)
from fenics_rom.world.compiled.rigid_bodies import RigidBodies, rows_of
from fenics_rom.world.compiled.soft_bodies import put_rows, rows_in
from fenics_rom.world.compiled.tables import (
    ASKEW,
    AWAY,
    DRIVEN,
    IN_MIDDLE,
    MEAN,
    MIDDLE,
    POWER,
    SPIN,
    Driven,
    Freedoms,
    V,
    driven_at,
    rigid_at,
)

_gap = jit_shared(base_fit.gap)
_composed = jit_shared(frame_motion.composed)


@jit_part
def times(R: Rotation, C: Rotation) -> Rotation:
    """R C."""
    a, b, c = R
    return rotated_back(C, a), rotated_back(C, b), rotated_back(C, c)


@jit_part
def middle_of(bodies: RigidBodies, freedoms: Freedoms, h: float, b: int) -> Vector:
    """Where the centre of mass of a body is expected in the middle of a step of h s, m."""
    p, v = vector(bodies.motion[b, 0], 0), vector(bodies.motion[b, 1], 0)
    return added(added(p, h / 2, v), h * h / 4, vector(freedoms.acceleration[b], 0))


@jit_part
def begin_rigid(bodies: RigidBodies, freedoms: Freedoms, h: float, b: int, placed: Array, travel: Array) -> bool:
    """Begins the step of a body; whether it could.

    Sets where its shape is in the middle, (12,), and how far it goes, (4,).
    """
    v, ω = vector(bodies.motion[b, 1], 0), vector(bodies.motion[b, 2], 0)
    speed = length(ω)
    if not h * speed <= LARGEST_TURN:
        return False
    gravity, pulled = vector(freedoms.gravity[b], 0), vector(freedoms.acceleration[b], 0)
    put(bodies.loads[b, 0], 0, added(gravity, 1 / bodies.mass[b], vector(freedoms.given[b, 0], 0)))
    put(bodies.loads[b, 1], 0, vector(freedoms.given[b, 1], 0))
    half = (h / 2 * ω[0], h / 2 * ω[1], h / 2 * ω[2])
    R, off = times(rows_of(bodies.rotation[b]), rotation_of(*turned((1.0, 0.0, 0.0, 0.0), half))), freedoms.off[b]
    put(placed, 0, added(middle_of(bodies, freedoms, h, b), 1.0, rotated(R, vector(off, 0))))
    put_rows(placed, 3, times(R, rows_in(off, 3)))
    put(travel, 0, (h * v[0], h * v[1], h * v[2]))
    travel[3] = h * (speed * freedoms.size[b] + h * (length(gravity) + length(pulled) / 4))
    return True


@jit_part
def begin_driven(bodies: Driven, h: float, d: int, placed: Array, travel: Array) -> bool:
    """The same of a body whose end is set, whose quaternion is made one of unit length."""
    start, end, step = bodies.start[d], bodies.end[d], bodies.step[d]
    size = math.sqrt(end[3] ** 2 + end[4] ** 2 + end[5] ** 2 + end[6] ** 2)
    if not (math.isfinite(end.sum()) and abs(size - 1) <= UNIT_TOLERANCE):
        return False
    for k in range(3, 7):
        end[k] /= size
    w, x, y, z = rotation_in(start)
    cosine, a, b, c = _composed((w, -x, -y, -z), rotation_in(end))
    if not abs(cosine) >= LEAST_COSINE:
        return False
    R = rotation_of(*rotation_in(start))
    spin, in_middle, R_mean = (0.0, 0.0, 0.0), R, R
    if a != 0.0 or b != 0.0 or c != 0.0:
        turn = (2 * a / cosine, 2 * b / cosine, 2 * c / cosine)
        half = (turn[0] / 2, turn[1] / 2, turn[2] / 2)
        in_middle = times(R, rotation_of(*turned((1.0, 0.0, 0.0, 0.0), half)))
        last = rotation_of(*rotation_in(end))
        R_mean = mean(R[0], last[0]), mean(R[1], last[1]), mean(R[2], last[2])
        spin = rotated(R, (turn[0] / h, turn[1] / h, turn[2] / h))
    p, p_end = vector(start, POSITION), vector(end, POSITION)
    way = added(p_end, -1.0, p)
    v̂ = (way[0] / h, way[1] / h, way[2] / h)
    put(step, MIDDLE, mean(p, p_end))
    put_rows(step, IN_MIDDLE, in_middle)
    put_rows(step, MEAN, R_mean)
    put(step, V, v̂)
    put(step, SPIN, spin)
    step[POWER] = 0.0
    put(placed, 0, mean(p, p_end))
    put_rows(placed, 3, in_middle)
    whole, fast = min(bodies.size[d], 1.0), length(spin)
    share = abs(2 * math.atan(length((a, b, c)) / cosine)) / fast if fast > 0 else 0.0
    said = mean(vector(start, VELOCITY), vector(end, VELOCITY))
    about = mean(vector(start, TURNING), vector(end, TURNING))
    step[AWAY] = _gap(way, (h * said[0], h * said[1], h * said[2]), NEGLIGIBLE * whole)
    turned_by = (share * spin[0], share * spin[1], share * spin[2])
    step[ASKEW] = _gap(turned_by, (h * about[0], h * about[1], h * about[2]), NEGLIGIBLE)
    put(travel, 0, way)
    travel[3] = h * fast * (1.0 if math.isinf(bodies.size[d]) else bodies.size[d])
    return True


@jit_part
def start_velocity_of_rigid(bodies: RigidBodies, b: int, place: Vector, middle: Vector) -> Vector:
    """Of a place on a body when the step begins."""
    R = rows_of(bodies.rotation[b])
    spin = rotated(R, vector(bodies.motion[b, 2], 0))
    return added(vector(bodies.motion[b, 1], 0), 1.0, cross(spin, added(place, -1.0, middle)))


@jit_part
def start_velocity_at(world: Array, kind: int, index: int, arm: Array) -> Vector:
    """Between two steps of a point of a rigid or driven body, at an arm (3,) in its axes, m; m/s."""
    if kind == DRIVEN:
        start = driven_at(world).start[index]
        turned_arm = rotated(rotation_of(*rotation_in(start)), vector(arm, 0))
        return added(vector(start, VELOCITY), 1.0, cross(vector(start, TURNING), turned_arm))
    motion, R = rigid_at(world).motion[index], rows_of(rigid_at(world).rotation[index])
    return added(vector(motion[1], 0), 1.0, rotated(R, cross(vector(motion[2], 0), vector(arm, 0))))


@jit_part
def start_turning_of(world: Array, kind: int, index: int) -> Vector:
    """How a rigid or driven body turns between two steps, rad/s."""
    if kind == DRIVEN:
        return vector(driven_at(world).start[index], TURNING)
    return rotated(rows_of(rigid_at(world).rotation[index]), vector(rigid_at(world).motion[index, 2], 0))


@jit_part
def start_velocity_of_driven(bodies: Driven, d: int, place: Vector) -> Vector:
    """The same."""
    start = bodies.start[d]
    arm = added(place, -1.0, vector(bodies.step[d], MIDDLE))
    return added(vector(start, VELOCITY), 1.0, cross(vector(start, TURNING), arm))


@jit_part
def velocity_of_driven(bodies: Driven, d: int, place: Vector) -> Vector:
    """In the middle of the step."""
    step = bodies.step[d]
    return added(vector(step, V), 1.0, cross(vector(step, SPIN), added(place, -1.0, vector(step, MIDDLE))))


@jit_part
def velocity_of_driven_at(bodies: Driven, d: int, arm: Vector) -> Vector:
    """The same at an arm in its axes."""
    step = bodies.step[d]
    R = vector(step, MEAN), vector(step, MEAN + 3), vector(step, MEAN + 6)
    return added(vector(step, V), 1.0, cross(vector(step, SPIN), rotated(R, arm)))


@jit_part
def end_rigid(bodies: RigidBodies, freedoms: Freedoms, h: float, b: int, works: Array) -> None:
    """Takes the step that was tried last; works: by loads and by others, set, J."""
    force, torque = vector(freedoms.tries[b, 0], 0), vector(freedoms.tries[b, 1], 0)
    v̂, ω̂ = vector(freedoms.tries[b, 2], 0), vector(freedoms.tries[b, 3], 0)
    mass, (x, y, z) = bodies.mass[b], vector(freedoms.gravity[b], 0)
    given = added((mass * x, mass * y, mass * z), 1.0, vector(freedoms.given[b, 0], 0))
    loaded = vector(freedoms.given[b, 1], 0)
    R = rows_of(bodies.rotation[b])
    turning = rotated(R, ω̂)
    works[0] = h * (dot(given, v̂) + dot(loaded, turning))
    works[1] = h * (dot(force, v̂) + dot(added(torque, -1.0, loaded), turning))
    whole = added(force, 1.0, given)
    pulled = (whole[0] / mass, whole[1] / mass, whole[2] / mass)
    put(freedoms.acceleration[b], 0, pulled)
    put(bodies.motion[b, 0], 0, added(vector(bodies.motion[b, 0], 0), h, v̂))
    put(bodies.motion[b, 1], 0, added(vector(bodies.motion[b, 1], 0), h, pulled))
    momentum = added(vector(freedoms.momentum[b], 0), h, torque)
    put(freedoms.momentum[b], 0, momentum)
    q = freedoms.quaternion[b]
    w, i, j, k = turned((q[0], q[1], q[2], q[3]), (h * ω̂[0], h * ω̂[1], h * ω̂[2]))
    q[0], q[1], q[2], q[3] = w, i, j, k
    R = rotation_of(w, i, j, k)
    for n in range(3):
        put(bodies.rotation[b, n], 0, R[n])
    put(bodies.motion[b, 2], 0, rotated(rows_of(freedoms.inverse[b]), rotated_back(R, momentum)))


@jit_part
def end_driven(bodies: Driven, d: int) -> None:
    """Takes the step that has begun."""
    for k in range(13):
        bodies.start[d, k] = bodies.end[d, k]
    for k in range(2):
        bodies.misfit[d, k] = max(bodies.misfit[d, k], bodies.step[d, AWAY + k])
