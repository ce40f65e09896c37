"""What touches a held body that deforms largely, and what is found of cables, in a step whose velocity follows forces.

Where nothing can touch the body `among` is None, and numba makes the same functions without contact; where no stroke is
given `pull` is.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.actuator_forces import begin_search, hold, look
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Found, find_forces
from fenics_rom.mechanics.compiled.contact_law import Law as ContactLaw
from fenics_rom.mechanics.compiled.copying import add_row, add_rows, copy
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Beside, Moving
from fenics_rom.mechanics.compiled.searched_forces import ARE_FOUND, GOES_ON, search_in
from fenics_rom.mechanics.compiled.springs import held_by
from fenics_rom.mechanics.compiled.work_space import work_space
from fenics_rom.runtime.compiled.carried_strains import Law
from fenics_rom.runtime.compiled.following import Following
from fenics_rom.runtime.compiled.held_back import hold_back
from fenics_rom.runtime.compiled.held_own import Own, find_own
from fenics_rom.runtime.compiled.sampled_points import Sampled
from fenics_rom.runtime.compiled.small_matrices import dot, solve, solve_rows, squares
from fenics_rom.runtime.compiled.strokes import Pull
from fenics_rom.runtime.compiled.touching import Begun, StepContact, add_up_forces, ask_points, look_around


class Body(NamedTuple):
    """What is held, with m modes and p inputs."""

    ω: Array  # (m,), 1/s
    inverse_ω: Array  # (m,), s
    dead: Array  # forces of inputs whose direction stays (m, p)
    loads: Following
    law: Law
    sampled: Sampled | None  # of Newton's steps, where `law` has what is not of points; None: strains are carried


class Motion(NamedTuple):
    """What a step sets beside what is strained, (m,) each but the last."""

    e: Array  # at its end
    r: Array
    q: Array  # at its start
    residual: Array  # forces out of balance there at v̂ of the step before
    whole: Array  # v̂ that these lead to, before it is made no longer than what was trained
    force: Array  # of inputs
    velocity: Array  # v̂
    pushed: Array  # generalized forces of contact
    factor: Array  # of the step's matrix (m, m)


@jit_part
def motion_in(vectors: Array, factor: Array) -> Motion:
    """As parts of few arrays, (8, m) and (m, m)."""
    first, second = (vectors[0], vectors[1], vectors[2], vectors[3]), (vectors[4], vectors[5], vectors[6], vectors[7])
    return Motion(*first, *second, factor)


class Touch(NamedTuple):
    """Where a body can be touched; see `touching.Touched`."""

    points: Array  # (m, 3P)
    places: Array  # (P, 3)
    R: Array  # (3P, 3P) or (0, 0)
    inertia: float
    whole: float
    lost: float
    τ: float


class Among(NamedTuple):
    """The obstacles that a body is among in a step, and what it finds of them."""

    touch: Touch
    law: ContactLaw
    shapes: Array  # of the obstacles, (O, 17)
    moving: Moving  # how they move
    begun: Begun
    beyond: Array  # g, y and their rates, (4, 3P), changed
    beyond_before: Array  # the same before the step
    relaxed: Array  # branches of a material that relaxes, beyond the basis (N, 2, 3P), changed
    relaxed_before: Array
    pull: Array  # by which these pull there, of `step_beyond` (2, 3P); (0, 3P): the material does not relax
    found: StepContact  # with forces to begin with; set
    spread: Array  # for roots of W (m, 3P),
    W: Array  # and W, m/s/N (3P, 3P)
    own: Own | None  # of a body that touches itself, and no obstacles: its pairs are those of its points


@jit_part
def among_in(among: Among, moving: Moving) -> Among:
    """The same obstacles, which move so."""
    touch, law, shapes, _, begun, beyond, beyond_before, relaxed, relaxed_before, pull, found, spread, W, own = among
    branches = relaxed, relaxed_before, pull
    return Among(touch, law, shapes, moving, begun, beyond, beyond_before, *branches, found, spread, W, own)


NOT_FOUND = Found(OTHERWISE, 0, 0.0)


@jit_part
def find_touching(
    h: float, u: Array, r: Array, motion: Motion, among: Among | None, beside: Beside | None, pull: Pull | None
) -> Found:
    """Finds forces of contact and cables at v̂ of the motion, and has v̂ follow them; sets what contact does (m,).

    Cables hold their strokes under contact forces, too, or are slack, and rub under the tensions in u (p,).
    """
    v = motion.velocity
    if pull is not None:
        return _find_all(h, u, r, motion, among, beside, pull)
    if among is None or beside is None:
        return Found(NOTHING, 0, 0.0)
    contact = _find_alone(among.own, r, motion, among, beside)
    if contact.status == OTHERWISE:
        return NOT_FOUND
    _answer(motion, v)
    return contact


@jit_part
def _find_alone(own: Own | None, r: Array, motion: Motion, among: Among, beside: Beside) -> Found:
    """Finds contact forces where nothing pulls."""
    if own is None:
        return _find_contact(r, motion, among, beside, among.W, True)
    of_step = among.begun, motion.q, r, motion.velocity, motion.factor, among.beyond, among.pull
    return find_own(own, among.touch, among.law, *of_step, among.found, motion.pushed)


@jit_part
def _answer(motion: Motion, v: Array) -> None:
    """Adds to v̂ (m,) what contact does."""
    answer = motion.pushed.copy()
    solve(motion.factor, answer)
    for i in range(len(v)):
        v[i] += answer[i]


@jit_part
def _find_all(
    h: float, u: Array, r: Array, motion: Motion, among: Among | None, beside: Beside | None, pull: Pull
) -> Found:
    """The same where something pulls."""
    given, n, v = pull.actuators, len(pull.forces), motion.velocity
    search, free, contact, outcome = search_in(pull.search, n), v.copy(), Found(NOTHING, 0, 0.0), GOES_ON
    for k in range(n):
        search.targets[k], search.rates[k] = pull.targets[k], dot(pull.lines[k], free)
    copy(pull.strokes_before, search.strokes)
    if not begin_search(given, pull.bends, pull.W, u, pull.found, h, search):
        return NOT_FOUND
    if among is not None:
        held, X = np.empty_like(among.W), np.zeros((n, len(among.W)))
        for k in range(n):
            add_rows(among.touch.points, pull.spread[k], 0, len(among.W), X[k])
        set_delassus(among.touch, motion.factor, among.spread, among.W)
    while outcome == GOES_ON:
        if among is not None and beside is not None:
            if not (hold(search) and hold_back(among.W, X, search.W, search.holds, held)):
                return NOT_FOUND
            _move(pull, search.z, free, v)
            contact = _find_contact(r, motion, among, beside, held, False)
            if contact.status == OTHERWISE:
                return NOT_FOUND
            for k in range(n):
                search.added[k] = dot(pull.spread[k], motion.pushed)
        outcome = look(given, pull.bends, u, among is not None, search)
    if outcome != ARE_FOUND:
        return NOT_FOUND
    copy(search.z, pull.found)
    _move(pull, search.z, free, v)
    if among is not None:
        copy(held, among.W)  # with which contact was found
        _answer(motion, v)
    return contact


@jit_part
def _move(pull: Pull, z: Array, free: Array, v: Array) -> None:
    """Sets v̂ under forces z (n,)."""
    copy(free, v)
    for k in range(len(z)):
        add_row(pull.spread[k], z[k], v)


@jit_part
def _find_contact(r: Array, motion: Motion, among: Among, beside: Beside, W: Array, is_free: bool) -> Found:
    """Finds contact forces at v̂ of the motion, and sets what they do (m,).

    W (3P, 3P) is that of the points, which is set where they are free.
    """
    touch, found = among.touch, among.found
    space = work_space(3 * len(touch.places))
    look_around(touch, among.shapes, among.moving, among.law.h, beside, motion.q, among.beyond, found, space)
    given = beside, among.begun.forces, r, motion.velocity, among.beyond, among.pull
    ask_points(touch, among.law, *given, found, math.inf, space)
    if is_free and found.pairs.chosen.any():
        set_delassus(touch, motion.factor, among.spread, W)
    unknown, P = in_one_piece(np.empty((0, 0))), len(touch.places)
    contact = find_forces(among.law, W, unknown, P, among.begun.swung, found.pairs)
    contact = held_by(among.law, found.gaps, found.pairs, contact)
    add_up_forces(contact, beside.w, found)
    for i in range(len(motion.pushed)):
        motion.pushed[i] = dot(touch.points[i], found.forces) if contact.status == FOUND else 0.0
    return contact


@jit_part
def set_delassus(touch: Touch, factor: Array, spread: Array, W: Array) -> None:
    """Sets W = S A⁻¹ Sᵀ + R/a by the factor of A."""
    copy(touch.points, spread)
    solve_rows(factor, spread)
    squares(spread, W)
    if len(touch.R) > 0:
        for i in range(len(W)):
            for j in range(len(W)):
                W[i, j] += touch.R[i, j] / touch.whole
