"""The forces of all contacts of a step, in sweeps: `world.contact_step`, of bodies of which all is known as it begins.

What takes part is looked for first: those contacts that would close without forces, or had some in the step before.
The operator of these alone is made. Others are looked at when forces are found, and are among them if they would close.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part, jit_shared
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Law, Pairs
from fenics_rom.mechanics.compiled.coulomb import add_motion, frame_along
from fenics_rom.runtime.compiled.contact_points import arm_of
from fenics_rom.runtime.compiled.frames import added, cross, dot, put, vector
from fenics_rom.world import normal_law
from fenics_rom.world.compiled.bodies import velocity_of_driven
from fenics_rom.world.compiled.free_bodies import try_free
from fenics_rom.world.compiled.operators import inverse_among, pushes_on, set_operator
from fenics_rom.world.compiled.rigid_bodies import attempt
from fenics_rom.world.compiled.soft_bodies import (
    CENTRE,
    END,
    POWER,
    SPUN,
    START,
    points_at,
    rows_in,
    try_soft,
    turn_at,
    velocity_of,
)
from fenics_rom.world.compiled.tables import (
    DRIVEN,
    FREE,
    HELPED,
    OF_FRICTION,
    OF_RESTITUTION,
    SWUNG,
    bodies_at,
    driven_at,
    freedoms_at,
    is_followed,
    is_soft,
    near_at,
    rigid_at,
    softs_at,
)
from fenics_rom.world.tolerances import MOST_SWEEPS, ROUND_OFF, SLOW, TOLERANCE

_normal_law = jit_shared(normal_law.normal_law)
MOST_ROUNDS = 10  # in which more contacts take part


class Found(NamedTuple):
    """What came of a search."""

    status: int  # FOUND or OTHERWISE
    sweeps: int
    scale: float  # of the velocities, m/s


@jit
def find_forces(world: Array, C: int, law: Law, free: int | None) -> Found:
    """Forces of the C contacts of a step, and velocities under them, which bodies have tried last; both are set.

    Args:
        world: whose bodies have begun the step; its contacts have forces to begin with.
        C: how many these are.
        law: h, friction at most, and what swings; nothing else is asked of it.
        free: None where no soft body is free: then nothing of such is compiled.
    """
    near = near_at(world)
    h, f, u, before = law.h, near.forces[:C], near.u[:C], near.before[:C]
    fastest = try_forces(world, C, h, np.zeros((C, 3)), free)
    if not np.isfinite(fastest):
        return Found(OTHERWISE, 0, 0.0)
    scale = max(fastest, _largest(before), _largest(u))
    level, target, chosen = _ask(world, C, h)
    sweeps = 0
    for _ in range(MOST_ROUNDS):
        among = _taking_part(chosen, f)
        if len(among) == 0:
            return Found(FOUND, 1, scale)
        found = _find_among(world, C, law, level, target, among, scale, free)
        sweeps, scale = sweeps + found.sweeps, found.scale
        if found.status == OTHERWISE:
            return found
        is_in, missed = np.zeros(C, dtype=np.bool_), False
        is_in[among] = True
        for c in range(C):
            if not is_in[c] and dot(vector(near.normals[c], 0), vector(u[c], 0)) < level[c]:
                chosen[c] = missed = True
        if not missed:
            return Found(FOUND, sweeps, scale)
    return Found(OTHERWISE, sweeps, scale)


@jit_part
def try_forces(world: Array, C: int, h: float, f: Array, free: int | None) -> float:
    """Sets velocities of the contacts under forces (C, 3); the fastest of a body, m/s, no number without a step."""
    bodies, near, fastest = bodies_at(world), near_at(world), 0.0
    u = near.u[:C]
    u[:] = 0.0
    for b in range(len(bodies.kinds)):  # free ones say where their points are, which others go by
        if is_soft(bodies.kinds[b]):
            moving = _try_soft_body(world, C, h, b, f, free)
            fastest = max(fastest, moving) if np.isfinite(moving) else moving
    fastest = max(fastest, _look_at_driven(world, C)) if np.isfinite(fastest) else fastest
    rigid = rigid_at(world)
    if len(rigid.mass):
        moving = attempt(rigid, h, near.rigid[:C], near.places[:C], f, freedoms_at(world).tries, u)
        fastest = max(fastest, moving) if np.isfinite(moving) else moving
    return fastest


@jit_part
def _look_at_driven(world: Array, C: int) -> float:
    """Adds what bodies that are driven do at the contacts; the fastest, m/s."""
    bodies, near, driven, fastest = bodies_at(world), near_at(world), driven_at(world), 0.0
    for c in range(C):
        for side in range(2):
            body = near.ends[c, side]
            if bodies.kinds[body] == DRIVEN:
                v = velocity_of_driven(driven, bodies.numbers[body], vector(near.places[c], 0))
                put(near.u[c], 0, added(vector(near.u[c], 0), 1.0 - 2 * side, v))
                fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]))
    return fastest


@jit_part
def _try_soft_body(world: Array, C: int, h: float, b: int, f: Array, free: int | None) -> float:
    """The same of a soft body."""
    bodies, near, table = bodies_at(world), near_at(world), softs_at(world)[bodies_at(world).numbers[b]]
    points, turn, fastest, power = points_at(table), turn_at(table), 0.0, 0.0
    points.forces[:] = 0.0
    for c in range(C):
        for side in range(2):
            if near.ends[c, side] == b:
                for k in range(3):
                    share = (1.0 - 2 * side) * near.weights[c, side, k]
                    if share != 0.0:
                        to = points.forces[near.nodes[c, side, k]]
                        put(to, 0, added(vector(to, 0), share, vector(f[c], 0)))
    if free is not None and bodies.kinds[b] == FREE:
        points.pushed[:] = 0.0
        pushes = pushes_on(world, np.arange(C), f, b)
        for i in range(len(pushes.nodes)):
            for k in range(3):
                is_pushed = pushes.weights[i, k] != 0.0 and vector(pushes.forces[i], 0) != (0.0, 0.0, 0.0)
                if is_pushed:
                    points.pushed[pushes.nodes[i, k]] = 1.0
        if not try_free(table, h, pushes):
            return np.nan
    else:
        try_soft(table)
    for c in range(C):
        for side in range(2):
            if near.ends[c, side] == b:
                v, sign, arm = (0.0, 0.0, 0.0), 1.0 - 2 * side, (0.0, 0.0, 0.0)
                for k in range(3):
                    share, p = near.weights[c, side, k], near.nodes[c, side, k]
                    if share != 0.0:
                        v = added(v, share, velocity_of(points, turn, h, p))
                        if free is not None and bodies.kinds[b] == FREE:
                            arm = added(arm, share, arm_of(points, p, rows_in(turn, START), rows_in(turn, END), h))
                if free is not None and bodies.kinds[b] == FREE:
                    place = added(vector(turn, CENTRE), 1.0, arm)
                    if is_followed(bodies, near, c, side):
                        v = added(v, 1.0, cross(vector(turn, SPUN), added(vector(near.places[c], 0), -1.0, place)))
                    else:
                        put(near.places[c], 0, place)
                    power += sign * dot(vector(f[c], 0), v)
                put(near.u[c], 0, added(vector(near.u[c], 0), sign, v))
                fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]))
    if free is not None and bodies.kinds[b] == FREE:
        turn[POWER] = power
    return fastest


@jit_part
def _ask(world: Array, C: int, h: float) -> tuple[Array, Array, Array]:
    """Levels and targets of the contacts, (C,), m/s, and which would be beyond these without forces."""
    near = near_at(world)
    approach, leaving, none = np.empty(C), np.empty(C), np.zeros(C)
    for c in range(C):
        n = vector(near.normals[c], 0)
        approach[c], leaving[c] = dot(n, vector(near.before[c], 0)), dot(n, vector(near.u[c], 0))
    given = near.numbers[:C, OF_RESTITUTION], near.are_rigid[:C] != 0
    level, target = _normal_law(h, near.gaps[:C], approach, leaving, given[0], given[1], none > 0, none)
    return level, target, leaving < level


@jit_part
def _taking_part(chosen: Array, f: Array) -> Array:
    """Those that are chosen, or have a force."""
    takes = chosen.copy()
    for c in range(len(f)):
        takes[c] = takes[c] or f[c, 0] != 0.0 or f[c, 1] != 0.0 or f[c, 2] != 0.0
    return takes.nonzero()[0]


@jit_part
def _pairs_among(world: Array, among: Array, level: Array, target: Array) -> Pairs:
    """What the law asks of some contacts (K,)."""
    near, K = near_at(world), len(among)
    axes, friction = np.empty((K, 3, 3)), np.empty(K)
    free, relative, asked = np.empty((K, 3)), np.empty((K, 3)), np.empty((K, 3))
    none = np.zeros(K, dtype=np.bool_)
    pairs = Pairs(axes, free, relative, asked, level[among], none, none.copy(), friction, near.forces[among])
    for i in range(K):
        c = among[i]
        axes[i, 0], friction[i] = near.normals[c], near.numbers[c, OF_FRICTION]
        frame_along(axes[i])
        _set_in_frame(axes[i], near.before[c], relative[i])
        slides = 0.5 if friction[i] > 0 else 0.0
        asked[i, 0], asked[i, 1], asked[i, 2] = target[c], slides * relative[i, 1], slides * relative[i, 2]
    return pairs


@jit_part
def _find_among(
    world: Array, C: int, law: Law, level: Array, target: Array, among: Array, scale: float, free: int | None
) -> Found:
    """Forces where no other contacts take part than some (K,); others are as in `find_forces` and `_ask`."""
    near, h, K = near_at(world), law.h, len(among)
    f, pairs, size_before = near.forces[:C], _pairs_among(world, among, level, target), 0.0
    fastest = try_forces(world, C, h, f, free) if f.any() else 0.0
    Wᵀ, whole = np.zeros((3 * K, 3 * K)), np.empty((0, 0))
    known, swung = near.u[among], np.empty(K, dtype=np.int64)
    tried, without, moved = f[among], np.empty((K, 3)), np.empty((K, 3))
    for i in range(K):
        swung[i] = int(near.numbers[among[i], SWUNG])
    for sweep in range(1, MOST_SWEEPS + 1):
        if not np.isfinite(fastest):
            break
        if sweep == 1:
            set_operator(world, h, among, Wᵀ, free)
            whole = inverse_among(world)
        _move(Wᵀ, tried, known, -1.0, without)
        scale = max(scale, fastest, _largest(without))
        for i in range(K):
            _set_in_frame(pairs.axes[i], without[i], pairs.free[i])
            pairs.chosen[i] = pairs.chosen[i] or pairs.free[i, 0] < pairs.level[i]
        status = contact_law.find_forces(law, Wᵀ, whole, K, swung, pairs).status
        if status == OTHERWISE:
            break
        if status == NOTHING:
            pairs.forces[:] = 0.0
        for i in range(K):
            near.numbers[among[i], HELPED] = 1.0 if pairs.helped[i] else 0.0
            for k in range(3):
                tried[i, k] -= pairs.forces[i, k]
        moved[:] = 0.0
        _move(Wᵀ, tried, moved, -1.0, moved)
        size = _largest(moved)
        if not np.isfinite(size):
            break
        if size <= ROUND_OFF * scale:
            return Found(FOUND, sweep, scale)  # those that were tried
        for i in range(K):
            for k in range(3):
                moved[i, k] += known[i, k]  # as is expected
                tried[i, k] = f[among[i], k] = pairs.forces[i, k]
        fastest = try_forces(world, C, h, f, free)
        known[:] = near.u[among]
        moved -= known
        missed = _largest(moved)
        if size * size <= TOLERANCE * scale * size_before or missed <= ROUND_OFF * scale:
            return Found(FOUND, sweep, scale)
        if size > SLOW * size_before > 0:
            break
        size_before = size
    return Found(OTHERWISE, 0, scale)


@jit_part
def _set_in_frame(axes: Array, vector: Array, turned: Array) -> None:
    for k in range(3):
        turned[k] = axes[k, 0] * vector[0] + axes[k, 1] * vector[1] + axes[k, 2] * vector[2]


@jit_part
def _move(Wᵀ: Array, f: Array, free: Array, sign: float, u: Array) -> None:
    """Sets u (C, 3) to free ± W f; it may be free itself."""
    C = len(f)
    whole = np.zeros(3 * C)
    for c in range(C):
        if f[c, 0] != 0.0 or f[c, 1] != 0.0 or f[c, 2] != 0.0:
            add_motion(Wᵀ, c, sign * f[c, 0], sign * f[c, 1], sign * f[c, 2], whole)
    for c in range(C):
        for k in range(3):
            u[c, k] = free[c, k] + whole[3 * c + k]


@jit_part
def _largest(values: Array) -> float:
    """Of numbers (C, 3), without their signs; not a number where one is none."""
    largest = 0.0
    for c in range(len(values)):
        for k in range(3):
            if not abs(values[c, k]) <= largest:
                largest = abs(values[c, k])
    return largest
