"""How rigid bodies answer forces of contacts and joints, all at once: `world.rigid`."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.mechanics.compiled.copying import add_row, copy, fill, largest_of
from fenics_rom.mechanics.compiled.newton import Inverse, in_one_piece
from fenics_rom.mechanics.frame_motion import Rotation, Vector, added, cross, rotated
from fenics_rom.world import turning

_find_turning, _answers_to = jit_shared(turning.find_turning), jit_shared(turning.answers_to)
_mean_rotation = jit_shared(turning.mean_rotation)
_added, _cross, _rotated = map(jit_shared, (added, cross, rotated))
NO_SHARE = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class RigidBodies(NamedTuple):
    """B of them, as they begin a step of h s."""

    mass: Array  # (B,), kg
    inertia: Array  # (B, 3, 3) in their axes, kg m²
    rotation: Array  # R (B, 3, 3) of these
    motion: Array  # (B, 3, 3): p, m, v, m/s, and ω in their axes, rad/s
    loads: Array  # (B, 2, 3): acceleration, m/s², and torque, N m, but for contact


@jit_part
def _row(values: Array) -> Vector:
    return values[0], values[1], values[2]


@jit_part
def rows_of(matrix: Array) -> Rotation:
    """Rows of a matrix (3, 3)."""
    return _row(matrix[0]), _row(matrix[1]), _row(matrix[2])


class Pushed(NamedTuple):
    """Where these bodies are pushed: at C contacts, then at points of joints, n in all."""

    C: int
    ends: Array  # (n, 2) numbers of the first and second body of a pair; -1 of others
    places: Array  # (n, 3) in the middle of the step, m; of contacts
    arms: Array  # (n, 2, 3) of points of joints on either body, in its axes from its centre of mass, m
    inverse: Array  # of inertias (B, 3, 3), 1/(kg m²)
    are_couples: Array  # (n,) of pairs that stand for how bodies turn
    slides: Array  # pairs of joints where the first body is pushed where the point of the second one is
    order: Array  # (B,) in which bodies are tried: second ones of these before first ones


@jit_part
def attempt(bodies: RigidBodies, h: float, pushed: Pushed, f: Array, tries: Array, u: Array) -> float:
    """Tries forces: the fastest that a point of a pair moves, m/s; not a number where no step is found.

    Args:
        bodies: those.
        h: s.
        pushed: where.
        f: forces on the first bodies, (n, 3), N.
        tries: (B, 4, 3) set to the force of all pairs, N, the whole torque, N m, v̂, m/s, and ω̂, rad/s, of each.
        u: (n, 3), to which velocities of these bodies are added, m/s.
    """
    fill(tries, 0.0)
    C, ends, places, arms, couples = pushed.C, pushed.ends, pushed.places, pushed.arms, pushed.are_couples
    fastest, B, n, are_slides = 0.0, len(tries), len(f), np.zeros(len(f), dtype=np.bool_)
    for c in pushed.slides:
        are_slides[c] = True
    for c in range(n):
        for side in range(2):
            if ends[c, side] >= 0 and not couples[c]:
                for k in range(3):
                    tries[ends[c, side], 0, k] += f[c, k] if side == 0 else -f[c, k]
    for b in range(B):
        for k in range(3):
            by_force = tries[b, 0, k] / bodies.mass[b] + bodies.loads[b, 0, k]
            tries[b, 2, k] = bodies.motion[b, 1, k] + h / 2 * by_force
            tries[b, 1, k] = bodies.loads[b, 1, k]
    for c in range(C):
        for side in range(2):
            if ends[c, side] >= 0:
                _push_at(bodies, h, tries, ends[c, side], places[c], f[c], 1.0 - 2 * side)
    for c in pushed.slides:
        if ends[c, 1] < 0 and ends[c, 0] >= 0:
            _push_at(bodies, h, tries, ends[c, 0], places[c], f[c], 1.0)
    held, spins, means = np.zeros((B, 3, 3)), np.empty((B, 3)), np.empty((B if n > C else 0, 3, 3))
    for c in range(C, n):
        for side in range(2):
            if ends[c, side] >= 0 and not (are_slides[c] and side == 0):
                moment, arm = held[ends[c, side]], arms[c, side]
                for i in range(3):
                    if couples[c]:
                        tries[ends[c, side], 1, i] += (1.0 - 2 * side) * f[c, i]
                    for k in range(0 if couples[c] else 3):
                        moment[i, k] += (1.0 - 2 * side) * arm[i] * f[c, k]
    for b in pushed.order:
        R, forced = rows_of(bodies.rotation[b]), 0.0
        if n > C:
            forced = h * largest_of(pushed.inverse[b]) * largest_of(held[b])
        given = rows_of(bodies.inertia[b]), R, _row(bodies.motion[b, 2]), _row(tries[b, 1]), rows_of(held[b]), forced
        ω̂, whole, middle, left = _find_turning(h, *given)
        if left != 0.0:
            return np.nan
        if n > C:
            _set(means[b], middle if forced != 0.0 else _mean_rotation(R, h, ω̂))
        spin = _rotated(R, ω̂)
        for k in range(3):
            tries[b, 1, k], tries[b, 3, k], spins[b, k] = whole[k], ω̂[k], spin[k]
        for c in pushed.slides:
            if ends[c, 1] == b:
                middle = _added(_row(bodies.motion[b, 0]), h / 2, _row(tries[b, 2]))
                x, y, z = _added(middle, 1.0, _turned(means, b, arms[c, 1]))
                places[c, 0], places[c, 1], places[c, 2] = x, y, z
                if ends[c, 0] >= 0:
                    _push_at(bodies, h, tries, ends[c, 0], places[c], f[c], 1.0)
    for c in range(n):
        for side in range(2):
            b = ends[c, side]
            if b >= 0:
                is_held = c >= C and not (are_slides[c] and side == 0)
                arm = _turned(means, b, arms[c, side]) if is_held else _arm(bodies, h, tries, b, places[c])
                moving = _added(_row(tries[b, 2]), 1.0, _cross(_row(spins[b]), arm))
                if couples[c]:
                    moving = _row(spins[b])
                for k in range(3):
                    u[c, k] += moving[k] if side == 0 else -moving[k]
                    fastest = max(fastest, abs(moving[k]))
    return fastest


@jit_part
def _turned(rotations: Array, b: int, arm: Array) -> tuple[float, float, float]:
    return _rotated(rows_of(rotations[b]), _row(arm))


@jit_part
def _push_at(bodies: RigidBodies, h: float, tries: Array, b: int, place: Array, f: Array, sign: float) -> None:
    """Adds the torque of a force at a place on a body."""
    moment = _cross(_arm(bodies, h, tries, b, place), _row(f))
    for k in range(3):
        tries[b, 1, k] += sign * moment[k]


@jit_part
def _arm(bodies: RigidBodies, h: float, tries: Array, b: int, place: Array) -> tuple[float, float, float]:
    """Of a place from the centre of mass of a body in the middle of the step."""
    return _added(_added(_row(place), -1.0, _row(bodies.motion[b, 0])), -h / 2, _row(tries[b, 2]))


@jit_part
def look_at_answers(bodies: RigidBodies, h: float, pushed: Pushed, tries: Array, maps: Array, answers: Array) -> None:
    """Sets how these bodies answer more forces: (v̂, R ω̂) per force and torque; other arguments as in `attempt`.

    Args:
        maps: (B, 6, 3n): what v̂ and R ω̂ move pairs by.
        answers: (B, 6, 6). Forces of joints go with the body: they have no part of what those turn it by that stay.
    """
    fill(maps, 0.0)
    fill(answers, 0.0)
    ends, C = pushed.ends, pushed.C
    for b in range(len(tries)):
        given = bodies.mass[b], rows_of(bodies.inertia[b]), rows_of(bodies.rotation[b])
        found, of_body = _answers_to(h, *given, _row(tries[b, 0]), _row(tries[b, 1]), _row(tries[b, 3])), maps[b]
        _set(answers[b, :3, :3], found.moving)
        _set(answers[b, 3:, 3:], found.turning)
        _set(answers[b, 3:, :3], found.levered)
        for c in range(len(ends)):
            for side in range(2):
                if ends[c, side] == b:
                    of_joint = _turned(bodies.rotation, b, pushed.arms[c, side])
                    arm = of_joint if c >= C else _arm(bodies, h, tries, b, pushed.places[c])
                    if pushed.are_couples[c]:
                        set_map_of_couple(of_body, 3 * c, 1.0 - 2 * side)
                    else:
                        set_map(of_body, 3 * c, 1.0 - 2 * side, arm)


@jit_part
def set_map(of_body: Array, at: int, sign: float, arm: tuple[float, float, float]) -> None:
    """Sets what a body's velocity and turning (6,) move a pair at an arm by."""
    x, y, z = arm
    of_body[0, at] = of_body[1, at + 1] = of_body[2, at + 2] = sign
    of_body[4, at], of_body[5, at], of_body[5, at + 1] = sign * z, -sign * y, sign * x
    of_body[3, at + 1], of_body[3, at + 2], of_body[4, at + 2] = -sign * z, sign * y, -sign * x


