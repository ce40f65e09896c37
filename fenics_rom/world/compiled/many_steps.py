"""Steps of a world one after the other, of which Python knows when they end."""

from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_part
from fenics_rom.mechanics.compiled.copying import copy
from fenics_rom.runtime.compiled.frame_tables import state_at
from fenics_rom.world.compiled.soft_bodies import SQUARE, step_at
from fenics_rom.world.compiled.tables import (
    ARRAYS_OF_PAIRS,
    COUNTED,
    ENDED,
    HIGH,
    IS_WHOLE,
    LOOK,
    PAIRS,
    PAIRS_BEFORE,
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
    free: int | None,
    ends: Array,
    watched: Array,
    told: Array,
) -> None:
    """Takes steps of h s under inputs that stay: as many as there are ends, or until Python is to do something.

    Args:
        world, given, h, row, goes_on, free: as of `take_step`, of the first one.
        ends: (n, D, 13) where bodies that are driven are when each step ends.
        watched: (S, 4) of each soft body twice the energy, J, beyond which its surface may go too far, and whether that
            is the whole energy or that of the shape; after how many such steps it is looked at, and how many there
            were, which is set.
        told: (4,) set, see `TAKEN`; the last is 0, or OTHERWISE or NEEDS_CONTACTS of a step that was not taken.
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
        if _is_to_be_looked_at(world, watched):
            return


@jit_part
def exchange_pairs(world: Array) -> None:
    """Has pairs of a step stand in the table where those of the step before were, and these there."""
    for i in range(ARRAYS_OF_PAIRS):
        one, other = world[PAIRS + i], world[PAIRS_BEFORE + i]
        for k in range(4):
            one[k], other[k] = other[k], one[k]


@jit_part
def _is_to_be_looked_at(world: Array, watched: Array) -> bool:
    """Whether a soft body is, as it has ended so many steps at a high energy."""
    softs, some = softs_at(world), False
    for s in range(len(watched)):
        energy, e = step_at(softs[s]).told[SQUARE], state_at(softs[s]).halves[0]
        if watched[s, IS_WHOLE] == 0.0:
            energy = e.dot(e) + 0 * energy
        if not energy <= watched[s, THRESHOLD]:
            watched[s, HIGH] += 1
            some = some or watched[s, HIGH] >= watched[s, LOOK]
    return some
