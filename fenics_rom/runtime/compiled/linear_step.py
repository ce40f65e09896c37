"""The midpoint step of a linear body among obstacles, whole: `steppers.contact_midpoint`, compiled.

    A v̂ = G u + 2/h r - ω e + Sᵀ f,    e⁺ = e + h ω v̂,    r⁺ = 2 v̂ - r

and beside it what the contact points do beyond the basis (`steppers.residual_motion`).
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Found, Law, find_forces
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.touching import (
    FORGOTTEN,
    Begun,
    StepContact,
    add_up_forces,
    ask_points,
    hand_on,
    keep_found,
    step_beyond,
)


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
    pairs, _, motion, forces = found
    h, m, P = law.h, len(body.ω), len(body.places)
    e, r, ρ = state.halves[0], state.halves[1], len(state.rigid)
    yields = len(body.R) > 0
    pushed = body.inputs.dot(u)
    right = pushed + 2 / h * r - body.ω * e
    v = body.A.dot(right)
    q = np.empty(m)
    for i in range(m):
        q[i] = state.rigid[i] if i < ρ else e[i] * body.inverse_ω[i]
    w = (end - start) / h
    contact, motions = Found(NOTHING, 0, 0.0), (q, r, v)
    if ask_points(body, law, shapes, start, w, w_before, begun, motions, state.beyond, found, is_told):
        contact = find_forces(law, body.W, body.inverse, P, begun.swung, pairs)
    if contact.status == OTHERWISE:
        return Step(OTHERWISE, contact.sweeps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    _remember(state)
    by_obstacles, power = add_up_forces(contact, w, found), 0.0
    if contact.status == FOUND:
        by_contact = body.points.dot(forces)
        right += by_contact
        v = body.A.dot(right)
        power = by_contact.dot(v)
    heat = body.heat.dot(right)
    supplied, dissipated = h * pushed.dot(v), h * heat.dot(heat)
    stored = 0.0
    if yields:
        lost, power_beyond, stored = step_beyond(body, h, state.beyond, forces, motion[3])
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
        is_told = count >= 0  # always: of a constant all would be compiled anew
        after = take_step(body, law, shapes, inputs[count], offsets, offsets, still, begun, state, tried, is_told)
        if after.status == OTHERWISE:
            return count, step
        if not np.isfinite(after.square):
            restore(state)
            return count, step
        step = after
        keep_found(begun, tried, last_begun, last)
        hand_on(law, begun, step.status == FOUND, tried.pairs, begun)
        works = taken.works[count]
        works[0], works[1], works[2] = step.supplied, step.dissipated, step.by_obstacles
        works[3], works[4] = step.contact, step.friction
        for i in range(len(body.ω)):
            taken.q[count, i] = state.rigid[i] if i < ρ else state.halves[0, i] * body.inverse_ω[i]
        if len(body.R) > 0:
            copy(state.beyond[0], taken.carried[count])
    return len(inputs), step
