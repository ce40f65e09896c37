"""The forces of all contacts of a step, in sweeps: `world.contact_step`, of bodies of which all is known as it begins.

What takes part is looked for first: those contacts that would close without forces, or had some in the step before.
The operator of these alone is made. Others are looked at when forces are found, and are among them if they would close.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Law
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill
from fenics_rom.mechanics.compiled.coulomb import add_motion
from fenics_rom.runtime.compiled.frames import dot, vector
from fenics_rom.world import normal_law
from fenics_rom.world.compiled.joints import Held, hold, join, without_contact
from fenics_rom.world.compiled.law_of_pairs import along, largest, pairs_among, set_in_frame
from fenics_rom.world.compiled.operators import Operator, operator_among
from fenics_rom.world.compiled.rigid_bodies import take_back
from fenics_rom.world.compiled.row_forces import find_with_rows
from fenics_rom.world.compiled.row_tables import rows_at
from fenics_rom.world.compiled.tables import HELPED, OF_RESTITUTION, OUT, OWN, SWUNG, joined_at, near_at
from fenics_rom.world.compiled.tries import try_forces, try_others, try_rigid
from fenics_rom.world.tolerances import FEW_SWEEPS, MOST_SWEEPS, ROUND_OFF, SLOW, STAGNATION, TOLERANCE

_normal_law = jit_shared(normal_law.normal_law)
REDUNDANT = 1e-9  # of the largest pivot: what joints hold twice
MOST_ROUNDS = 10  # in which more contacts take part


class Found(NamedTuple):
    """What came of a search."""

    status: int  # FOUND or OTHERWISE
    sweeps: int
    scale: float  # of the velocities, m/s


@jit_part
def find_forces(world: Array, C: int, law: Law, free: bool) -> Found:
    """Forces of the C contacts and all joints of a step, and velocities under them, which bodies have tried last.

    Both are set.

    Args:
        world: whose bodies have begun the step; its pairs have forces to begin with.
        C: how many contacts these are.
        law: h, friction at most, and what swings; nothing else is asked of it.
        free: whether some soft body is, or has strokes or guides that rub, so that W is not all of its answer.
    """
    near, J = near_at(world), len(joined_at(world).ends)
    n, h, none = C + J, law.h, np.zeros((C + J, 3))
    f, u, before = near.forces[:n], near.u[:n], near.before[:n]
    fastest, fixed = 0.0, none
    if not len(rows_at(world).bodies):  # else forces are tried at once
        fastest = try_others(world, C, h, none, free)
        fixed = u.copy()
        fastest = max(fastest, try_rigid(world, C, h, none)) if np.isfinite(fastest) else fastest
        if not np.isfinite(fastest):
            return Found(OTHERWISE, 0, 0.0)
        fastest = max(fastest, largest(u))
    scale = max(fastest, largest(before))
    if J and C:  # who would close is seen where joints hold
        alone, nobody = np.zeros((n, 3)), np.empty(0, dtype=np.int64)
        for j in range(C, n):
            copy(f[j], alone[j])
        asked = np.empty(0), np.empty(0)
        once = 1 + 0 * n  # no constant, of which numba would compile what takes it by itself
        found = _search(world, C, law, asked[0], asked[1], nobody, alone, fixed, scale, once, free)
        if found.status == OTHERWISE:
            return found
    level, target, chosen = _ask(world, C, h)
    sweeps = 0
    for _ in range(MOST_ROUNDS):
        among = _taking_part(chosen, f[:C])
        if len(among) + J == 0:
            return Found(FOUND, 1, scale)
        found = _search(world, C, law, level, target, among, f, fixed, scale, MOST_SWEEPS + 0 * n, free)
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
def _search(
    world: Array,
    C: int,
    law: Law,
    level: Array,
    target: Array,
    among: Array,
    f: Array,
    fixed: Array,
    scale: float,
    most: int,
    free: bool,
) -> Found:
    """As `_find_among`, also where joints are rows."""
    if len(rows_at(world).bodies) == 0:
        return _find_among(world, C, law, level, target, among, f, fixed, scale, most, free)
    told = np.array((scale, 0.0))
    status = find_with_rows(world, C, law, level, target, among, f, free, most, told)
    return Found(status, int(told[1]), told[0])


@jit_part
def _ask(world: Array, C: int, h: float) -> tuple[Array, Array, Array]:
    """Levels and targets of the contacts, (C,), m/s, and which would be beyond these without forces."""
    near = near_at(world)
    approach, leaving, none = np.empty(C), np.empty(C), np.zeros(C)
    for c in range(C):
        n = vector(near.normals[c], 0)
        approach[c], leaving[c] = dot(n, vector(near.before[c], 0)), dot(n, vector(near.u[c], 0))
        near.numbers[c, HELPED] = near.numbers[c, OWN] = 0.0
    given = near.numbers[:C, OF_RESTITUTION], near.are_rigid[:C] != 0
    out = near.numbers[:C, OUT]
    level, target = _normal_law(h, near.gaps[:C], approach, leaving, given[0], given[1], none > 0, out)
    return level, target, leaving < level


@jit_part
def _taking_part(chosen: Array, f: Array) -> Array:
    """Those that are chosen, or have a force."""
    takes = chosen.copy()
    for c in range(len(f)):
        takes[c] = takes[c] or f[c, 0] != 0.0 or f[c, 1] != 0.0 or f[c, 2] != 0.0
    return takes.nonzero()[0]


@jit_part
def _find_among(
    world: Array,
    C: int,
    law: Law,
    level: Array,
    target: Array,
    among: Array,
    f: Array,
    fixed: Array,
    scale: float,
    most: int,
    free: bool,
) -> Found:
    """Forces where no other contacts take part than some (K,); others are as in `find_forces` and `_ask`.

    Args:
        f: of all pairs, (n, 3), N: those that the search begins with, of contacts that take no part none. Set.
        fixed: velocities of soft and driven bodies without forces, (n, 3), m/s. Where no soft body is free they answer
            forces by W exactly, and rigid ones alone try those that the search begins with.
        scale: of velocities, m/s.
        most: sweeps; after the last one forces may be what came.
    """
    near, h, K, J = near_at(world), law.h, len(among), len(f) - C
    rows, pairs = np.concatenate((among, np.arange(C, C + J))), pairs_among(world, among, level, target)
    if not free:
        copy(fixed, near.u[: len(f)])
        fastest = try_rigid(world, C, h, f)
    else:
        fastest = try_forces(world, C, h, f, free) if f.any() else 0.0
    known, swung = near.u[rows], np.empty(K, dtype=np.int64)
    tried, without, moved = f[rows], known.copy(), np.empty((K + J, 3))
    forces, by_joints, without_joints = np.empty((K + J, 3)), np.empty((J, 3)), np.empty((K + J, 3))
    size_before = 0.0
    if not np.isfinite(fastest):
        return Found(OTHERWISE, 0, scale)
    operator = operator_among(world, h, rows, K, free)
    Wᵀ, held = operator.Wᵀ, _hold(operator, K, J)
    if not free:
        take_back(operator.maps, operator.answers, K, tried, without)
        for i in range(K):
            for k in range(3):
                without[i, k] -= operator.slack[i] * tried[i, k]
    else:
        _move(Wᵀ, -tried, without)
    for i in range(K):
        swung[i] = int(near.numbers[among[i], SWUNG])
        near.numbers[among[i], OWN] = along(Wᵀ, i, pairs.axes[i, 0])
    for sweep in range(1, most + 1):
        scale = max(scale, fastest, largest(without))
        copy(without, without_joints)
        if J:
            without_contact(held, Wᵀ, without_joints, by_joints)
        if not np.isfinite(largest(without_joints)):
            break
        if K:
            for i in range(K):
                set_in_frame(pairs.axes[i], without_joints[i], pairs.free[i])
                pairs.chosen[i] = pairs.chosen[i] or pairs.free[i, 0] < pairs.level[i]
            of_contacts = held.contactsᵀ if J else Wᵀ
            status = contact_law.find_forces(law, of_contacts, operator.inverse, K, swung, pairs).status
            if status == OTHERWISE:
                break
            if status == NOTHING:
                fill(pairs.forces, 0.0)
            for i in range(K):
                near.numbers[among[i], HELPED] = 1.0 if pairs.helped[i] else 0.0
                copy(pairs.forces[i], forces[i])
        if J:
            join(held, pairs.forces, by_joints, forces[K:])
        size, are_tried = 0.0, free or sweep > 1
        if are_tried:
            size = _changed(Wᵀ, forces, tried, moved)
            if not np.isfinite(size):
                break
            stays = K == 0 and size <= STAGNATION * scale and size > size_before / 4 > 0
            if size <= ROUND_OFF * scale or stays:
                return Found(FOUND, sweep, scale)  # those that were tried
            add_row(flat(known), 1.0, flat(moved))  # as is expected
        else:
            copy(without, moved)
            _move(Wᵀ, forces, moved)
        for i in range(K + J):
            copy(forces[i], f[rows[i]])
        fastest = try_forces(world, C, h, f, free)
        known = near.u[rows]
        for i in range(K + J):
            for k in range(3):
                moved[i, k] = known[i, k] - moved[i, k]  # as was not
        missed = largest(moved)
        if not (np.isfinite(fastest) and np.isfinite(missed)):
            break
        if size * size < TOLERANCE * scale * size_before or missed <= ROUND_OFF * scale or sweep == most:
            return Found(FOUND, sweep, scale)
        add_row(flat(moved), 1.0, flat(without))
        if not are_tried:
            size = _changed(Wᵀ, forces, tried, moved)
        copy(forces, tried)
        if size > SLOW * size_before > 0:  # what bodies answer has changed since then
            if J == 0 and not free:
                break
            if sweep >= FEW_SWEEPS:
                operator = operator_among(world, h, rows, K, free)
                Wᵀ, held = operator.Wᵀ, _hold(operator, K, J)
                copy(known, without)
                _move(Wᵀ, -tried, without)
        size_before = size
    return Found(OTHERWISE, 0, scale)


@jit_part
def _hold(operator: Operator, C: int, J: int) -> Held:
    """What J points of joints make of C contacts; nothing where there are none."""
    return hold(operator.Wᵀ, C, REDUNDANT) if J else hold(np.empty((0, 0)), J, REDUNDANT)


@jit_part
def _changed(Wᵀ: Array, f: Array, before: Array, moved: Array) -> float:
    """By how much velocities change with forces (K, 3), at most, m/s; moved: by how much each does, set."""
    fill(moved, 0.0)
    _move(Wᵀ, f - before, moved)
    return largest(moved)


@jit_part
def _move(Wᵀ: Array, f: Array, u: Array) -> None:
    """Adds W f to velocities u (C, 3)."""
    whole = flat(u)
    for c in range(len(f)):
        if f[c, 0] != 0.0 or f[c, 1] != 0.0 or f[c, 2] != 0.0:
            add_motion(Wᵀ, c, f[c, 0], f[c, 1], f[c, 2], whole)
