"""Many bodies in moving frames: the step of each is that of a single one, to the bit; see `linear_bodies`.

Each has a table of its own (`frame_tables`). What all of them share is the same arrays in each; what a step needs for
itself alone is those of the thread that takes it. There is a loop for each kind of step, as numba compiles all that one
may call.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Law, rubbed
from fenics_rom.mechanics.compiled.copying import copy, fill
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, moving_in
from fenics_rom.runtime.compiled.bent_frame import restore_shape
from fenics_rom.runtime.compiled.carried_step import take_bent_carried_step, take_carried_step
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.frame_tables import bent_at, state_at
from fenics_rom.runtime.compiled.frames import TAKEN, Step, restore
from fenics_rom.runtime.compiled.free_step import take_bent_free_step, take_free_step
from fenics_rom.runtime.compiled.linear_bodies import Told, contact_of, tell_contact
from fenics_rom.runtime.compiled.touched_carried import take_touched_bent_carried_step, take_touched_carried_step
from fenics_rom.runtime.compiled.touched_frame import Among, Touched
from fenics_rom.runtime.compiled.touched_free import take_touched_bent_free_step, take_touched_free_step
from fenics_rom.runtime.compiled.touching import LOST, Begun, StepContact


class Room(NamedTuple):
    """Where a thread has what steps of bodies that deform largely need for themselves alone."""

    rows: Array  # of tables (n,)
    addresses: Array  # (n,)


class Bodies(NamedTuple):
    """Bodies in frames, some of which take a step; B in all."""

    tables: Array  # (B, n, 4)
    some: Array  # which (s,)
    inputs: Array  # (B, p)
    bases: Array  # at the end of the step (B, 13); of free bodies they say nothing
    told: Told  # set; the status is OTHERWISE or LOST of bodies that do not take the step
    squares: Array  # twice the stored energies (B,), J, set of those that do
    at: Array  # (1,) how many of them are done, for whoever is to go on after an error


class Near(NamedTuple):
    """The obstacles that B bodies with P points are among."""

    law: Law
    friction: Array  # of each body (B,)
    shapes: Array  # of the obstacles, (O, 17)
    obstacles: Moving
    begun: Begun  # of all
    after: Begun  # what the next step begins with, which is set
    points: Points  # of one body
    at_rest: Array  # places of the points in world axes, (P, 3), m
    beyond: Array  # g, y and their rates of all (B, 4, 3P)
    beyond_before: Array  # the same before the step


class _StepSpace(NamedTuple):
    """What steps among obstacles need for themselves alone."""

    found: StepContact
    W: Array  # (3P, 3P)
    points: Array  # (5, P, 3), as of `Points`, and:
    pushed: Array  # (2, P)
    spread: Array  # (m, 3P)


@jit_part
def _step_space(near: Near) -> _StepSpace:
    N, P = near.begun.forces.shape[1], len(near.at_rest)
    space = np.zeros((5, P, 3)), np.zeros((2, P)), np.zeros(near.points.rows.shape)
    return _StepSpace(contact_of(N, P), np.empty((3 * P, 3 * P)), *space)


@jit_part
def _begin(bodies: Bodies, i: int) -> int:
    """The body that takes its step next."""
    bodies.at[0] = i
    return bodies.some[i]


@jit_part
def _give_room(table: Array, room: Room) -> None:
    for k in range(len(room.rows)):
        table[room.rows[k], 0] = room.addresses[k]


@jit_part
def _among_of(near: Near, space: _StepSpace, b: int) -> Among:
    """What the step of a body is told of obstacles."""
    of, found = near.points, space.found
    copy(near.begun.forces[b], found.pairs.forces)
    fill(found.pairs.friction, near.friction[b])
    own, moved, beyond = rubbed(near.law, near.friction[b]), space.points, (near.beyond[b], near.beyond_before[b])
    of_step = moved[0], moved[1], moved[2], moved[3], moved[4], space.pushed[0], space.spread, space.pushed[1], of.slots
    points, moving = Points(of.rest, of.rows, of.R, of.times, *beyond, *of_step), moving_in(near.obstacles, b)
    past = Begun(near.begun.forces[b], near.begun.swung[b])
    return Among(own, near.shapes, moving, past, points, near.at_rest, found, space.W)


@jit_part
def _end(bodies: Bodies, b: int, step: Step, room: Room | None, near: Near | None) -> None:
    """Notes a step that was taken. One whose energy is not finite is taken back."""
    told, works = bodies.told, bodies.told.works[b]
    told.status[b] = OTHERWISE
    if step.status != TAKEN:
        return
    if not np.isfinite(step.square):
        restore(state_at(bodies.tables[b]))
        if room is not None:
            restore_shape(bent_at(bodies.tables[b]))
        if near is not None:
            copy(near.beyond_before[b], near.beyond[b])
        told.status[b] = LOST
        return
    told.status[b], bodies.squares[b] = NOTHING, step.square
    works[0], works[1] = step.supplied, step.dissipated


@jit_part
def _end_touched(bodies: Bodies, b: int, near: Near, among: Among, touched: Touched) -> None:
    """Notes contact in a step, if it was taken."""
    told, works = bodies.told, bodies.told.works[b]
    if told.status[b] == NOTHING:
        told.status[b] = touched.contact.status
        works[2], works[3], works[4] = touched.by_obstacles, touched.lost, touched.friction
        after = Begun(near.after.forces[b], near.after.swung[b])
        tell_contact(near.law, touched.contact.status == FOUND, among.found, among.begun, after, told, b)


@jit
def step_free(bodies: Bodies) -> None:
    """Has free bodies take a step."""
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        _end(bodies, b, take_free_step(bodies.tables[b], bodies.inputs[b]), None, None)


@jit
def step_carried(bodies: Bodies) -> None:
    """The same of bodies that bases carry."""
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        _end(bodies, b, take_carried_step(bodies.tables[b], bodies.inputs[b], bodies.bases[b]), None, None)


@jit
def step_bent_free(bodies: Bodies, room: Room) -> None:
    """The same of free bodies that deform largely."""
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        _give_room(bodies.tables[b], room)
        _end(bodies, b, take_bent_free_step(bodies.tables[b], bodies.inputs[b]), room, None)


@jit
def step_bent_carried(bodies: Bodies, room: Room) -> None:
    """The same of carried ones."""
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        _give_room(bodies.tables[b], room)
        _end(bodies, b, take_bent_carried_step(bodies.tables[b], bodies.inputs[b], bodies.bases[b]), room, None)


@jit
def step_touched_free(bodies: Bodies, near: Near) -> None:
    """Has free bodies take a step among obstacles."""
    step = _step_space(near)
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        among = _among_of(near, step, b)
        touched = take_touched_free_step(bodies.tables[b], bodies.inputs[b], among)
        _end(bodies, b, touched.step, None, near)
        _end_touched(bodies, b, near, among, touched)


@jit
def step_touched_carried(bodies: Bodies, near: Near) -> None:
    """The same of bodies that bases carry."""
    step = _step_space(near)
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        among = _among_of(near, step, b)
        touched = take_touched_carried_step(bodies.tables[b], bodies.inputs[b], bodies.bases[b], among)
        _end(bodies, b, touched.step, None, near)
        _end_touched(bodies, b, near, among, touched)


@jit
def step_touched_bent_free(bodies: Bodies, near: Near, room: Room) -> None:
    """The same of free bodies that deform largely."""
    step = _step_space(near)
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        _give_room(bodies.tables[b], room)
        among = _among_of(near, step, b)
        touched = take_touched_bent_free_step(bodies.tables[b], bodies.inputs[b], among)
        _end(bodies, b, touched.step, room, near)
        _end_touched(bodies, b, near, among, touched)


@jit
def step_touched_bent_carried(bodies: Bodies, near: Near, room: Room) -> None:
    """The same of carried ones."""
    step = _step_space(near)
    for i in range(len(bodies.some)):
        b = _begin(bodies, i)
        _give_room(bodies.tables[b], room)
        among = _among_of(near, step, b)
        touched = take_touched_bent_carried_step(bodies.tables[b], bodies.inputs[b], bodies.bases[b], among)
        _end(bodies, b, touched.step, room, near)
        _end_touched(bodies, b, near, among, touched)
