"""Strokes that are given, and tendons that rub at guides, of a linear body in a step, compiled.

Their columns B stay, and so do W = Bᵀ A⁻¹ B and what they do to contact points, X = S A⁻¹ B.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.compiled.actuator_forces import begin_search, hold, look
from fenics_rom.mechanics.compiled.contact_law import OTHERWISE, Law, find_forces
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside
from fenics_rom.mechanics.compiled.searched_forces import ARE_FOUND, GOES_ON, Actuators, search_in
from fenics_rom.mechanics.compiled.work_space import release, taken
from fenics_rom.runtime.compiled.held_back import hold_back
from fenics_rom.runtime.compiled.small_matrices import dot
from fenics_rom.runtime.compiled.touching import Begun, StepContact, Touched, add_up_forces, ask_points


class Pulled(NamedTuple):
    """Of n forces that are found, with m modes and P contact points."""

    actuators: Actuators
    lines: Array  # Bᵀ (n, m)
    spread: Array  # Bᵀ A⁻¹ (n, m)
    W: Array  # (n, n)
    X: Array  # Xᵀ (n, 3P)


class Answering(Touched, Protocol):
    """A body whose points answer forces."""

    @property
    def W(self) -> Array:
        """The Delassus operator (3P, 3P), m/s/N."""


@jit_apart
def set_strokes(pulled: Pulled, e: Array, rigid: Array, inverse_ω: Array, strokes: Array) -> None:
    """Sets strokes (n,) where √γ q is e (m,), or displacements along rigid motions are."""
    for k in range(len(strokes)):
        line, strokes[k] = pulled.lines[k], 0.0
        for i in range(len(e)):
            strokes[k] += line[i] * (rigid[i] if i < len(rigid) else e[i] * inverse_ω[i])


@jit_apart
def set_given(pulled: Pulled, u: Array, given: Array) -> None:
    """Sets what acts of an input u (p,): strokes and what is found do not."""
    copy(u, given)
    for k in range(len(pulled.lines)):
        given[pulled.actuators.columns[k]] = 0.0


@jit_apart
def pull_alone(
    pulled: Pulled,
    h: float,
    u: Array,
    q: Array,
    r: Array,
    free: Array,
    before: Array,
    numbers: Array,
    z: Array,
    v: Array,
) -> bool:
    """Sets forces z (n,) in a step of h s that nothing touches, and v̂ (m,) under them; whether there are any.

    Args:
        pulled: of it.
        h: s.
        u: the input (p,).
        q, r: at its start, (m,).
        free: v̂ without these forces.
        before: those of the step before (n,).
        numbers: of a `Search`, which is begun.
        z, v: set.
    """
    given, n = pulled.actuators, len(before)
    search, first = search_in(numbers, n), n - len(given.guides)
    for k in range(n):
        line, share = pulled.lines[k], given.share[k]
        search.strokes[k] = dot(line, q)
        missing = 0.0 if k >= first else u[given.columns[k]] - search.strokes[k]
        search.targets[k] = share / h * missing + (1 - share) * dot(line, r)
        search.rates[k] = dot(line, free)
    if not begin_search(given, given.bends, pulled.W, u, before, h, search):
        return False
    outcome = GOES_ON
    while outcome == GOES_ON:
        outcome = look(given, given.bends, u, False, search)
    copy(search.z, z)
    _move(pulled, z, free, v)
    return outcome == ARE_FOUND


@jit_part
def _move(pulled: Pulled, z: Array, free: Array, v: Array) -> None:
    """Sets v̂ under forces z (n,)."""
    copy(free, v)
    for k in range(len(z)):
        add_row(pulled.spread[k], z[k], v)


@jit_apart
def pull_among(
    pulled: Pulled,
    body: Answering,
    law: Law,
    u: Array,
    r: Array,
    free: Array,
    before: Array,
    beside: Beside,
    begun: Begun,
    beyond: Array,
    branches: Array,
    numbers: Array,
    space: Array,
    z: Array,
    v: Array,
    found: StepContact,
    told: Array,
) -> bool:
    """The same with contact, after `pull_alone`; whether forces are found.

    Args:
        pulled, u, r, free, before, numbers, z, v: as there.
        body: with W of the points (3P, 3P) without these forces.
        law, beside, begun, beyond, found, space: as in `touching.ask_points`; branches: as `pull` there.
        told: status, sweeps and power of contact, as of `Found`, and `holding` with which it was found; set.
    """
    given, n, P = pulled.actuators, len(before), len(body.places)
    search, W, unknown = search_in(numbers, n), np.empty_like(body.W), in_one_piece(np.empty((0, 0)))
    begin_search(given, given.bends, pulled.W, u, before, law.h, search)
    begin = taken(space)
    while True:
        if not (hold(search) and hold_back(body.W, pulled.X, search.W, search.holds, W)):
            return False
        _move(pulled, search.z, free, v)
        release(space, begin)
        ask_points(body, law, beside, begun.forces, r, v, beyond, branches, found, math.inf, space)
        contact = find_forces(law, W, unknown, P, begun.swung, found.pairs)
        if contact.status == OTHERWISE:
            return False
        told[0], told[1], told[2], told[3] = contact.status, contact.sweeps, contact.normal_power, 0.0
        for k in range(n):
            told[3] += 2.0**k * search.holds[k]
        add_up_forces(contact, beside.w, found)
        for k in range(n):
            search.added[k] = dot(pulled.X[k], found.forces)
        outcome = look(given, given.bends, u, True, search)
        if outcome != GOES_ON:
            copy(search.z, z)
            return outcome == ARE_FOUND


@jit_apart
def end_pull(pulled: Pulled, z: Array, pushed: Array, right: Array, rubbed: Array) -> None:
    """Adds forces z (n,) to those of inputs, and of all; sets those of guides, (m,) each."""
    first = len(z) - len(pulled.actuators.guides)
    fill(rubbed, 0.0)
    for k in range(len(z)):
        add_row(pulled.lines[k], z[k], right)
        add_row(pulled.lines[k], z[k], rubbed if k >= first else pushed)
