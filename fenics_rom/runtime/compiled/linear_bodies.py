"""Many linear bodies among obstacles: the step of each is that of `linear_step`, to the bit.

Arrays are those of one body, stacked: bodies first. Loops over some of the bodies run in threads beside others.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit
from fenics_rom.mechanics.compiled.contact_law import FOUND, OTHERWISE, Law, Pairs
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.mechanics.compiled.shapes import measure
from fenics_rom.runtime.compiled.linear_step import Body, State, restore, take_step
from fenics_rom.runtime.compiled.touching import LOST, Begun, StepContact, Touched, hand_on


class Obstacles(NamedTuple):
    """How O obstacles of each of B bodies move in a step."""

    start: Array  # (B, O, 3), m
    end: Array  # (B, O, 3), m
    before: Array  # velocities in the step before (B, O, 3), m/s


class Told(NamedTuple):
    """Of the last step of B bodies."""

    status: Array  # (B,) of contact, or LOST
    works: Array  # (B, 5), J: supplied, dissipated, by obstacles, contact and friction, as in `Step`
    forces: Array  # on the points (B, P, 3), N
    resultants: Array  # of each obstacle (B, O, 3), N
    pressing: Array  # of all obstacles along their normals (B, P), N


@jit
def step_bodies(
    body: Body,
    law: Law,
    friction: Array,
    shapes: Array,
    bodies: Array,
    inputs: Array,
    obstacles: Obstacles,
    begun: Begun,
    after: Begun,
    states: State,
    told: Told,
) -> None:
    """Takes a step of some bodies.

    Args:
        body, law, shapes: as in `take_step`, of all bodies but for friction.
        friction: μ of each (B,).
        bodies: (n,) which of the B.
        inputs: (B, p).
        obstacles: of all.
        begun, after: what the step begins with of the past, and what the next one does, which is set.
        states: changed of those that take the step: not where its status is OTHERWISE or LOST.
        told: set.
    """
    P, N = len(body.places), begun.forces.shape[1]
    vectors, flags = np.empty((3, N, 3)), np.empty((2, N), dtype=np.bool_)
    axes, forces, rubs = np.empty((N, 3, 3)), np.empty((N, 3)), np.empty(N)
    sought = Pairs(axes, vectors[0], vectors[1], vectors[2], np.empty(N), flags[0], flags[1], rubs, forces)
    found = StepContact(sought, np.empty(N), np.zeros((4, 3 * P)), np.empty(3 * P))
    for b in bodies:
        copy(begun.forces[b], forces)
        rubs[:] = friction[b]
        own = Law(law.h, law.restitution, friction[b], law.rate, law.compliance, law.is_at_rest, law.swings)
        now = states.halves[b], states.rigid[b], states.beyond[b]
        state = State(*now, states.halves_before[b], states.rigid_before[b], states.beyond_before[b])
        past = Begun(begun.forces[b], begun.swung[b])
        moving = obstacles.start[b], obstacles.end[b], obstacles.before[b]
        step = take_step(body, own, shapes, inputs[b], *moving, past, state, found, False)
        told.status[b] = step.status
        if step.status != OTHERWISE and not np.isfinite(step.square):
            restore(state)
            told.status[b] = LOST
        if told.status[b] >= OTHERWISE:
            continue
        works, touched = told.works[b], step.status == FOUND
        works[0], works[1], works[2] = step.supplied, step.dissipated, step.by_obstacles
        works[3], works[4] = step.contact, step.friction
        told.resultants[b], told.pressing[b] = 0.0, 0.0
        copy(found.forces.reshape(P, 3), told.forces[b])
        hand_on(law, past, touched, sought, Begun(after.forces[b], after.swung[b]))
        for c in range(N):
            for k in range(3 if touched else 0):
                told.resultants[b, c // P, k] += forces[c, k]
                told.pressing[b, c % P] += forces[c, k] * axes[c, 0, k]


@jit
def look_at_bodies(
    body: Touched,
    inverse_ω: Array,
    shapes: Array,
    bodies: Array,
    start: Array,
    states: State,
    displacement: Array,
    nearest: Array,
) -> None:
    """Sets displacements of the points (B, P, 3), m, and their gaps to the nearest obstacle (B, P), m, of some bodies.

    Arguments as in `step_bodies`; inverse_ω: (m,), s; start: displacements of the obstacles (B, O, 3), m.
    """
    P, count, ρ = len(body.places), len(shapes), states.rigid.shape[1]
    gaps, normals = np.empty(count * P), np.empty((count * P, 3))
    for b in bodies:
        moved = displacement[b].reshape(3 * P)
        moved[:] = 0.0
        if len(body.R) > 0:
            copy(states.beyond[b, 1], moved)
        for i in range(len(inverse_ω)):
            q = states.rigid[b, i] if i < ρ else states.halves[b, 0, i] * inverse_ω[i]
            for k in range(3 * P):
                moved[k] += body.points[i, k] * q
        measure(shapes, start[b], body.places + displacement[b], gaps, normals)
        for p in range(P):
            nearest[b, p] = gaps[p]
            for o in range(1, count):
                nearest[b, p] = min(nearest[b, p], gaps[o * P + p])
