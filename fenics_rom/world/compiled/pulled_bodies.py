"""Held soft bodies of small strains with strokes that are given, or guides that rub, in a step of a world.

Contact forces change what strokes and guides need, and these how points move: each try of a world finds them anew.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.compiled_arrays import flat
from fenics_rom.mechanics.compiled.actuator_forces import begin_search, look
from fenics_rom.mechanics.compiled.copying import add_row, copy
from fenics_rom.mechanics.compiled.searched_forces import ARE_FOUND, GOES_ON, room_for_search, search_in
from fenics_rom.runtime.compiled.arrays_at import vector_at
from fenics_rom.runtime.compiled.contact_points import Points
from fenics_rom.runtime.compiled.frame_tables import body_at, state_at
from fenics_rom.runtime.compiled.held_back import hold_back
from fenics_rom.runtime.compiled.linear_actuators import Pulled
from fenics_rom.runtime.compiled.linear_table import pulled_at
from fenics_rom.runtime.compiled.small_matrices import dot
from fenics_rom.world.compiled.soft_bodies import DISSIPATED, PULLED, SUPPLIED, points_at, step_at


class PulledHere(NamedTuple):
    """What n forces are found of, and those of the last steps."""

    pulled: Pulled
    reactions: Array  # of the step before (n,)
    found: Array  # in the last try (n,)
    holds: Array  # 1 of those that were within their bounds then (n,)


@jit_part
def pulled_of(table: Array) -> PulledHere:
    """What a body has of it."""
    t = table[PULLED:]
    return PulledHere(pulled_at(t), vector_at(t[10]), vector_at(t[11]), vector_at(t[12]))


@jit_apart
def pull_soft(table: Array, h: float) -> bool:
    """Adds what strokes and guides do to how a body moves in a try; whether their forces are found."""
    body, state, step = body_at(table), state_at(table), step_at(table)
    of, q, r = pulled_of(table), state.halves[0] * body.inverse_ω, state.halves[1]
    numbers = np.empty(room_for_search(len(of.reactions)))
    return _pull(of, points_at(table), h, step.u, q, r, step.rate, step.changed, numbers)


@jit_apart
def end_pulled(table: Array, h: float) -> None:
    """Adds to what a step is booked for what strokes and guides did in it."""
    step = step_at(table)
    supplied, dissipated = _end_pull(pulled_of(table), h, step.changed)
    step.told[SUPPLIED] += supplied
    step.told[DISSIPATED] += dissipated


@jit_part
def _pull(
    of: PulledHere, points: Points, h: float, u: Array, q: Array, r: Array, rate: Array, changed: Array, numbers: Array
) -> bool:
    """Adds to r̂ (m,) of a try, and to velocities of points, what strokes and guides do; whether forces are found.

    Args:
        of: what they are.
        points: whose `inside` is set.
        h: s.
        u: the input (p,).
        q, r: when the step begins (m,).
        rate: r̂ without contact and without these forces.
        changed: the same with contact; they are added.
        numbers: room for a search, which whoever calls keeps.
    """
    pulled, n = of.pulled, len(of.reactions)
    given, first = pulled.actuators, n - len(pulled.actuators.guides)
    search = search_in(numbers, n)
    for k in range(n):
        line, share = pulled.lines[k], given.share[k]
        missing = 0.0 if k >= first else u[given.columns[k]] - dot(line, q)
        search.targets[k] = share / h * missing + (1 - share) * dot(line, r)
        search.rates[k] = dot(line, rate)
    begin_search(given, given.bends, pulled.W, u, of.reactions, h, search)
    for k in range(n):
        search.added[k] = dot(pulled.lines[k], changed) - search.rates[k]
    outcome = GOES_ON
    while outcome == GOES_ON:
        outcome = look(given, given.bends, u, False, search)
    if outcome != ARE_FOUND:
        return False
    copy(search.z, of.found)
    inside = flat(points.inside)
    for k in range(n):
        of.holds[k] = 1.0 if search.sides[k] == 0.0 else 0.0
        add_row(pulled.spread[k], of.found[k], changed)
        add_row(pulled.X[k], of.found[k], inside)
    return True


@jit_part
def _end_pull(of: PulledHere, h: float, changed: Array) -> tuple[float, float]:
    """Ends the step under the forces of the last try: what strokes supply in it, and what guides dissipate, J."""
    n, supplied, dissipated = len(of.found), 0.0, 0.0
    for k in range(n):
        work = h * of.found[k] * dot(of.pulled.lines[k], changed)
        if k < n - len(of.pulled.actuators.guides):
            supplied += work
        else:
            dissipated -= work
    copy(of.found, of.reactions)
    return supplied, dissipated


@jit_part
def hold_back_places(of: PulledHere, nodes: Array, weights: Array, W: Array) -> bool:
    """Takes from the operator W (3s, 3s) of places of points what strokes hold back; whether there is one then."""
    n, (s, wide) = len(of.found), nodes.shape
    X, free = np.zeros((n, 3 * s)), W.copy()
    for k in range(n):
        row, of_points = X[k], of.pulled.X[k]
        for i in range(s):
            for a in range(wide):
                share, at = weights[i, a], 3 * nodes[i, a]
                for j in range(3 if share != 0.0 else 0):
                    row[3 * i + j] += share * of_points[at + j]
    return hold_back(free, X, of.pulled.W, of.holds, W)
