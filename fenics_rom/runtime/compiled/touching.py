"""Where a body can be touched, compiled: what its points do, the forces there, and what they yield beyond the basis.

A `Touched` body is one that has these parts, as `linear_step.Body` has them.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, Found, Law, Pairs, ask, is_out_of_reach
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.shapes import measure

FORGOTTEN = 1e-200  # J: see `steppers.residual_motion`
LOST = 3  # status of a step whose state would not be finite; see `contact_law`


class Yielding(Protocol):
    """What P contact points do beyond the basis."""

    @property
    def R(self) -> Array:
        """Residual compliance (3P, 3P), m/N; (0, 0) where there is none."""

    @property
    def inertia(self) -> float:
        """2τ²/h, s, of what carries a force beyond the basis."""

    @property
    def whole(self) -> float:
        """a, s."""

    @property
    def lost(self) -> float:
        """β + (θ - ½) h, s."""

    @property
    def τ(self) -> float:
        """s."""


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
def ask_points(
    body: Touched,
    law: Law,
    shapes: Array,
    start: Array,
    w: Array,
    w_before: Array,
    begun: Begun,
    motions: tuple[Array, Array, Array],
    beyond: Array,
    found: StepContact,
    is_told: bool,
) -> bool:
    """Sets what the law asks of every pair in a step of h s; False: nothing, as nothing is within reach.

    Args:
        body, law: of it.
        shapes, start: of the obstacles, as in `linear_step.take_step`.
        w, w_before: their velocities in this step and in the one before, (O, 3), m/s.
        begun: what the step begins with.
        motions: q and r at its start, and v̂ without contact, (m,).
        beyond: g, y and their rates, (4, 3P).
        found: set but for forces.
        is_told: whether it is to be set where nothing is within reach, too.
    """
    pairs, gaps, motion, _ = found
    q, r, v = motions
    n, P = motion.shape[1], len(body.places)
    for k in range(n):
        motion[0, k], motion[1, k], motion[2, k] = 0.0, 0.0, 0.0
    for i in range(len(q)):
        row, qi, ri, vi = body.points[i], q[i], r[i], v[i]
        for k in range(n):
            motion[0, k] += row[k] * qi
            motion[1, k] += row[k] * ri
            motion[2, k] += row[k] * vi
    if len(body.R) > 0:
        y, rate = beyond[1], beyond[3]
        for k in range(n):
            motion[0, k] += y[k]
            motion[1, k] += rate[k]
            motion[2, k] += (body.inertia * rate[k] - y[k]) / body.whole
    places = body.places + motion[0].reshape(P, 3)
    measure(shapes, start, places, gaps, pairs.axes[:, 0])
    free, velocity = motion[2].reshape(P, 3), motion[1].reshape(P, 3)
    if not is_told and is_out_of_reach(law, gaps.min(), free, velocity, w, w_before, pairs):
        return False
    ask(law, gaps, free, velocity, w, w_before, begun.forces, np.empty(0), pairs)
    return True


@jit_part
def add_up_forces(contact: Found, w: Array, found: StepContact) -> float:
    """Sets the forces on the points; their power on obstacles that move with w (O, 3), W."""
    forces, pairs, power = found.forces, found.pairs, 0.0
    for k in range(len(forces)):
        forces[k] = 0.0
    if contact.status == FOUND:
        P = len(forces) // 3
        for c in range(len(pairs.forces)):
            for k in range(3):
                forces[3 * (c % P) + k] += pairs.forces[c, k]
                power += pairs.forces[c, k] * w[c // P, k]
    return power


@jit_part
def step_beyond(body: Yielding, h: float, beyond: Array, f: Array, rates: Array) -> tuple[float, float, float]:
    """Takes the step of what points do beyond the basis: what it loses, J, the power of f there, W, twice its energy.

    Sets the rates (3P,) of y in it.
    """
    g, y, g_rate, y_rate = beyond[0], beyond[1], beyond[2], beyond[3]
    Rf = np.zeros(len(f))
    for k in range(len(f)):  # where forces act, which are few points
        if f[k] != 0.0:
            row, by = body.R[k], f[k]
            for j in range(len(f)):
                Rf[j] += by * row[j]
    lost = power = stored = 0.0
    for k in range(len(f)):
        g_mid = (body.inertia * g_rate[k] - g[k] + f[k]) / body.whole
        y_mid = (body.inertia * y_rate[k] - y[k] + Rf[k]) / body.whole
        rates[k] = y_mid
        g[k], y[k] = g[k] + h * g_mid, y[k] + h * y_mid
        g_rate[k], y_rate[k] = 2 * g_mid - g_rate[k], 2 * y_mid - y_rate[k]
        lost += g_mid * y_mid
        power += f[k] * y_mid
        stored += g[k] * y[k] + body.τ**2 * g_rate[k] * y_rate[k]
    return h * body.lost * lost, power, stored


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
