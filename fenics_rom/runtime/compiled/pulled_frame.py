"""Bodies in moving frames whose strokes or gas are given, or whose tendons rub, compiled: `frame_contact.hold`.

Nothing touches them here. A step begins under the forces of the step before. Near what it leads to, those that are
found change velocities by A⁻¹ B z; of a free body by slopes that are kept, in sweeps until nothing changes.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part
from fenics_rom.mechanics.actuator_forces import CREEP
from fenics_rom.mechanics.compiled.actuator_forces import begin_search, look
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill
from fenics_rom.mechanics.compiled.searched_forces import ARE_FOUND, GOES_ON, search_in
from fenics_rom.mechanics.frame_contact import FEW_SWEEPS, PATIENCE, SLOW
from fenics_rom.runtime.compiled.bent_frame import FOLLOWED, PULL, Bending, pressed_rims, remember_shape, restore_shape
from fenics_rom.runtime.compiled.carried_step import (
    OF_BASE,
    SPIN,
    Begun,
    act_on_carried,
    begin_carried_step,
    end_carried_step,
    inverse_of_carried,
)
from fenics_rom.runtime.compiled.carried_strains import strains_in
from fenics_rom.runtime.compiled.following import add_following
from fenics_rom.runtime.compiled.frame_tables import bent_at, body_at, loads_at, state_at, watch_at
from fenics_rom.runtime.compiled.frames import (
    NOT_PUSHED,
    OTHERWISE,
    TAKEN,
    VELOCITY,
    Body,
    Loads,
    State,
    Step,
    act,
    give,
    give_without_springs,
    length,
    vector,
)
from fenics_rom.runtime.compiled.free_balance import correct, keep_slopes, lack, size_of, solve, speed_at, weight_of
from fenics_rom.runtime.compiled.free_step import Begun as BegunFree
from fenics_rom.runtime.compiled.free_step import begin_free_step, end_free_step
from fenics_rom.runtime.compiled.small_matrices import dot
from fenics_rom.runtime.compiled.strokes import Pull, aim, set_bends, set_lines
from fenics_rom.runtime.compiled.touched_frame import has_ended

NONE_TAKEN = Step(OTHERWISE, 0.0, 0.0, 0.0, 0.0)


@jit_apart
def take_pulled_carried_step(table: Array, u: Array, base: Array, pull: Pull) -> Step:
    """As `take_carried_step`, with forces that are found; those of the step before are in `pull`, then its own."""
    return _take_carried(table, u, base, pull, None)


@jit_apart
def take_pulled_bent_carried_step(table: Array, u: Array, base: Array, pull: Pull) -> Step:
    """The same of a body that deforms largely."""
    bent = bent_at(table)
    remember_shape(bent)
    step = _take_carried(table, u, base, pull, bent)
    if step.status == OTHERWISE:
        restore_shape(bent)
    return step


@jit_apart
def take_pulled_free_step(table: Array, u: Array, pull: Pull) -> Step:
    """As `take_pulled_carried_step`, of a free body."""
    return _take_free(table, u, pull, None)


@jit_apart
def take_pulled_bent_free_step(table: Array, u: Array, pull: Pull) -> Step:
    """The same of one that deforms largely."""
    bent = bent_at(table)
    remember_shape(bent)
    step = _take_free(table, u, pull, bent)
    if step.status == OTHERWISE:
        restore_shape(bent)
    return step


@jit_part
def _take_carried(table: Array, u: Array, base: Array, pull: Pull, bent: Bending | None) -> Step:
    """The same; of a linear body it has none."""
    body, loads, state, watch = body_at(table), loads_at(table), state_at(table), watch_at(table)
    h, q = body.h, state.halves[0] * body.inverse_ω
    _begin(pull, bent, u, q, state.halves[1], h)
    begun = begin_carried_step(body, loads, _with_found(pull, u), base, state, bent, None)
    if begun.status == OTHERWISE:
        return NONE_TAKEN
    begun, is_found = _hold_carried(body, loads, begun, u, q, pull, state, bent)
    if not is_found:
        return NONE_TAKEN
    step = end_carried_step(body, loads, begun, base, begun.rate, NOT_PUSHED, state, watch, bent)
    return _end(pull, h, begun.rate, step)


@jit_part
def _hold_carried(
    body: Body, loads: Loads, begun: Begun, u: Array, q: Array, pull: Pull, state: State, bent: Bending | None
) -> tuple[Begun, bool]:
    """Finds forces near r̂ of a carried body, which follows them; and whether sweeps ended.

    Where the base turns A is not symmetric, so that one sweep does not do.
    """
    h, m, r, now, size_before, scale = body.h, len(q), state.halves[1], state.now[0], 0.0, 0.0
    inverse, free, x = inverse_of_carried(body, state), begun.rate, begun.rate.copy()
    acting, modal = begun.acting, begun.modal
    v, ω, start = vector(now, OF_BASE), vector(now, SPIN), modal.copy()
    resting = math.sqrt(dot(r, r) + body.mass * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + body.size**2 * length(ω) ** 2))
    _set_middle(pull, bent)
    spread = _spread(pull, inverse)
    if bent is not None:
        start += bent.vectors[FOLLOWED]
    under = free.copy()  # the forces that are found so far
    for _ in range(PATIENCE):
        before, change = pull.found.copy(), under - x
        if not _find(pull, u, h, under):
            return begun, False
        for k in range(len(before)):
            add_row(spread[k], pull.found[k] - before[k], change)
        acting_on = _with_found(pull, u)
        acting, modal = act_on_carried(h, loads, acting_on, q, begun.R, begun.end, begun.t, state.table, bent)
        pushed = modal - start
        if bent is not None:
            _follow(bent, acting_on)
            pushed += bent.vectors[FOLLOWED]
        under = free + np.dot(inverse, pushed)
        for i in range(m):
            x[i] += change[i]
        size = math.sqrt(dot(change, change))
        scale = max(scale, math.sqrt(dot(x, x)) + resting)
        if has_ended(size, size_before, scale):
            kept = begun.R, begun.end, begun.t, begun.v̂, begun.ω̂, begun.v_end, begun.ω_end
            return Begun(TAKEN, kept[0], kept[1], kept[2], kept[3], kept[4], kept[5], kept[6], acting, modal, x), True
        size_before = size
    return begun, False


@jit_part
def _take_free(table: Array, u: Array, pull: Pull, bent: Bending | None) -> Step:
    """The same of a free body."""
    body, loads, state, watch = body_at(table), loads_at(table), state_at(table), watch_at(table)
    q = state.halves[0] * body.inverse_ω
    _begin(pull, bent, u, q, state.halves[1], body.h)
    begun = begin_free_step(body, loads, _with_found(pull, u), state, bent, None)
    if begun.status == OTHERWISE or not solve(body, loads, begun.acting, q, begun.R, begun.x, state):
        return NONE_TAKEN
    begun, is_found = _hold_free(body, loads, begun, u, pull, state, bent)
    if not is_found:
        return NONE_TAKEN
    step = end_free_step(body, loads, begun, begun.x, NOT_PUSHED, state, watch, bent)
    return _end(pull, body.h, begun.x[3:], step)


@jit_part
def _hold_free(
    body: Body, loads: Loads, begun: BegunFree, u: Array, pull: Pull, state: State, bent: Bending | None
) -> tuple[BegunFree, bool]:
    """Finds forces near ω̂ and r̂ of a free body, which follow them; and whether sweeps ended."""
    h, q, R, x, acting = body.h, begun.q, begun.R, begun.x, begun.acting
    now, table, r, ρ, size_before = state.now[0], state.table, state.halves[1], np.empty(len(begun.x)), 0.0
    moving = math.sqrt(body.mass) * (length(vector(now, VELOCITY)) + h / 2 * length(acting.acceleration))
    scale = 0.0
    _set_middle(pull, bent)
    for sweep in range(PATIENCE):
        before, start = pull.found.copy(), x.copy()
        if sweep > 0:
            lack(body, loads, acting, q, R, x, now, table, ρ)
            correct(body, x, ρ, state)
        spread = _spread(pull, state.slopes)
        if not _find(pull, u, h, x[3:]):
            return begun, False
        for k in range(len(before)):
            add_row(spread[k], pull.found[k] - before[k], x)
        acting_on = _with_found(pull, u)
        acting = act(loads, acting_on, len(q))
        if bent is None:
            give(body, acting.modal, state.halves[0], r, table)
        else:
            acting, strains = pressed_rims(bent, acting_on, q, h, acting), strains_in(bent.memory)
            _follow(bent, acting_on)
            for i in range(len(q)):
                bent.vectors[PULL, i] = strains.pull[i] - bent.vectors[FOLLOWED, i]
            give_without_springs(body, acting.modal, bent.vectors[PULL], r, table)
        size = size_of(weight_of(body), x - start)
        scale = max(scale, speed_at(body, x, state) + moving)
        if has_ended(size, size_before, scale):
            return BegunFree(TAKEN, q, R, acting, x), True
        if sweep >= FEW_SWEEPS and size > SLOW * size_before:
            inertia, L_end = lack(body, loads, acting, q, R, x, now, table, ρ)
            keep_slopes(body, inertia, L_end, x, state)
        size_before = size
    return begun, False


@jit_part
def _begin(pull: Pull, bent: Bending | None, u: Array, q: Array, r: Array, h: float) -> None:
    """Sets the rates of a step of h s from q and r (m,), to the strokes in u (p,)."""
    if bent is not None:
        aim(pull, u, q, r, h)
        return
    given, first = pull.actuators, len(pull.forces) - len(pull.actuators.guides)
    for k in range(len(pull.forces)):
        pull.strokes_before[k] = dot(pull.lines[k], q)
        share, missing = given.share[k], 0.0 if k >= first else u[given.columns[k]] - pull.strokes_before[k]
        pull.targets[k] = share / h * missing + (1 - share) * dot(pull.lines[k], r)
    copy(pull.forces, pull.found)


@jit_part
def _with_found(pull: Pull, u: Array) -> Array:
    """An input (p,) with the forces that are found so far."""
    acting = u.copy()
    for k in range(len(pull.found)):
        acting[pull.actuators.columns[k]] = pull.found[k]
    return acting


@jit_part
def _set_middle(pull: Pull, bent: Bending | None) -> None:
    """Sets what forces do where the shape is expected in the middle of the step."""
    if bent is not None:
        at = strains_in(bent.memory).at
        set_lines(pull, at)
        set_bends(pull, at)


@jit_part
def _follow(bent: Bending, u: Array) -> None:
    """Sets what follows the shape there under u (p,)."""
    followed, strains = bent.vectors[FOLLOWED], strains_in(bent.memory)
    fill(followed, 0.0)
    add_following(bent.loads, u, strains.at, strains.products[0], followed)


@jit_part
def _spread(pull: Pull, inverse: Array) -> Array:
    """What velocities change by with forces (n, any), by inverse slopes whose last are the shape's; W is set."""
    n, m, size = len(pull.forces), pull.lines.shape[1], len(inverse)
    spread, first = np.zeros((n, size)), size - m
    for k in range(n):
        for i in range(size):
            spread[k, i] = dot(inverse[i, first:], pull.lines[k])
    for k in range(n):
        for j in range(n):
            pull.W[k, j] = (dot(pull.lines[k], spread[j, first:]) + dot(pull.lines[j], spread[k, first:])) / 2
        if k >= n - len(pull.actuators.guides):
            pull.W[k, k] += CREEP * pull.W[k, k]
    return spread


