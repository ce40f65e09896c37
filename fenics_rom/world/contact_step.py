"""The forces of all contacts and joints of a step, found in sweeps until nothing changes.

Pair r has the relative velocity u_r = ŝ_first - ŝ_second and the force f_r on the first body. A contact obeys the law
of `mechanics.contact_solver`, with the gap and normal of the step: n·u >= c with a force that presses, Coulomb's cone,
and a joint has u = 0. At forces f, a sweep tries the bodies, which move by u(f), asks the law for the forces f' of
bodies that would move by u(f) + W (f' - f), and goes on with these, until that is how they move. Then laws and balances
hold, whatever W is: the sum of the bodies' Delassus operators, and a little more, so that it is regular. It is kept
from step to step as long as it is nearly right, and with it the law as it was linearised.

What rests does so on one another, at any step, as in `mechanics.contact_solver`; of two rigid bodies with e = 1, too.
Rigid bodies that rest in one another, as they turned far in a step, are let out, with c = (a + out)/2 > 0, in two
steps: see `StepPairs.let_out`.
"""

from dataclasses import dataclass
from functools import partial
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.braking import WORK_ROUND_OFF, Braking
from fenics_rom.mechanics.complementarity.solution import LARGEST_RESIDUAL, NEGLIGIBLE_RESIDUAL, largest
from fenics_rom.world.bodies import Part
from fenics_rom.world.guide import Guide
from fenics_rom.world.joint_rows import JointRows
from fenics_rom.world.normal_law import normal_law
from fenics_rom.world.row_guide import RowGuide
from fenics_rom.world.tolerances import FEW_SWEEPS, MOST_SWEEPS, PROXIMAL, ROUND_OFF, SLOW, STAGNATION, TOLERANCE

PATIENCE = 150  # sweeps, after which forces may stay that lack no more than what any contact forces may lack
LARGEST_PROXIMAL = 1e-2  # of each pair's own compliance: `PROXIMAL`, at most
STEADIER = 30.0  # times as much, where sweeps lead away: it only guides them
STEADY = 1e-5  # of what a sweep changes: by so much two of them differ that change the same
SHARES = (1 - 1e-6, 1 - 1e-4, 0.99, 0.9, 0.5, 0.0)  # of forces of contact that would do work
MOST_ROUNDS = 3  # in which what sticks is asked for something else, of which the law is kept as it was linearised
_ONES = np.ones(3)  # to sum components by a product: a third of the time


class Pairs(NamedTuple):
    """The pairs of a step: C contacts, then J points of joints."""

    parts: tuple[Part, ...]  # soft bodies before rigid ones
    places: Array  # (C + J, 3) in the middle of the step, m
    before: Array  # u (C + J, 3) when the step begins, m/s
    normals: Array  # (C, 3) from the second to the first
    gaps: Array  # (C,) when the step begins, m
    friction: Array  # μ (C,)
    restitution: Array  # e (C,)
    are_rigid: Array  # (C,) whether of two rigid bodies
    yield_at_once: Array  # (C,) whether of a body without inertia
    are_static: Array  # (C,) whether of bodies without inertia, or that are driven: gaps may close within the step
    out: Array  # (C,) speeds that those are to have at the end that are let out of one another, m/s; else 0
    halves: Array  # (C, 1): 1/2 where there is friction, else 0
    swung: Array | None = None  # (C,) in how many steps in a row friction did not stop them; None: in none
    rows: JointRows | None = None  # of joints, where they are not all points alone


class Found(NamedTuple):
    """Forces of a step, and what they lead to."""

    forces: Array  # (C + J, 3) on the first bodies, N
    velocities: Array  # u (C + J, 3), m/s
    sweeps: int
    residual: float  # of the velocities, which the last sweep still changed
    swung: Array | None = None  # (C,) in how many steps in a row friction did not stop contacts; None: in none


@dataclass
class _Asked:
    """What a step asks of the C contacts. Who takes part, or may not be stopped, stays so, or sweeps never end."""

    level: Array  # (C,) speed along normals that is to be reached, m/s
    target: Array  # (C, 3) that is bounced to
    sliding: Array  # (C, 3): c_t of what sticks, before anything is decided
    braking: Braking  # of it
    chosen: Array  # (C,) who takes part
    rounds: int = 0  # how often that was asked for something else, as far as it matters


