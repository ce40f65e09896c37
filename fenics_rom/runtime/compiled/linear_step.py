"""The midpoint step of a linear body among obstacles, whole: `steppers.contact_midpoint`, compiled.

    A v̂ = G u + 2/h r - ω e + Sᵀ f,    e⁺ = e + h ω v̂,    r⁺ = 2 v̂ - r

and beside it what the contact points do beyond the basis (`steppers.residual_motion`). Branches of a material that
relaxes pull beside e, and beside what points do: see `steppers.contact_midpoint`.
"""

import math
from typing import NamedTuple

from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_sums
from fenics_rom.compiled_arrays import unowned
from fenics_rom.mechanics.compiled.contact_law import FOUND, NOTHING, OTHERWISE, Found, Law, Pairs, find_forces
from fenics_rom.mechanics.compiled.copying import copy, fill, largest_of
from fenics_rom.mechanics.compiled.newton import in_one_piece
from fenics_rom.mechanics.compiled.obstacle_motion import Moving, begin_beside, room_beside, turn, turn_too_far
from fenics_rom.mechanics.compiled.searched_forces import room_for_search
from fenics_rom.mechanics.compiled.springs import held_by
from fenics_rom.mechanics.compiled.work_space import release, take, take_rows, taken
from fenics_rom.runtime.compiled.branches import (
    add_pull,
    add_row_of_pull,
    set_force,
    set_forces,
    step_branches,
    stored_in,
)
from fenics_rom.runtime.compiled.linear_actuators import Pulled, end_pull, pull_alone, pull_among, set_given
from fenics_rom.runtime.compiled.near_points import Yielding, find_near_forces
from fenics_rom.runtime.compiled.small_matrices import dot, multiply
from fenics_rom.runtime.compiled.touching import (
    DIAGONAL,
    FORGOTTEN,
    NEGLIGIBLE,
    Begun,
    Clearance,
    StepContact,
    add_up_forces,
    are_all_asked,
    are_left_out,
    ask_points,
    fastest_of,
    forget_pairs,
    go_on,
    is_settled,
    look_near,
    reach_of,
)
from fenics_rom.runtime.compiled.yielding import set_yielding_of, step_beyond


class Body(NamedTuple):
    """A linear body in steps of h s, with m modes, ρ of them rigid, p inputs and P contact points."""

    ω: Array  # (m,), 1/s; 0 of rigid modes
    inverse_ω: Array  # (m,), s; 1 of rigid modes
    inputs: Array  # G (m, p)
    A: Array  # A⁻¹ (m, m)
    heat: Array  # a root of A⁻¹ D A⁻¹ (m, m)
    points: Array  # Sᵀ (m, 3P)
    places: Array  # of the points at rest, (P, 3), m
    W: Array  # the Delassus operator (3P, 3P), with R/a, m/s/N; (3P, 0) where R is by blocks
    inverse: Array  # of W, (0, 0) where there is none that tells forces apart
    R: Array  # residual compliance (3P, 3P), m/N; (0, 0) where there is none, (3P, 0) where it is by blocks
    yielding: Yielding  # R by blocks
    branches: Array  # coefficients of a step of N branches, (8, N), as in `branches`
    share: Array  # P (m, m) of `MaxwellBranches`; (0, 0) where forces of branches are their strains
    inertia: float  # 2τ²/h, s, of what carries a force beyond the basis
    whole: float  # a, s
    lost: float  # β + (θ - ½) h, s
    τ: float  # s
    pulled: Pulled  # by what is found: strokes, and guides that rub


PARTS = 6  # of a State, before those that note them


class State(NamedTuple):
    """What a step changes."""

    halves: Array  # e and r, (2, m)
    rigid: Array  # displacements (ρ,)
    beyond: Array  # g, y and their rates, (4, 3P)
    relaxed: Array  # strains of branches in energy coordinates, and their forces, (N, 2, m)
    relaxed_beyond: Array  # those beyond the basis, (N, 2, 3P)
    reactions: Array  # forces that were found (n,)
    halves_before: Array  # the same before the step
    rigid_before: Array
    beyond_before: Array
    relaxed_before: Array
    relaxed_beyond_before: Array
    reactions_before: Array


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
    holding: float  # Σ 2^k of strokes and guides k that held points back as contact was found