@jit_apart
def _find(pull: Pull, u: Array, h: float, v: Array) -> bool:
    """Sets the forces that strokes, gas and guides need near v̂ (m,), which is that under those so far; if there are."""
    given, n, before, outcome = pull.actuators, len(pull.forces), pull.found.copy(), GOES_ON
    search = search_in(pull.search, n)
    for k in range(n):
        search.targets[k], search.rates[k] = pull.targets[k], dot(pull.lines[k], v)
        for j in range(n):
            creeps = j == k and k >= n - len(given.guides)
            search.rates[k] -= pull.W[k, j] / (1 + CREEP if creeps else 1.0) * before[j]
    copy(pull.strokes_before, search.strokes)
    if not begin_search(given, pull.bends, pull.W, u, before, h, search):
        return False
    while outcome == GOES_ON:
        outcome = look(given, pull.bends, u, False, search)
    copy(search.z, pull.found)
    return outcome == ARE_FOUND


@jit_part
def _end(pull: Pull, h: float, v: Array, step: Step) -> Step:
    """A step that was taken with v̂ (m,), with what guides dissipate; its forces are those of the step from now on."""
    if step.status == OTHERWISE:
        return step
    rubbed = 0.0
    copy(pull.found, pull.forces)
    for k in range(len(pull.forces) - len(pull.actuators.guides), len(pull.forces)):
        rubbed += pull.found[k] * dot(pull.lines[k], v)
    return Step(step.status, step.square, step.within, step.supplied - h * rubbed, step.dissipated - h * rubbed)