def find_forces(pairs: Pairs, h: float, start: Array, guide: Guide | None) -> tuple[Found, Guide]:
    """Forces of the pairs in a step of h s that the bodies have begun; they have tried them last.

    Args:
        pairs: of the step.
        h: s.
        start: forces (C + J, 3), N, to begin with.
        guide: of earlier steps with the same pairs, if there is one.

    Raises:
        StepError: no forces were found.
    """
    C, n = len(pairs.normals), pairs.normals
    before, f = pairs.before, start
    a = (n * before[:C]).dot(_ONES)
    sliding = (before[:C] - a[:, None] * n) * pairs.halves  # what sticks is to stop within the step
    asked = _Asked(np.empty(0), np.empty(0), sliding, Braking(sliding.T.copy(), pairs.swung), np.zeros(C, dtype=bool))
    size_before, proximal, scale = 0.0, PROXIMAL, float(np.abs(before).max(initial=0.0))
    u, fastest = _attempt(pairs, f)
    turned = _turn(pairs, guide)
    for sweep in range(1, MOST_SWEEPS + 1):
        if guide is None or not guide.is_right:
            guide = _guide(pairs, guide, proximal)
        scale = max(scale, fastest)
        free = u - guide.W.dot(f.ravel()).reshape(-1, 3)
        scale = max(scale, float(np.abs(free).max(initial=0.0)))
        if sweep == 1:
            _, leaving = guide.without_contact(free)
            given = pairs.restitution, pairs.are_rigid, pairs.yield_at_once, pairs.out
            asked.level, target = normal_law(h, pairs.gaps, a, (n * leaving).dot(_ONES), *given)
            if pairs.are_static.any():
                closing = np.minimum(pairs.gaps / -h, 0.0)
                asked.level, target = (np.where(pairs.are_static, closing, each) for each in (asked.level, target))
            asked.target = target[:, None] * n
        found = _law(pairs, guide, free, f, asked)
        moved = guide.W.dot((found - f).ravel()).reshape(-1, 3)
        size = float(np.abs(moved).max(initial=0.0))
        if not np.isfinite(size):
            raise StepError("forces of contact overflow; a smaller dt may help")
        if size <= ROUND_OFF * scale and turned <= ROUND_OFF:
            return Found(f, u, sweep, 0.0, asked.braking.swung), guide
        expected, (u_found, fastest) = u + moved, _attempt(pairs, found)
        missed, turned = float(np.abs(u_found - expected).max(initial=0.0)), _turn(pairs, guide)
        if turned <= ROUND_OFF and (size * size <= TOLERANCE * scale * size_before or missed <= ROUND_OFF * scale):
            return Found(found, u_found, sweep, 0.0, asked.braking.swung), guide  # the next sweep would change nothing
        # Where size stays the same, only forces change that move nothing: the law has no solution that is more exact.
        stays = abs(size - size_before) <= STEADY * size
        if size <= NEGLIGIBLE_RESIDUAL * scale:
            stays = stays or size > size_before / 4 > 0
        if size <= LARGEST_RESIDUAL * scale and (stays or sweep >= PATIENCE):
            u, _ = _attempt(pairs, f)
            if not pairs.out.any():  # of which it is looked at what work is done
                f, u = _passive(pairs, f, u, scale)
            return Found(f, u, sweep, size / scale * (size > STAGNATION * scale), asked.braking.swung), guide
        if size > size_before > 0 and proximal < LARGEST_PROXIMAL and not guide.yields.all():
            proximal *= STEADIER
            guide.is_right = False
        elif sweep >= FEW_SWEEPS and size > SLOW * size_before:
            guide.is_right = False  # what bodies answer has changed since then, as where a cable has become slack
        f, u, size_before = found, u_found, size
    raise StepError(
        f"contact of {C} pairs of points: after {MOST_SWEEPS} sweeps forces still change by {size / scale:.1e} of the "
        "velocities; a smaller dt, or masses that differ less, are the cure"
    )


def _attempt(pairs: Pairs, forces: Array) -> tuple[Array, float]:
    """Velocities u (C + J, 3) under forces, and the fastest of a body, m/s."""
    u, fastest = np.zeros(forces.shape), 0.0
    for body, _, rows, signs, _, points in pairs.parts:
        places = pairs.places[rows]
        velocities = body.attempt(points, places, signs * forces[rows])
        if type(rows) is not slice:  # else that was a view
            pairs.places[rows] = places
        u[rows] += signs * velocities
        if len(velocities):
            fastest = max(fastest, largest(np.abs(velocities)))
    return u, fastest


def _turn(pairs: Pairs, guide: Guide | None) -> float:
    """Has joints go on with the directions of the last try, which have changed by so much."""
    if pairs.rows is None:
        return 0.0
    turned = pairs.rows.look()
    if isinstance(guide, RowGuide) and guide.is_right:
        guide.turn()
    return turned