NOT_TAKEN = Step(OTHERWISE, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@jit_part
def room_for(body: Body, moving: Moving) -> int:
    """Numbers of the work space that a step among such obstacles takes."""
    P, n = len(body.places), len(body.pulled.W)
    of_found = room_for_search(n) + len(body.ω) + body.inputs.shape[1] + n + 4 if n > 0 else 0
    return 4 + 8 * len(body.ω) + 12 * P + room_beside(moving, len(moving.start) * P) + of_found


@jit_apart
def step_in(
    space: Array,
    body: Body,
    law: Law,
    shapes: Array,
    u: Array,
    moving: Moving,
    begun: Begun,
    state: State,
    found: StepContact,
    clearance: Clearance,
) -> Step:
    """Takes a step.

    Args:
        space: with `room_for` the step.
        body, law: of it.
        shapes: of the obstacles, (O, 17).
        u: the input (p,).
        moving: how the obstacles do.
        begun: what the step begins with.
        state: changed.
        found: set, but for what pairs would be asked where obstacles are known to be out of reach.
        clearance: what is known of that; changed.
    """
    space, body, shapes, u = unowned(space), unowned(body), unowned(shapes), unowned(u)
    moving, begun, state = unowned(moving), unowned(begun), unowned(state)
    found, clearance = unowned(found), unowned(clearance)
    pairs, _, motion, forces = found
    h, m, P = law.h, len(body.ω), len(body.places)
    e, r, ρ = state.halves[0], state.halves[1], len(state.rigid)
    yields, relaxes, by_blocks = len(body.R) > 0, len(state.relaxed) > 0, len(body.yielding.slots) > 0
    pushed, right, v, q = take(space, m), take(space, m), take(space, m), take(space, m)
    by_contact, heat, beside = take(space, m), take(space, m), begin_beside(moving, h, len(pairs.forces), space)
    rate, stress = take(space, m), take(space, m)
    pull = take_rows(space, 2 if relaxes and yields else 0, 3 * P)
    pulled, n = body.pulled, len(state.reactions)
    given = take(space, len(u)) if n > 0 else u
    if n > 0:
        set_given(pulled, u, given)
    _push(body.inputs, given, pushed)
    for i in range(m):
        right[i] = pushed[i] + 2 / h * r[i] - body.ω[i] * e[i]
        q[i] = state.rigid[i] if i < ρ else e[i] * body.inverse_ω[i]
    if relaxes:
        _draw_back(body, state, right, stress, pull)
    multiply(body.A, right, v)
    numbers, free, z = take(space, room_for_search(n) if n > 0 else 0), take(space, m * (n > 0)), take(space, n)
    rubbed, told = rate, take(space, 4)
    if n > 0:
        copy(v, free)
        if not pull_alone(pulled, h, u, q, r, free, state.reactions, numbers, z, v):
            return NOT_TAKEN
    fill(told, 0.0)
    contact, going = Found(NOTHING, 0, 0.0), (r, v, state.beyond, pull, beside)
    reach = reach_of(clearance, body.inertia, body.whole, h, *going)
    by_obstacles = power = 0.0
    is_clear, farthest, begun_with = not turn(moving) and _is_beyond(clearance, reach), math.inf, taken(space)
    if not is_clear and turn_too_far(moving):
        return NOT_TAKEN
    if n == 0 and len(clearance.pairs) > 0 and not turn(moving):
        farthest = 2 * reach
    for _ in range(0 if is_clear else 2):
        look_near(body, shapes, moving, h, beside, q, state.beyond, clearance, farthest, found, space)
        release(space, begun_with)
        if turn(moving):  # as velocities of pairs are known then
            reach = reach_of(clearance, body.inertia, body.whole, h, *going)
        clearance.gap[0] = _smallest_of(found.gaps)
        is_clear = _is_beyond(clearance, reach)
        if is_clear and farthest == math.inf:
            if by_blocks:  # which is compiled then, before something touches
                forget_pairs(pairs)
                _find_by_blocks(law, body, ρ, begun.swung, pairs, forces, by_contact, motion[3], told)
            break
        if is_clear:  # by bounds of most pairs: where all are measured, it lasts longer
            farthest = math.inf
            continue
        copy(begun.forces, pairs.forces)
        fastest = 0.0
        if n > 0:
            acting, at_points = (u, r, free, state.reactions), (beside, begun, state.beyond, pull)
            if not pull_among(pulled, body, law, *acting, *at_points, numbers, space, z, v, found, told):
                return NOT_TAKEN
            contact = Found(int(told[0]), int(told[1]), told[2])
        else:
            ask_points(body, law, beside, pairs.forces, r, v, state.beyond, pull, found, farthest, space)
            if by_blocks:
                _find_by_blocks(law, body, ρ, begun.swung, pairs, forces, by_contact, motion[3], told)
                contact = Found(int(told[0]), int(told[1]), told[2])
                fastest = told[3] + DIAGONAL * largest_of(motion[3]) / body.whole
            else:
                contact = find_forces(law, body.W, in_one_piece(body.inverse), P, begun.swung, pairs)
        contact = held_by(law, found.gaps, pairs, contact)
        by_obstacles = add_up_forces(contact, beside.w, found)
        if contact.status != FOUND or are_all_asked(farthest, found):
            break
        if not by_blocks:
            fastest = fastest_of(body.W, forces, space)
        if are_left_out(fastest, h, reach, farthest, found):
            break
        farthest = math.inf
    if is_clear:
        forget_pairs(pairs)
        fill(forces, 0.0)
    if contact.status == OTHERWISE:
        return NOT_TAKEN
    _remember(state, is_settled(clearance.still))
    if n > 0:
        copy(z, state.reactions)
        end_pull(pulled, state.reactions, pushed, right, rubbed)
    if contact.status == FOUND:
        if not by_blocks:
            multiply(body.points, forces, by_contact)
        for i in range(m):
            right[i] += by_contact[i]
    if contact.status == FOUND or n > 0:
        multiply(body.A, right, v)
        power = dot(by_contact, v) if contact.status == FOUND else 0.0
    multiply(body.heat, right, heat)
    supplied, dissipated = h * dot(pushed, v), h * dot(heat, heat)
    if n > 0:
        dissipated -= h * dot(rubbed, v)
    stored = in_branches = 0.0
    if relaxes:
        for i in range(m):
            rate[i] = body.ω[i] * v[i]
        set_force(body.share, rate, stress)
        dissipated += _relax(body.branches, state.relaxed, rate, stress)
        in_branches = _twice_stored(body.branches, state.relaxed)
    touches = contact.status == FOUND
    is_still = not touches and (is_settled(clearance.still) or _is_at_rest(state))
    clearance.still[0] = clearance.still[0] + 1 if is_still else 0.0
    if yields and is_still:
        fill(motion[3], 0.0)
    elif yields:
        if not touches:
            fill(motion[3], 0.0)
        elif not by_blocks:
            set_yielding_of(body.R, forces, motion[3])
        lost, power_beyond, stored = step_beyond(body, h, state.beyond, pull, forces, motion[3], space)
        dissipated, power = dissipated + lost, power + power_beyond
        if relaxes:
            dissipated += _relax(body.branches, state.relaxed_beyond, pull[0], pull[1])
            stored += _twice_stored(body.branches, state.relaxed_beyond)
        if contact.status == NOTHING and stored < max(2 * FORGOTTEN, NEGLIGIBLE * (dot(e, e) + dot(r, r))):
            fill(state.beyond, 0.0)
            fill(state.relaxed_beyond, 0.0)
            stored = 0.0
    for i in range(m):
        e[i] += h * body.ω[i] * v[i]
        r[i] = 2 * v[i] - r[i]
    for i in range(ρ):
        state.rigid[i] += h * v[i]
    go_on(clearance, h, v, motion[3], beside.w)
    if turn(moving):  # how fast it will be where the points are nobody knows
        clearance.gap[0] = 0.0
    whole = power - by_obstacles
    normal = contact.normal_power if law.friction > 0 else whole
    square = dot(e, e) + dot(r, r) + stored + in_branches
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
        told[3] if n > 0 else 0.0,
    )


