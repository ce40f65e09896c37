"""Rigid bodies that are in one another, and are let out as they rest there: `StepPairs.let_out`."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.runtime.compiled.frames import dot, vector
from fenics_rom.world import normal_law
from fenics_rom.world.compiled.tables import OUT, OWN, SIZE, kept_at, meetings_at, near_at
from fenics_rom.world.tolerances import PENETRATION_TOLERANCE

_speeds_out = jit_shared(normal_law.speeds_out)


@jit_part
def set_speeds_out(world: Array, C: int, h: float) -> bool:
    """Sets at what speeds C contacts are let out, whose forces are found without that; whether some are."""
    near, meetings = near_at(world), meetings_at(world)
    are_deep, any_deep = np.zeros(C, dtype=np.bool_), False
    for c in range(C):
        depth = PENETRATION_TOLERANCE * meetings.numbers[near.meetings[c], SIZE]
        are_deep[c] = near.are_rigid[c] != 0.0 and near.gaps[c] < -depth
        any_deep = any_deep or are_deep[c]
    if not any_deep:
        return False
    approach, pressure = np.empty(C), np.empty(C)
    for c in range(C):
        n = vector(near.normals[c], 0)
        approach[c], pressure[c] = dot(n, vector(near.before[c], 0)), dot(n, vector(near.forces[c], 0))
    known = near.numbers[:C, OWN], are_deep, near.meetings[:C], kept_at(world).dissipated
    out = _speeds_out(h, near.gaps[:C], approach, pressure, known[0], known[1], known[2], known[3])
    for c in range(C):
        near.numbers[c, OUT] = out[c]
    return bool(out.any())


@jit_part
def overdraws(world: Array, C: int, h: float) -> bool:
    """Whether contact of two bodies would have done more work in the step than it has dissipated before."""
    near, left = near_at(world), kept_at(world).dissipated.copy()
    for c in range(C):
        left[near.meetings[c]] -= h * dot(vector(near.forces[c], 0), vector(near.u[c], 0))
    return bool((left < 0).any())


@jit_part
def leave_in(world: Array, C: int) -> None:
    """Lets none of C contacts out."""
    near = near_at(world)
    for c in range(C):
        near.numbers[c, OUT] = 0.0
