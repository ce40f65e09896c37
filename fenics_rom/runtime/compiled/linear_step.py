"""The midpoint step of a linear body among obstacles, whole: `steppers.contact_midpoint`, compiled.

    A v̂ = G u + 2/h r - ω e + Sᵀ f,    e⁺ = e + h ω v̂,    r⁺ = 2 v̂ - r

and beside it what the contact points do beyond the basis (`steppers.residual_motion`).
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import (
    FOUND,
    NOTHING,
    OTHERWISE,
    Found,
    Law,
    Pairs,
    ask,
    find_forces,
    is_out_of_reach,
)
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.shapes import measure

FORGOTTEN = 1e-200  # J: see `steppers.residual_motion`


class Body(NamedTuple):
    """A linear body in steps of h s, with m modes, ρ of them rigid, p inputs and P contact points."""

    ω: Array  # (m,), 1/s; 0 of rigid modes
    inverse_ω: Array  # (m,), s; 1 of rigid modes
    inputs: Array  # G (m, p)
    A: Array  # A⁻¹ (m, m)
    heat: Array  # a root of A⁻¹ D A⁻¹ (m, m)
    points: Array  # Sᵀ (m, 3P)
    places: Array  # of the points at rest, (P, 3), m
    W: Array  # the Delassus operator (3P, 3P), with R/a, m/s/N
    inverse: Array  # of W, (0, 0) where there is none that tells forces apart
    R: Array  # residual compliance (3P, 3P), m/N; (0, 0) where there is none
    inertia: float  # 2τ²/h, s, of what carries a force beyond the basis
    whole: float  # a, s
    lost: float  # β + (θ - ½) h, s
    τ: float  # s


class State(NamedTuple):
    """What a step changes."""

    halves: Array  # e and r, (2, m)
    rigid: Array  # displacements (ρ,)
    beyond: Array  # g, y and their rates, (4, 3P)
    halves_before: Array  # the same before the step
    rigid_before: Array
    beyond_before: Array


class Step(NamedTuple):
    """What a step did."""

    status: int  # of contact; where that is OTHERWISE no step was taken
    sweeps: int
    square: float  # twice the stored energy, J
    supplied: float  # by inputs, J
    dissipated: float  # but for contact, J
    by_obstacles: float  # supplied, J
    contact: float  # dissipated in impacts, J
    friction: float  # dissipated, J
    normal_power: float  # Σ λ s of the pairs, W


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


@jit
def take_step(
    body: Body,
    law: Law,
    shapes: Array,
    u: Array,
    start: Array,
    end: Array,
    w_before: Array,
    begun: Begun,
    state: State,
    found: StepContact,
    is_told: bool,
) -> Step:
    """Takes a step.

    Args:
        body, law: of it.
        shapes: of the obstacles, (O, 17).
        u: the input (p,).
        start, end: displacements of the obstacles, (O, 3), m.
        w_before: their velocities in the step before, (O, 3), m/s.
        begun: what the step begins with.
        state: changed.
        found: with forces to begin with; set.
        is_told: whether what the law says is set where nothing is within reach, too.
    """
    pairs, gaps, motion, forces = found
    h, m, n, P = law.h, len(body.ω), len(forces), len(body.places)
    e, r, ρ = state.halves[0], state.halves[1], len(state.rigid)
    yields = len(body.R) > 0
    pushed = body.inputs.dot(u)
    right = pushed + 2 / h * r - body.ω * e
    v = body.A.dot(right)
    q = np.empty(m)
    for i in range(m):
        q[i] = state.rigid[i] if i < ρ else e[i] * body.inverse_ω[i]
    for k in range(n):
        motion[0, k], motion[1, k], motion[2, k] = 0.0, 0.0, 0.0
    for i in range(m):
        row, qi, ri, vi = body.points[i], q[i], r[i], v[i]
        for k in range(n):
            motion[0, k] += row[k] * qi
            motion[1, k] += row[k] * ri
            motion[2, k] += row[k] * vi
    if yields:
        y, rate = state.beyond[1], state.beyond[3]
        for k in range(n):
            motion[0, k] += y[k]
            motion[1, k] += rate[k]
            motion[2, k] += (body.inertia * rate[k] - y[k]) / body.whole
    places = body.places + motion[0].reshape(P, 3)
    measure(shapes, start, places, gaps, pairs.axes[:, 0])
    w = (end - start) / h
    free, velocity, contact = motion[2].reshape(P, 3), motion[1].reshape(P, 3), Found(NOTHING, 0, 0.0)
    if is_told or not is_out_of_reach(law, gaps.min(), free, velocity, w, w_before, pairs):
        ask(law, gaps, free, velocity, w, w_before, begun.forces, np.empty(0), pairs)
        contact = find_forces(law, body.W, body.inverse, P, begun.swung, pairs)
    if contact.status == OTHERWISE:
        return Step(OTHERWISE, contact.sweeps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    _remember(state)
    forces[:] = 0.0
    power = by_obstacles = 0.0
    if contact.status == FOUND:
        for c in range(len(gaps)):
            for k in range(3):
                forces[3 * (c % P) + k] += pairs.forces[c, k]
                by_obstacles += pairs.forces[c, k] * w[c // P, k]
        by_contact = body.points.dot(forces)
        right += by_contact
        v = body.A.dot(right)
        power = by_contact.dot(v)
    heat = body.heat.dot(right)
    supplied, dissipated = h * pushed.dot(v), h * heat.dot(heat)
    stored = 0.0
    if yields:
        lost, power_beyond, stored = _step_beyond(body, h, state.beyond, forces, motion[3])
        dissipated, power = dissipated + lost, power + power_beyond
        if contact.status == NOTHING and stored < 2 * FORGOTTEN:
            state.beyond[:] = 0.0
            stored = 0.0
    for i in range(m):
        e[i] += h * body.ω[i] * v[i]
        r[i] = 2 * v[i] - r[i]
    for i in range(ρ):
        state.rigid[i] += h * v[i]
    whole = power - by_obstacles
    normal = contact.normal_power if law.friction > 0 else whole
    square = e.dot(e) + r.dot(r) + stored
    return Step(
        contact.status,
        contact.sweeps,
        square,
        supplied,
        dissipated,
        h * by_obstacles,
        -h * normal,
        h * (normal - whole),
        contact.normal_power,
    )


@jit_part
def _remember(state: State) -> None:
    """Notes what is there before a step."""
    copy(state.halves, state.halves_before)
    copy(state.rigid, state.rigid_before)
    copy(state.beyond, state.beyond_before)


@jit_part
def restore(state: State) -> None:
    """Puts a body where it was before the last step."""
    copy(state.halves_before, state.halves)
    copy(state.rigid_before, state.rigid)
    copy(state.beyond_before, state.beyond)


@jit_part
def _step_beyond(body: Body, h: float, beyond: Array, f: Array, rates: Array) -> tuple[float, float, float]:
    """Takes the step of what points do beyond the basis: what it loses, J, the power of f there, W, twice its energy.

    Sets the rates (3P,) of y in it.
    """
    g, y, g_rate, y_rate = beyond[0], beyond[1], beyond[2], beyond[3]
    Rf = body.R.dot(f)
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


class Taken(NamedTuple):
    """Of steps in a row, one row each."""

    works: Array  # (n, 5), J: supplied, dissipated, by obstacles, contact and friction, as in `Step`
    q: Array  # (n, m) after it
    carried: Array  # g (n, 3P) beyond the basis after it, N; (n, 0) where there is nothing


@jit
def take_steps(
    body: Body,
    law: Law,
    shapes: Array,
    inputs: Array,
    offsets: Array,
    begun: Begun,
    state: State,
    tried: StepContact,
    last_begun: Begun,
    last: StepContact,
    taken: Taken,
) -> tuple[int, Step]:
    """Takes steps under inputs (n, p) among obstacles that stand still: how many, and the last one.

    It ends before a step that is to be found otherwise, or whose energy is not finite.

    Args:
        body, law, shapes, state: as in `take_step`.
        inputs: (n, p).
        offsets: displacements of the obstacles, (O, 3), m.
        begun: what the first step begins with; changed.
        tried: for what a step finds.
        last_begun, last: set to what the last step began with, and found.
        taken: set.
    """
    ρ, still = len(state.rigid), np.zeros(offsets.shape)
    step = Step(OTHERWISE, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for count in range(len(inputs)):
        copy(begun.forces, tried.pairs.forces)
        after = take_step(body, law, shapes, inputs[count], offsets, offsets, still, begun, state, tried, True)
        if after.status == OTHERWISE:
            return count, step
        if not np.isfinite(after.square):
            restore(state)
            return count, step
        step = after
        _keep(begun, tried, last_begun, last)
        for c in range(len(begun.swung)):
            begun.swung[c] = min(begun.swung[c], law.swings) + 1 if tried.pairs.helped[c] else 0
        if step.status == FOUND:
            copy(tried.pairs.forces, begun.forces)
        works = taken.works[count]
        works[0], works[1], works[2] = step.supplied, step.dissipated, step.by_obstacles
        works[3], works[4] = step.contact, step.friction
        for i in range(len(body.ω)):
            taken.q[count, i] = state.rigid[i] if i < ρ else state.halves[0, i] * body.inverse_ω[i]
        if len(body.R) > 0:
            copy(state.beyond[0], taken.carried[count])
    return len(inputs), step


@jit_part
def _keep(begun: Begun, tried: StepContact, last_begun: Begun, last: StepContact) -> None:
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