@jit_apart
def _draw_back(body: Body, state: State, right: Array, stress: Array, pull: Array) -> None:
    """Adds to a right-hand side (m,) what branches do; stress (m,) and pull (2, 3P) or (0, 3P), beyond, are set."""
    set_forces(body.share, state.relaxed)
    fill(stress, 0.0)
    add_pull(body.branches, state.relaxed, stress)
    for i in range(len(right)):
        right[i] -= body.ω[i] * stress[i]
    for row in range(len(pull)):
        fill(pull[row], 0.0)
        add_row_of_pull(body.branches, state.relaxed_beyond, row, pull[row])


@jit_apart
def _relax(numbers: Array, branches: Array, rate: Array, stress: Array) -> float:
    """As `step_branches`."""
    return step_branches(numbers, branches, rate, stress)


@jit_apart
def _twice_stored(numbers: Array, branches: Array) -> float:
    """The energy in branches, twice, J."""
    return 2 * stored_in(numbers, branches)


@jit_apart
def _find_by_blocks(
    law: Law, body: Body, ρ: int, swung: Array, pairs: Pairs, f: Array, by_contact: Array, rates: Array, told: Array
) -> None:
    """As `find_near_forces`; told: (4,) set, status, sweeps, power of contact and what is fastest."""
    of_body = body.points, body.inverse_ω, ρ, body.whole, body.yielding
    near = find_near_forces(law, *of_body, swung, pairs, f, by_contact, rates)
    told[0], told[1], told[2], told[3] = near.status, near.sweeps, near.normal_power, near.fastest


