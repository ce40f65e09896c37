"""Steps of a world one after the other, of which Python knows when they end."""

import math

from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.frame_tables import state_at
from fenics_rom.world.compiled.soft_bodies import SQUARE, step_at
from fenics_rom.world.compiled.tables import (
    ARRAYS_OF_PAIRS,
    COUNTED,
    ENDED,
    INTERVAL,
    IS_DUE,
    IS_WHOLE,
    PAIRS,
    PAIRS_BEFORE,
    RADIUS,
    SINCE,
    SWEPT,
    TAKEN,
    THRESHOLD,
    driven_at,
    softs_at,
)
from fenics_rom.world.compiled.world_step import OTHERWISE, take_step


@jit
def take_steps(
    world: Array,
    given: Array,
    h: float,
    row: int,
    goes_on: bool,
    free: bool,
    ends: Array,
    watched: Array,
    looked_at: Array,
    told: Array,
) -> None:
    """Takes steps of h s under inputs that stay: as many as there are ends, or until Python is to do something.

    Args:
        world, given, h, row, goes_on, free: as of `take_step`, of the first one.
        ends: (n, D, 13) where bodies that are driven are when each step ends.
        watched: (S, 6) of each soft body. `THRESHOLD`: twice the energy, J, beyond which its surface may go too far;
            `IS_WHOLE`: whether that is the whole energy, or that of the shape. `INTERVAL`: after how many such steps it
            is looked at; `SINCE`, set: how many there were. `RADIUS`: how far e may be from those of the last look, √J,
            without another one. `IS_DUE`, set: whether one is due, which ends steps.
        looked_at: these e, (S, m).
        told: (4,) set, see `TAKEN`; the last is 0, or why a step was not taken, as of `take_step`.
    """
    driven = driven_at(world)
    told[TAKEN] = told[ENDED] = 0
    for k in range(len(ends)):
        is_begun = goes_on and k == 0
        if not is_begun:
            exchange_pairs(world)
            copy(ends[k], driven.end)
        C, sweeps = take_step(world, given, h, row + k, is_begun, free)
        if C < 0:
            if C == OTHERWISE:
                exchange_pairs(world)
            told[ENDED] = C
            return
        told[TAKEN], told[COUNTED], told[SWEPT] = k + 1, C, sweeps
        if _is_to_be_looked_at(world, watched, looked_at):
            return


@jit_part
def exchange_pairs(world: Array) -> None:
    """Has pairs of a step stand in the table where those of the step before were, and these there."""
    for i in range(ARRAYS_OF_PAIRS):
        one, other = world[PAIRS + i], world[PAIRS_BEFORE + i]
        for k in range(4):
            one[k], other[k] = other[k], one[k]


@jit_part
def _is_to_be_looked_at(world: Array, watched: Array, looked_at: Array) -> bool:
    """Whether a soft body is, as it has ended so many steps at a high energy, and has gone far: `LinearityMonitor`."""
    softs, some = softs_at(world), False
    for s in range(len(watched)):
        of, energy, e = watched[s], step_at(softs[s]).told[SQUARE], state_at(softs[s]).halves[0]
        if of[IS_WHOLE] == 0.0:
            energy = e.dot(e) + 0 * energy
        if energy <= of[THRESHOLD]:
            continue
        of[SINCE] += 1
        if of[SINCE] >= of[INTERVAL]:
            square = 0.0
            for i in range(len(e)):
                square += (e[i] - looked_at[s, i]) ** 2
            if math.sqrt(square) < of[RADIUS]:
                of[SINCE] = 0.0
            else:
                of[IS_DUE], some = 1.0, True
    return some