@jit_part
def set_map_of_couple(of_body: Array, at: int, sign: float) -> None:
    """The same of a pair that stands for how the body turns."""
    of_body[3, at] = of_body[4, at + 1] = of_body[5, at + 2] = sign


@jit_part
def add_answers(maps: Array, answers: Array, C: int, of_others: Array, Wᵀ: Array) -> None:
    """Sets the operator of all pairs (3n, 3n), transposed, to that of others and that of these bodies, Σ M A Mᵀ.

    maps: Mᵀ; the first C pairs are contacts.
    """
    for row in range(len(Wᵀ)):
        to, of = Wᵀ[row], of_others[row]
        for b in range(len(maps)):
            M, share = maps[b], _share_of(maps[b], answers[b], row, row < 3 * C)
            if share != NO_SHARE:
                (x, y, z), (u, v, w) = share
                one, two, three, four, five, six = M[0], M[1], M[2], M[3], M[4], M[5]
                for j in range(len(to)):
                    moving = x * one[j] + y * two[j] + z * three[j]
                    to[j] = of[j] + (moving + u * four[j] + v * five[j] + w * six[j])
                of = to
        copy(of, to)  # where no body has added to it


@jit_part
def _share_of(
    of_body: Array, answer: Array, row: int, stays: bool
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """What a body answers the force of a row with: (v̂, R ω̂) of maps; whether the force stays where it is."""
    is_moved = False
    for k in range(6):
        is_moved = is_moved or of_body[k, row] != 0.0
    if not is_moved:
        return NO_SHARE
    a, b, c, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(6):
        by = of_body[k, row]
        a, b, c = a + answer[0, k] * by, b + answer[1, k] * by, c + answer[2, k] * by
        if stays or k >= 3:
            u, v, w = u + answer[3, k] * by, v + answer[4, k] * by, w + answer[5, k] * by
    return (a, b, c), (u, v, w)


@jit_part
def take_back(maps: Array, answers: Array, C: int, f: Array, u: Array) -> None:
    """Takes from velocities (n, 3) what these bodies answer forces (n, 3) with by `answers`; C as of `add_answers`."""
    for b in range(len(maps)):
        of_body, answer = maps[b], answers[b]
        pushed, moving = np.zeros((2, 6)), np.zeros(6)
        for k in range(6):
            row = of_body[k]
            for c in range(len(f)):
                by = row[3 * c] * f[c, 0] + row[3 * c + 1] * f[c, 1] + row[3 * c + 2] * f[c, 2]
                pushed[0 if c < C else 1, k] += by
        for k in range(6):
            for m in range(6):
                moving[k] += answer[k, m] * (pushed[0, m] + (pushed[1, m] if k < 3 or m >= 3 else 0.0))
        for k in range(6):
            row = of_body[k]
            for c in range(len(f)):
                for n in range(3):
                    u[c, n] -= row[3 * c + n] * moving[k]


@jit_part
def inverse_with(inverse: Array, maps: Array, answers: Array) -> Inverse:
    """The inverse of (W + Σ M A Mᵀ)ᵀ, from that of a symmetric W (Woodbury); (0, 0) where there is none.

    W⁻¹ - W⁻¹ M (1 + Aᵀ Mᵀ W⁻¹ M)⁻¹ Aᵀ Mᵀ W⁻¹
    """
    n, k = len(inverse), 6 * len(maps)
    of_all = maps.reshape(k, n)
    moved = np.dot(of_all, inverse)
    within, right, small = np.dot(moved, of_all.T), np.zeros((k, n)), np.zeros((k, k))
    for b in range(len(maps)):
        for m in range(6):
            for i in range(6):
                share, of = answers[b, i, m], 6 * b + i
                add_row(moved[of], share, right[6 * b + m])
                add_row(within[of], share, small[6 * b + m])
            small[6 * b + m, 6 * b + m] += 1.0
    if not _solve_rows(small, right):
        return in_one_piece(np.empty((0, 0)))
    return Inverse(inverse, moved, right)


@jit_part
def _solve_rows(matrix: Array, rows: Array) -> bool:
    """Solves equations (k, k) of rows (k, n) by elimination with pivots, in place; False where they are singular."""
    k = len(matrix)
    for i in range(k):
        pivot = i
        for j in range(i + 1, k):
            if abs(matrix[j, i]) > abs(matrix[pivot, i]):
                pivot = j
        if matrix[pivot, i] == 0.0:
            return False
        if pivot != i:
            _swap(matrix[i], matrix[pivot])
            _swap(rows[i], rows[pivot])
        for j in range(i + 1, k):
            share = -matrix[j, i] / matrix[i, i]
            add_row(matrix[i], share, matrix[j])
            add_row(rows[i], share, rows[j])
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            add_row(rows[j], -matrix[i, j], rows[i])
        whole, row = 1 / matrix[i, i], rows[i]
        for j in range(len(row)):
            row[j] *= whole
    return True


@jit_part
def _swap(one: Array, other: Array) -> None:
    for k in range(len(one)):
        one[k], other[k] = other[k], one[k]


@jit_part
def _set(
    block: Array, rows: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
) -> None:
    for i in range(3):
        for k in range(3):
            block[i, k] = rows[i][k]
