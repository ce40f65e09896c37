"""Forces of contacts and of rows of joints in a step, in sweeps: `world.contact_step` with a `world.row_guide`."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Law, Pairs
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.world.compiled.law_of_pairs import along as along_normal
from fenics_rom.world.compiled.law_of_pairs import largest, pairs_among, set_in_frame
from fenics_rom.world.compiled.operators import add_free, add_soft
from fenics_rom.world.compiled.row_maps import Maps, along, answer_to, maps_of, move, set_maps
from fenics_rom.world.compiled.row_operators import HeldContacts, factor_rows, hold_contacts, set_rows, solve_all
from fenics_rom.world.compiled.row_tables import FORCE, HELD, KNOWN, TARGET_SPEED, Rows, rows_at
from fenics_rom.world.compiled.rows import look, set_forces, settle, speed_of
from fenics_rom.world.compiled.soft_bodies import has_residual
from fenics_rom.world.compiled.tables import FREE, HELPED, OWN, SOFT, SWUNG, bodies_at, is_soft, near_at, softs_at
from fenics_rom.world.compiled.tries import try_forces
from fenics_rom.world.tolerances import FEW_SWEEPS, PROXIMAL, ROUND_OFF, SLOW, STAGNATION, TOLERANCE

REDUNDANT = 1e-9  # of a row's own compliance: a pivot that is none


@jit_apart
def find_with_rows(
    world: Array,
    C: int,
    law: Law,
    level: Array,
    target: Array,
    among: Array,
    f: Array,
    free: bool,
    most: int,
    told: Array,
) -> int:
    """Forces where no other contacts take part than some (K,): FOUND or OTHERWISE. Arguments as of `find_forces`.

    told: scale of the velocities, m/s, then how many sweeps there were, (2,); the first is set and both may grow.
    """
    near, rows, h, K, n = near_at(world), rows_at(world), law.h, len(among), len(among) + len(f) - C
    those, pairs = np.concatenate((among, np.arange(C, len(f)))), pairs_among(world, among, level, target)
    fastest = try_forces(world, C, h, f, free)
    turned, size_before, changes = look(world, h, False), 0.0, 0
    if not np.isfinite(fastest):
        return OTHERWISE
    maps, swung = _maps_with_soft(world, C, h, those, K), np.empty(K, dtype=np.int64)
    for i in range(K):
        swung[i] = int(near.numbers[among[i], SWUNG])
    R = rows.numbers.shape[1]
    contacts = HeldContacts(np.empty((3 * K, R)), np.empty((3 * K, R)), np.empty((3 * K, 3 * K)))
    tried, forces, moved, known, without = f[those], np.empty((n, 3)), np.empty((n, 3)), near.u[those], np.empty((n, 3))
    for sweep in range(1, most + 1):
        set_maps(world, h, those, K, tried, maps)
        _set_slack(world, among, maps)
        set_rows(world, maps, K)
        copy(known, without)
        move(maps, -tried, without)
        told[0] = max(told[0], fastest, largest(without))
        changes = _ask(world, law, rows, maps, contacts, without, pairs, swung, forces, changes)
        if changes < 0:
            return OTHERWISE
        for i in range(K):
            near.numbers[among[i], HELPED] = 1.0 if pairs.helped[i] else 0.0
            near.numbers[among[i], OWN] = along_normal(contacts.contactsᵀ, i, pairs.axes[i, 0])
        fill(moved, 0.0)
        move(maps, forces - tried, moved)
        size, scale = largest(moved), told[0]
        told[1] += 1
        if not np.isfinite(size):
            return OTHERWISE
        stays = size <= STAGNATION * scale and size > size_before / 4 > 0
        if (size <= ROUND_OFF * scale and turned <= ROUND_OFF) or stays:
            return FOUND  # those that were tried
        add_row(known.reshape(3 * n), 1.0, moved.reshape(3 * n))  # as is expected
        copy(known, moved)
        for i in range(n):
            copy(forces[i], f[those[i]])
        copy(forces, tried)
        fastest = try_forces(world, C, h, f, free)
        turned, known = look(world, h, False), near.u[those]
        if not np.isfinite(fastest):
            return OTHERWISE
        missed = largest(known - moved)
        is_little = size * size < TOLERANCE * scale * size_before or missed <= ROUND_OFF * scale
        if (is_little and turned <= ROUND_OFF) or sweep == most:
            return FOUND
        if free and sweep >= FEW_SWEEPS and size > SLOW * size_before:
            maps = _maps_with_soft(world, C, h, those, K)
        size_before = size
    return OTHERWISE


@jit_part
def _ask(
    world: Array,
    law: Law,
    rows: Rows,
    maps: Maps,
    contacts: HeldContacts,
    without: Array,
    pairs: Pairs,
    swung: Array,
    forces: Array,
    changes: int,
) -> int:
    """Sets forces (n, 3) of pairs that move by (n, 3) without.

    How often drives have changed pieces of their laws so far; -1: too often, or no forces of contact were found.
    """
    K, n, R = len(contacts.contactsᵀ) // 3, len(without), rows.numbers.shape[1]
    numbers, z, z_alone, u = rows.numbers, np.empty(R), np.empty(R), np.empty((n, 3))
    while True:
        factor_rows(world, maps, K, REDUNDANT)
        copy(without, u)
        fill(forces, 0.0)
        if _add_known(rows, forces[K:]):
            move(maps, forces, u)
        for row in range(R):
            is_held = numbers[HELD, row] != 0.0
            z[row] = numbers[TARGET_SPEED, row] - speed_of(rows, row, u[K:]) if is_held else numbers[KNOWN, row]
        solve_all(world, z)
        if K:
            hold_contacts(world, maps, K, contacts)
            copy(z, z_alone)
            _move_contacts(rows, contacts, z, u)
            for i in range(K):
                set_in_frame(pairs.axes[i], u[i], pairs.free[i])
                pairs.chosen[i] = pairs.chosen[i] or pairs.free[i, 0] < pairs.level[i]
            nothing = in_one_piece(np.empty((0, 0)))
            status = contact_law.find_forces(law, contacts.contactsᵀ, nothing, K, swung, pairs).status
            if status == OTHERWISE:
                return -1
            if status == NOTHING:
                fill(pairs.forces, 0.0)
            for i in range(K):
                for k in range(3):
                    add_row(contacts.spreadᵀ[3 * i + k], -pairs.forces[i, k], z)
        set_forces(rows, z, forces[K:])
        for i in range(K):
            copy(pairs.forces[i], forces[i])
        copy(without, u)
        move(maps, forces, u)
        now = settle(world, u[K:], z, changes)
        if now < 0 or not np.isfinite(largest(u)):
            return -1
        if now == changes:
            copy(z, numbers[FORCE])
            return changes
        changes = now


@jit_part
def _add_known(rows: Rows, forces: Array) -> bool:
    """Sets forces (J, 3) of rows that are known; whether there are any."""
    some = False
    for q in range(len(rows.driven)):
        row = rows.driven[q]
        if rows.numbers[HELD, row] == 0.0 and rows.numbers[KNOWN, row] != 0.0:
            some = True
            for e in range(rows.begins[row], rows.begins[row + 1]):
                for k in range(3):
                    forces[rows.pairs[e], k] += rows.numbers[KNOWN, row] * rows.D[e, k]
    return some


@jit_part
def _move_contacts(rows: Rows, contacts: HeldContacts, z: Array, u: Array) -> None:
    """Adds what contacts move by with forces of rows that are held to u (n, 3)."""
    for c in range(len(contacts.contactsᵀ)):
        for row in range(len(z)):
            if rows.numbers[HELD, row] != 0.0:
                u[c // 3, c % 3] += contacts.across[c, row] * z[row]


@jit_part
def _maps_with_soft(world: Array, C: int, h: float, those: Array, K: int) -> Maps:
    """Room for maps, with Wᵀ of soft bodies under the forces of now."""
    bodies, near, count = bodies_at(world), near_at(world), 0
    at, soft = np.full(len(those), -1), np.empty(len(those), dtype=np.int64)
    for i in range(len(those)):
        c = those[i]
        if is_soft(bodies.kinds[near.ends[c, 0]]) or is_soft(bodies.kinds[near.ends[c, 1]]):
            at[i], soft[count] = count, c
            count += 1
    Wᵀ, yields = np.zeros((3 * count, 3 * count)), np.zeros(count, dtype=np.bool_)
    for b in range(len(bodies.kinds)):
        if bodies.kinds[b] == SOFT:
            add_soft(world, h, soft[:count], b, Wᵀ, yields)
        elif bodies.kinds[b] == FREE:
            add_free(world, h, soft[:count], b, Wᵀ, yields)
    return maps_of(world, K, at, Wᵀ)


@jit_part
def _set_slack(world: Array, among: Array, maps: Maps) -> None:
    """Sets a compliance that is added where points do not yield by themselves, as a Guide does."""
    bodies, near, softs, K = bodies_at(world), near_at(world), softs_at(world), len(among)
    own, twist, most = np.zeros(K), np.empty(6), 0.0
    for i in range(K):
        for k in range(3):
            for side in range(2):
                b = maps.rigid[i, side]
                if b >= 0:
                    answer_to(maps.answers[b], maps.forced[i, side, k], 0, twist)
                    own[i] += along(maps.motion[i, side, k], 0, twist) / 3
            if maps.at[i] >= 0:
                own[i] += maps.softᵀ[3 * maps.at[i] + k, 3 * maps.at[i] + k] / 3
        most = max(most, own[i])
    for i in range(K):
        yields = False
        for side in range(2):
            body = near.ends[among[i], side]
            if is_soft(bodies.kinds[body]) and has_residual(softs[bodies.numbers[body]]):
                yields = True
        maps.slack[i] = 0.0 if yields else PROXIMAL * max(own[i], 1e-12 * most)