def _guide(pairs: Pairs, known: Guide | None, proximal: float) -> Guide:
    """W of the pairs; known: of an earlier step with the same pairs; proximal: as of a Guide."""
    C = len(pairs.normals)
    parts = [part for part in pairs.parts if len(part.pairs) and not part.body.is_driven]
    operators = [part.body.delassus(part.points, pairs.places[part.rows]) for part in parts]
    soft = [operator for part, operator in zip(parts, operators, strict=True) if part.body.yields]
    if known is None or len(known.soft) != len(soft) or not all(map(is_, soft, known.soft)):
        W, yields = np.zeros((3 * len(pairs.places),) * 2), np.zeros(C, dtype=bool)
        for part, operator in zip(parts, operators, strict=True):
            if part.body.yields:
                add_operator(W, part, operator)
                yields[part.pairs[part.pairs < C]] = True
        of_soft = W
    else:
        of_soft, yields = known.of_soft, known.yields
    W = of_soft.copy()
    for part, operator in zip(parts, operators, strict=True):
        if not part.body.yields:
            add_operator(W, part, operator)
    guide = Guide(W, yields, proximal) if pairs.rows is None else RowGuide(W, yields, pairs.rows, proximal)
    guide.soft, guide.of_soft = soft, of_soft
    if known is not None:
        guide.begin_like(known)
    return guide


def add_operator(W: Array, part: Part, operator: Array) -> None:
    """Adds the operator of a body's points to that of all pairs."""
    sign = None if part.is_one_sided else np.repeat(part.signs, 3)
    signed = operator if sign is None else sign[:, None] * operator * sign
    if type(part.rows) is slice:
        axes = slice(3 * part.rows.start, 3 * part.rows.stop)
        W[axes, axes] += signed
    else:
        rows = (3 * part.pairs[:, None] + np.arange(3)).ravel()
        W[rows[:, None], rows] += signed


def _law(pairs: Pairs, guide: Guide, free: Array, f: Array, asked: _Asked) -> Array:
    """Forces (C + J, 3) of pairs that would move by free (C + J, 3) without; `asked` takes note."""
    while True:
        forces, z = _law_of_contacts(pairs, guide, free, f, asked)
        if guide.fits(free, forces, z):
            return forces


def _law_of_contacts(pairs: Pairs, guide: Guide, free: Array, f: Array, asked: _Asked) -> tuple[Array, Array]:
    """The same with drives of joints as they are; and forces of joints where contacts have none."""
    n, level, chosen = pairs.normals, asked.level, asked.chosen
    asked.braking.look_anew()
    z, free_contacts = guide.without_contact(free)
    forces = f[: len(level)].copy()
    speed = (n * free_contacts).dot(_ONES)
    chosen |= speed < level
    while chosen.any():
        active = chosen.nonzero()[0]
        q = free_contacts[active] - asked.target[active] - asked.braking.targets.take(active, axis=1).T
        f_active, u = guide.solve(active, q, n[active], pairs.friction[active], forces[active], asked.rounds)
        forces = np.zeros(forces.shape)
        forces[active] = f_active
        if (missed := ((n * guide.moved(forces)).dot(_ONES) + speed < level) > chosen).any():
            chosen |= missed
            if asked.braking.helped is not None:  # the power of friction is that of all pairs
                asked.braking = asked.braking.anew(asked.sliding.T.copy())
            continue
        negligible = WORK_ROUND_OFF * float(np.abs(f_active).max()) * float(np.abs(q).max())
        friction = f_active - (n[active] * f_active).dot(_ONES)[:, None] * n[active]
        response = partial(guide.response, active, n[active], pairs.friction[active], f_active, u)
        is_changed = asked.braking.asks_less(active, friction.T, u.T, negligible, response)
        asked.rounds = min(asked.rounds + is_changed, MOST_ROUNDS)
        if not is_changed:
            break
    else:
        forces = np.zeros(forces.shape)
    return guide.joined(z, forces), z


def _passive(pairs: Pairs, f: Array, u: Array, scale: float) -> tuple[Array, Array]:
    """Forces that fit their law but for a residual, made smaller at contacts until they do no work; u with them."""
    C, given = len(pairs.normals), f
    for share in SHARES:
        work = float(f[:C].ravel().dot(u[:C].ravel()))
        if work <= WORK_ROUND_OFF * scale * float(np.abs(f).max(initial=0.0)):
            break
        f = np.concatenate([share * given[:C], given[C:]])
        u, _ = _attempt(pairs, f)
    return f, u
