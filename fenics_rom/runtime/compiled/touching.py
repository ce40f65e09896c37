"""Where a body can be touched, compiled: what its points do, and the forces there.

A `Touched` body is one that has these parts, as `linear_step.Body` has them.
"""

import math
from typing import NamedTuple, Protocol

from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_sums
from fenics_rom.mechanics.compiled.contact_law import FOUND, Found, Law, Pairs, ask
from fenics_rom.mechanics.compiled.copying import add_row, add_rows, copy, fill, largest_of
from fenics_rom.mechanics.compiled.coulomb import add_motion
from fenics_rom.mechanics.compiled.obstacle_motion import Beside, Moving, look, row_of, turn
from fenics_rom.mechanics.compiled.shapes import distance
from fenics_rom.mechanics.compiled.springs import ask_springs
from fenics_rom.mechanics.compiled.work_space import rows_of, take, take_rows
from fenics_rom.runtime.compiled.yielding import Yielding

DIAGONAL = 3**0.5  # the longest vector in space whose components are 1 at most
FORGOTTEN, NEGLIGIBLE = 1e-200, 1e-30  # J, and of the energy of the basis: see `steppers.residual_motion`
FEW_POINTS = 4  # part of all, up to which they are placed one by one
NO_LAW = Law(1.0, 0.0, 0.0, 0.0, 0.0, False, 0, math.inf)  # of bodies that nothing can touch
LOST = 3  # status of a step whose state would not be finite; see `contact_law`


class Touched(Yielding, Protocol):
    """A body with m modes and P contact points."""

    @property
    def points(self) -> Array:
        """Sᵀ (m, 3P)."""

    @property
    def places(self) -> Array:
        """Of the points at rest, (P, 3), m."""


class Begun(NamedTuple):
    """What a step begins with of the past."""

    forces: Array  # of the step before (N, 3), N
    swung: Array  # (N,) in how many steps in a row friction did not stop a pair


class Clearance(NamedTuple):
    """How far a body is from obstacles."""

    gap: Array  # of all points from them, at least (1,), m; 0 where it is not known
    untouched: Array  # (1,) in how many steps in a row nothing has touched it, at least,
    still: Array  # and in how many nothing has been carried beyond the basis
    stretch: Array  # (m,) the largest displacement of a point by each coordinate
    gone: Array  # how far points and obstacles can have gone since all pairs were measured (1,), m
    # (N,) how far pairs were apart when they were measured last, and what was `gone` then, added up, m; (0,): all are
    # measured in every look.
    pairs: Array


class StepContact(NamedTuple):
    """What a step found of contact."""

    pairs: Pairs
    gaps: Array  # (N,), m
    motion: Array  # (4, 3P): displacement, velocity, free mid-step velocity of the points, and that beyond the basis
    forces: Array  # (3P,), N


class Last(NamedTuple):
    """What the last of steps in a row began with of contact, and found."""

    begun: Begun
    found: StepContact


@jit_part
def look_around(
    body: Touched,
    shapes: Array,
    moving: Moving,
    h: float,
    beside: Beside,
    q: Array,
    beyond: Array,
    found: StepContact,
    space: Array,
) -> None:
    """Sets displacements of the points, their gaps and normals.

    Args:
        body: with points.
        shapes, moving: of the obstacles, as in `linear_step.step_in`.
        h: of the step, s.
        beside: of `begin_beside`; set, where an obstacle turns.
        q: (m,).
        beyond: g, y and their rates, (4, 3P).
        found: as above.
        space: with room for 3P numbers.
    """
    places = take_rows(space, len(body.places), 3)
    place_points(body, q, beyond, found.motion[0], places)
    look(shapes, moving, h, places, found.gaps, found.pairs.axes[:, 0], beside)


@jit_part
def place_points(body: Touched, q: Array, beyond: Array, moved: Array, places: Array) -> None:
    """Sets displacements (3P,) of the points, and where they are, (P, 3), m."""
    fill(moved, 0.0)
    add_rows(body.points, q, 0, len(moved), moved)
    if len(body.R) > 0:
        add_row(beyond[1], 1.0, moved)
    for p in range(len(places)):
        for k in range(3):
            places[p, k] = body.places[p, k] + moved[3 * p + k]


