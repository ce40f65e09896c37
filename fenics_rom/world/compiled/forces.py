"""The forces of all contacts of a step, in sweeps: `world.contact_step`, of bodies of which all is known as it begins.

Those are rigid bodies that move freely or as they are told, and soft ones that answer forces linearly, without joints.
Where sweeps do not end soon, NumPy's take the step from its beginning.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part, jit_shared
from fenics_rom.mechanics.compiled import contact_law
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Law, Pairs
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.coulomb import add_motion, frame_along
from fenics_rom.world import normal_law
from fenics_rom.world.compiled.rigid_bodies import RigidBodies, add_answers, attempt, look_at_answers, set_inverse
from fenics_rom.world.tolerances import MOST_SWEEPS, PROXIMAL, ROUND_OFF, SLOW, TOLERANCE

_normal_law = jit_shared(normal_law.normal_law)


class Contacts(NamedTuple):
    """The C contacts of a step, as in `world.contact_step`."""

    ends: Array  # (C, 2) numbers of their rigid bodies; -1 of others
    places: Array  # (C, 3), m
    before: Array  # u (C, 3) when the step begins, m/s
    normals: Array  # (C, 3)
    gaps: Array  # (C,), m
    restitution: Array  # e (C,)
    are_rigid: Array  # (C,)
    yield_at_once: Array  # (C,)
    out: Array  # (C,), m/s
    yields: Array  # (C,) whether of a point that yields by itself
    swung: Array  # (C,)


@jit
def find_forces(
    law: Law,
    contacts: Contacts,
    bodies: RigidBodies,
    free: Array,
    operator: Array,
    inverse: Array,
    speed: float,
    pairs: Pairs,
    tries: Array,
    u: Array,
) -> tuple[int, int]:
    """Whether forces were found, FOUND or OTHERWISE, and in how many sweeps.

    Args:
        law: h, friction at most, and what swings; nothing else is asked of it.
        contacts: those of the step.
        bodies: rigid ones that move freely.
        free: velocities of contacts (C, 3) by all other bodies without forces, m/s.
        operator: what these answer forces with, (3C, 3C), symmetric, m/s/N.
        inverse: of it; (0, 0) where it is not known.
        speed: of the fastest of them, m/s.
        pairs: with friction, and forces to begin with; set to what was found.
        tries: (B, 4, 3) of `bodies`, set.
        u: (C, 3) velocities, set, m/s.
    """
    h, C, n = law.h, len(free), 3 * len(free)
    f, Wᵀ, size_before, scale = pairs.forces.copy(), np.empty((n, n)), 0.0, max(speed, _largest(contacts.before))
    without, moved, whole = np.empty((C, 3)), np.empty((C, 3)), np.empty(inverse.shape)
    maps, answers = np.empty((len(tries), 6, n)), np.empty((len(tries), 6, 6))
    _move(operator, f, free, 1.0, u)
    fastest = attempt(bodies, h, contacts.ends, contacts.places, f, tries, u)
    for sweep in range(1, MOST_SWEEPS + 1):
        if not np.isfinite(fastest):
            break
        if sweep == 1:
            copy(operator, Wᵀ)
            look_at_answers(bodies, h, contacts.ends, contacts.places, tries, maps, answers)
            add_answers(maps, answers, Wᵀ)
            if len(inverse) > 0 and not set_inverse(inverse, maps, answers, whole):
                break
            _make_regular(Wᵀ, contacts.yields)
        _move(Wᵀ, f, u, -1.0, without)
        scale = max(scale, fastest, _largest(without))
        if sweep == 1:
            _ask(h, contacts, without, pairs)
        for c in range(C):
            _set_in_frame(pairs.axes[c], without[c], pairs.free[c])
            pairs.chosen[c] = pairs.chosen[c] or pairs.free[c, 0] < pairs.level[c]
        status = contact_law.find_forces(law, Wᵀ, whole, C, contacts.swung, pairs).status
        if status == OTHERWISE:
            break
        if status == NOTHING:
            pairs.forces[:] = 0.0
        for c in range(C):
            for k in range(3):
                f[c, k] -= pairs.forces[c, k]
                moved[c, k] = 0.0
        _move(Wᵀ, f, moved, -1.0, moved)
        size = _largest(moved)
        if size <= ROUND_OFF * scale:
            for c in range(C):
                for k in range(3):
                    pairs.forces[c, k] += f[c, k]  # those that were tried
            return FOUND, sweep
        for c in range(C):
            for k in range(3):
                moved[c, k] += u[c, k]  # as is expected
                f[c, k] = pairs.forces[c, k]
        _move(operator, f, free, 1.0, u)
        fastest = attempt(bodies, h, contacts.ends, contacts.places, f, tries, u)
        for c in range(C):
            for k in range(3):
                moved[c, k] -= u[c, k]
        missed = _largest(moved)
        if size * size <= TOLERANCE * scale * size_before or missed <= ROUND_OFF * scale:
            return FOUND, sweep
        if size > SLOW * size_before > 0:
            break
        size_before = size
    return OTHERWISE, 0


@jit_part
def _ask(h: float, contacts: Contacts, free: Array, pairs: Pairs) -> None:
    """Sets what the law says of pairs that would move by free (C, 3) without forces of contact."""
    C = len(free)
    approach, leaving = np.empty(C), np.empty(C)
    for c in range(C):
        axes = pairs.axes[c]
        copy(contacts.normals[c], axes[0])
        frame_along(axes)
        _set_in_frame(axes, contacts.before[c], pairs.relative[c])
        _set_in_frame(axes, free[c], pairs.free[c])
        approach[c], leaving[c] = pairs.relative[c, 0], pairs.free[c, 0]
        pairs.chosen[c] = pairs.helped[c] = False
    given = contacts.restitution, contacts.are_rigid, contacts.yield_at_once, contacts.out
    level, target = _normal_law(h, contacts.gaps, approach, leaving, *given)
    for c in range(C):
        slides = 0.5 if pairs.friction[c] > 0 else 0.0
        pairs.level[c], pairs.target[c, 0] = level[c], target[c]
        pairs.target[c, 1], pairs.target[c, 2] = slides * pairs.relative[c, 1], slides * pairs.relative[c, 2]


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


@jit_part
def _make_regular(W: Array, yields: Array) -> None:
    """Adds a compliance to each pair whose points do not yield by themselves, as a Guide does."""
    own = np.zeros(len(yields))
    for c in range(len(yields)):
        own[c] = (W[3 * c, 3 * c] + W[3 * c + 1, 3 * c + 1] + W[3 * c + 2, 3 * c + 2]) / 3
    least = 1e-12 * own.max()
    for c in range(len(yields)):
        if not yields[c]:
            for k in range(3 * c, 3 * c + 3):
                W[k, k] += PROXIMAL * max(own[c], least)