@jit_part
def _push(inputs: Array, u: Array, into: Array) -> None:
    """Sets G u; of an input most of whose numbers are 0 by the columns of the others."""
    acting = 0
    for k in range(len(u)):
        acting += u[k] != 0.0
    if 4 * acting > len(u):
        multiply(inputs, u, into)
        return
    fill(into, 0.0)
    for k in range(len(u)):
        if u[k] != 0.0:
            for i in range(len(into)):
                into[i] += inputs[i, k] * u[k]


@jit_sums
def _smallest_of(numbers: Array) -> float:
    smallest = math.inf
    for k in range(len(numbers)):
        smallest = numbers[k] if numbers[k] < smallest else smallest
    return smallest


@jit_part
def _is_beyond(clearance: Clearance, reach: float) -> bool:
    """Whether all pairs are known to be farther apart than what they reach, m."""
    return clearance.gap[0] > 0.0 and clearance.gap[0] > reach


@jit_part
def _is_at_rest(state: State) -> bool:
    """Whether nothing is carried beyond the basis."""
    return largest_of(state.beyond) == 0.0 and largest_of(state.relaxed_beyond) == 0.0


@jit_part
def _remember(state: State, is_still: bool) -> None:
    """Notes what is there before a step; is_still: nothing is, nor was, carried beyond the basis."""
    copy(state.halves, state.halves_before)
    copy(state.rigid, state.rigid_before)
    copy(state.relaxed, state.relaxed_before)
    copy(state.reactions, state.reactions_before)
    if not is_still:
        copy(state.beyond, state.beyond_before)
        copy(state.relaxed_beyond, state.relaxed_beyond_before)


@jit_part
def restore(state: State) -> None:
    """Puts a body where it was before the last step."""
    copy(state.halves_before, state.halves)
    copy(state.rigid_before, state.rigid)
    copy(state.beyond_before, state.beyond)
    copy(state.relaxed_before, state.relaxed)
    copy(state.relaxed_beyond_before, state.relaxed_beyond)
    copy(state.reactions_before, state.reactions)