@jit_part
def look_near(
    body: Touched,
    shapes: Array,
    moving: Moving,
    h: float,
    beside: Beside,
    q: Array,
    beyond: Array,
    clearance: Clearance,
    farthest: float,
    found: StepContact,
    space: Array,
) -> None:
    """The same of pairs that may be nearer than some gap, m; gaps of others are set to what they are at least.

    Arguments as of `look_around`; the clearance is changed. Where it keeps nothing of pairs, or obstacles turn,
    all are measured.
    """
    P, gone, kept, gaps = len(body.places), clearance.gone, clearance.pairs, found.gaps
    places, moved, axes = take_rows(space, P, 3), found.motion[0], found.pairs.axes
    keeps, start = len(kept) > 0, moving.start
    is_known = keeps and clearance.gap[0] != 0.0 and not turn(moving)
    for c in range(len(gaps) if is_known else 0):
        gaps[c] = kept[c] - gone[0]
    are_few = is_known and FEW_POINTS * _count_near(gaps, farthest) <= P
    if not are_few:
        place_points(body, q, beyond, moved, places)
    if turn(moving):
        look(shapes, moving, h, places, gaps, axes[:, 0], beside)
        return
    if not is_known:
        gone[0] = 0.0
    for o in range(len(shapes)):
        for p in range(P):
            c = o * P + p
            if is_known and gaps[c] > farthest:
                continue
            if are_few:
                _place_point(body, p, q, beyond, moved, places[p])
            x, y, z = places[p, 0] - start[o, 0], places[p, 1] - start[o, 1], places[p, 2] - start[o, 2]
            gaps[c] = distance(shapes[o], x, y, z, axes[c, 0])
            if keeps:
                kept[c] = gaps[c] + gone[0]


@jit_part
def _place_point(body: Touched, p: int, q: Array, beyond: Array, moved: Array, place: Array) -> None:
    """`place_points` of one of them, to the bit."""
    for k in range(3):
        moved[3 * p + k] = 0.0
    add_rows(body.points, q, 3 * p, 3 * p + 3, moved)
    for k in range(3):
        if len(body.R) > 0:
            moved[3 * p + k] += beyond[1, 3 * p + k]
        place[k] = body.places[p, k] + moved[3 * p + k]


@jit_part
def ask_points(
    body: Touched,
    law: Law,
    beside: Beside,
    before: Array,
    r: Array,
    v: Array,
    beyond: Array,
    pull: Array,
    found: StepContact,
    farthest: float,
    space: Array,
) -> None:
    """Sets what the law asks of every pair in a step of h s, and velocities of the points; they have looked around.

    Args:
        body, law: of it.
        beside: how obstacles move.
        before: forces of the step before (N, 3), N.
        r, v: rates at its start, and v̂ without contact, (m,).
        beyond: g, y and their rates, (4, 3P).
        pull: what branches of the material add to g and y in the step, (2, 3P); (0, 3P) where there are none.
        found: set but for forces.
        farthest: as of `contact_law.ask`.
        space: not used up.
    """
    velocity, free, P = found.motion[1], found.motion[2], len(body.places)
    if FEW_POINTS * _count_near(found.gaps, farthest) > P:
        move_points(body, r, v, beyond, pull, velocity, free)
    else:
        for c in range(len(found.gaps)):
            if found.gaps[c] <= farthest:
                at = 3 * (c % P)
                for k in range(at, at + 3):
                    velocity[k] = free[k] = 0.0
                add_rows(body.points, r, at, at + 3, velocity)
                add_rows(body.points, v, at, at + 3, free)
                _add_beyond(body, beyond, pull, at, at + 3, velocity, free)
    of_points = rows_of(free, 3), rows_of(velocity, 3)
    ask(law, found.gaps, *of_points, beside, before, take(space, 0), found.pairs, farthest)
    ask_springs(law, found.gaps, farthest, found.pairs)


@jit_part
def move_points(body: Touched, r: Array, v: Array, beyond: Array, pull: Array, velocity: Array, free: Array) -> None:
    """Sets velocities (3P,) of the points at the start of a step and in its middle; arguments as of `ask_points`."""
    fill(velocity, 0.0)
    fill(free, 0.0)
    add_rows(body.points, r, 0, len(velocity), velocity)
    add_rows(body.points, v, 0, len(free), free)
    _add_beyond(body, beyond, pull, 0, len(free), velocity, free)


@jit_part
def _add_beyond(body: Touched, beyond: Array, pull: Array, first: int, end: int, velocity: Array, free: Array) -> None:
    """Adds to some velocities at the start and in the middle of a step what points do beyond the basis."""
    for k in range(first, end if len(body.R) > 0 else first):
        y, rate = beyond[1, k], beyond[3, k]
        velocity[k] += rate
        free[k] += (body.inertia * rate - y - (pull[1, k] if len(pull) > 0 else 0.0)) / body.whole


@jit_part
def _count_near(gaps: Array, farthest: float) -> int:
    """How many of the gaps are no larger than some."""
    near = 0
    for c in range(len(gaps)):
        near += gaps[c] <= farthest
    return near


@jit_sums
def _speed_of(clearance: Clearance, v: Array) -> float:
    """Of all points at most, by rates (m,) of the coordinates, m/s."""
    speed = 0.0
    for i in range(len(v)):
        speed += clearance.stretch[i] * abs(v[i])
    return speed


@jit_part
def reach_of(
    clearance: Clearance,
    inertia: float,
    whole: float,
    h: float,
    r: Array,
    v: Array,
    beyond: Array,
    pull: Array,
    beside: Beside,
) -> float:
    """The gap, m, beyond which no pair takes part in a step of h s for sure, if contact forces do not move its point.

    A pair takes part below -g/h or (-g/h + a/2)/2, the larger one; where all velocities are within s and g >= 2.5 h s
    both are below -s.

    Args:
        clearance: when it begins.
        inertia, whole: as of `Yielding`.
        h: s.
        r, v: rates at its start, and v̂ without contact, (m,).
        beyond, pull: as in `ask_points`.
        beside: how obstacles move.
    """
    speed = max(_speed_of(clearance, r), _speed_of(clearance, v))
    if beyond.size > 0 and clearance.still[0] == 0:
        y, rate = largest_of(beyond[1]), largest_of(beyond[3])
        y += largest_of(pull[1]) if len(pull) > 0 else 0.0
        speed += DIAGONAL * max(rate, (inertia * rate + y) / whole)
    obstacles = DIAGONAL * max(largest_of(beside.w), largest_of(beside.before))
    return 2.5 * h * (speed + 2 * obstacles)


@jit_part
def are_all_asked(farthest: float, found: StepContact) -> bool:
    """Whether no pair was farther apart than the gap beyond which none was asked."""
    return _count_near(found.gaps, farthest) == len(found.gaps)


@jit_part
def fastest_of(W: Array, forces: Array, space: Array) -> float:
    """How fast forces on the points (3P,) move one at most, m/s, by W (3P, 3P); takes 3P numbers of the space."""
    moved = take(space, len(W))
    fill(moved, 0.0)
    for p in range(len(W) // 3):
        x, y, z = forces[3 * p], forces[3 * p + 1], forces[3 * p + 2]
        if x != 0.0 or y != 0.0 or z != 0.0:
            add_motion(W, p, x, y, z, moved)
    return DIAGONAL * largest_of(moved)


@jit_part
def are_left_out(fastest: float, h: float, reach: float, farthest: float, found: StepContact) -> bool:
    """Whether pairs that nobody asked, as they are farther apart, take no part under the forces of the others, either.

    Args:
        fastest: how fast these move a point at most, m/s.
        h: s.
        reach: of `reach_of`.
        farthest: gap beyond which pairs were not asked.
        found: with gaps.
    """
    nearest = math.inf
    for c in range(len(found.gaps)):
        if found.gaps[c] > farthest:
            nearest = min(nearest, found.gaps[c])
    return nearest > reach + 2.5 * h * fastest


@jit_part
def forget_pairs(pairs: Pairs) -> None:
    """No pair takes part, at no velocity."""
    for c in range(len(pairs.chosen)):
        pairs.chosen[c] = pairs.helped[c] = False
    fill(pairs.level, -math.inf)


@jit_part
def go_on(clearance: Clearance, h: float, v: Array, beyond: Array, w: Array) -> None:
    """Has the clearance be that after a step of h s.

    Args:
        clearance: when it began; changed.
        h: s.
        v: v̂ (m,).
        beyond: velocities of the points beyond the basis (3P,), m/s.
        w: those of the obstacles (O, 3).
    """
    if clearance.gap[0] > 0 or len(clearance.pairs) > 0:
        speed = _speed_of(clearance, v) + DIAGONAL * (largest_of(beyond) + largest_of(w))
        clearance.gap[0] -= h * speed
        clearance.gone[0] += h * speed


@jit_part
def is_settled(steps: Array) -> bool:
    """Whether something has gone on for so many steps (1,) that it is the same in what was before the last one, too."""
    return steps[0] >= 2


@jit_part
def add_up_forces(contact: Found, w: Array, found: StepContact) -> float:
    """Sets the forces on the points; their power on obstacles that move with w, as of `Beside`, W."""
    forces, pairs, power = found.forces, found.pairs, 0.0
    for k in range(len(forces)):
        forces[k] = 0.0
    if contact.status == FOUND:
        P = len(forces) // 3
        for o in range(len(pairs.forces) // P):
            for p in range(P):
                c = o * P + p
                if pairs.chosen[c]:  # others have none
                    for k in range(3):
                        forces[3 * p + k] += pairs.forces[c, k]
                        power += pairs.forces[c, k] * w[row_of(w, c, len(pairs.forces), P), k]
    return power


@jit_part
def keep_found(begun: Begun, tried: StepContact, last_begun: Begun, last: StepContact) -> None:
    """Copies what a step began with, and found."""
    copy(begun.forces, last_begun.forces)
    copy(begun.swung, last_begun.swung)
    pairs, kept = tried.pairs, last.pairs
    copy(pairs.axes, kept.axes)
    copy(pairs.free, kept.free)
    copy(pairs.relative, kept.relative)
    copy(pairs.target, kept.target)
    copy(pairs.level, kept.level)
    copy(pairs.chosen, kept.chosen)
    copy(pairs.helped, kept.helped)
    copy(pairs.forces, kept.forces)
    copy(tried.gaps, last.gaps)
    copy(tried.motion, last.motion)
    copy(tried.forces, last.forces)


@jit_part
def hand_on(law: Law, begun: Begun, touches: bool, pairs: Pairs, after: Begun) -> None:
    """Sets what the step after one begins with, that began so and found these pairs; it may be the same arrays."""
    for c in range(len(begun.swung)):
        after.swung[c] = min(begun.swung[c], law.swings) + 1 if pairs.helped[c] else 0
    copy(pairs.forces if touches else begun.forces, after.forces)
