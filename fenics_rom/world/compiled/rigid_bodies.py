"""How rigid bodies answer forces of contact, all at once: `world.rigid`, where no joint holds them."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part, jit_shared
from fenics_rom.mechanics.compiled.newton import solve
from fenics_rom.mechanics.frame_motion import added, cross, rotated
from fenics_rom.world import turning

_find_turning, _answers_to = jit_shared(turning.find_turning), jit_shared(turning.answers_to)
_added, _cross, _rotated = map(jit_shared, (added, cross, rotated))


class RigidBodies(NamedTuple):
    """B of them, as they begin a step of h s."""

    mass: Array  # (B,), kg
    inertia: Array  # (B, 3, 3) in their axes, kg m²
    rotation: Array  # R (B, 3, 3) of these
    motion: Array  # (B, 3, 3): p, m, v, m/s, and ω in their axes, rad/s
    loads: Array  # (B, 2, 3): acceleration, m/s², and torque, N m, but for contact


@jit_part
def _row(values: Array) -> tuple[float, float, float]:
    return values[0], values[1], values[2]


@jit_part
def _rows(matrix: Array) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    return _row(matrix[0]), _row(matrix[1]), _row(matrix[2])


@jit_part
def attempt(bodies: RigidBodies, h: float, ends: Array, places: Array, f: Array, tries: Array, u: Array) -> float:
    """Tries forces: the fastest that a point of a pair moves, m/s; not a number where no step is found.

    Args:
        bodies: those.
        h: s.
        ends: (C, 2) numbers of the first and second body of a pair; -1 of others.
        places: of pairs in the middle of the step, (C, 3), m.
        f: forces on the first bodies, (C, 3), N.
        tries: (B, 4, 3) set to the force of contact, N, the whole torque, N m, v̂, m/s, and ω̂, rad/s, of each.
        u: (C, 3), to which velocities of these bodies are added, m/s.
    """
    tries[:] = 0.0
    fastest = 0.0
    for c in range(len(f)):
        for side in range(2):
            if ends[c, side] >= 0:
                for k in range(3):
                    tries[ends[c, side], 0, k] += f[c, k] if side == 0 else -f[c, k]
    for b in range(len(tries)):
        for k in range(3):
            by_force = tries[b, 0, k] / bodies.mass[b] + bodies.loads[b, 0, k]
            tries[b, 2, k] = bodies.motion[b, 1, k] + h / 2 * by_force
            tries[b, 1, k] = bodies.loads[b, 1, k]
    for c in range(len(f)):
        for side in range(2):
            b = ends[c, side]
            if b >= 0:
                arm = _arm(bodies, h, tries, b, places[c])
                moment = _cross(arm, _row(f[c]))
                for k in range(3):
                    tries[b, 1, k] += moment[k] if side == 0 else -moment[k]
    spins = np.empty((len(tries), 3))
    for b in range(len(tries)):
        R = _rows(bodies.rotation[b])
        given = _rows(bodies.inertia[b]), R, _row(bodies.motion[b, 2]), _row(tries[b, 1]), turning.NONE, 0.0
        ω̂, _, _, left = _find_turning(h, *given)
        if left != 0.0:
            return np.nan
        spin = _rotated(R, ω̂)
        for k in range(3):
            tries[b, 3, k], spins[b, k] = ω̂[k], spin[k]
    for c in range(len(f)):
        for side in range(2):
            b = ends[c, side]
            if b >= 0:
                moving = _added(_row(tries[b, 2]), 1.0, _cross(_row(spins[b]), _arm(bodies, h, tries, b, places[c])))
                for k in range(3):
                    u[c, k] += moving[k] if side == 0 else -moving[k]
                    fastest = max(fastest, abs(moving[k]))
    return fastest


@jit_part
def _arm(bodies: RigidBodies, h: float, tries: Array, b: int, place: Array) -> tuple[float, float, float]:
    """Of a place from the centre of mass of a body in the middle of the step."""
    return _added(_added(_row(place), -1.0, _row(bodies.motion[b, 0])), -h / 2, _row(tries[b, 2]))


@jit_part
def look_at_answers(
    bodies: RigidBodies, h: float, ends: Array, places: Array, tries: Array, maps: Array, answers: Array
) -> None:
    """Sets how these bodies answer more forces: (v̂, R ω̂) per force and torque; other arguments as in `attempt`.

    Args:
        maps: (B, 6, 3C): what v̂ and R ω̂ move pairs by.
        answers: (B, 6, 6).
    """
    maps[:] = answers[:] = 0.0
    for b in range(len(tries)):
        given = bodies.mass[b], _rows(bodies.inertia[b]), _rows(bodies.rotation[b])
        found, of_body = _answers_to(h, *given, _row(tries[b, 0]), _row(tries[b, 1]), _row(tries[b, 3])), maps[b]
        _set(answers[b, :3, :3], found.moving)
        _set(answers[b, 3:, 3:], found.turning)
        _set(answers[b, 3:, :3], found.levered)
        for c in range(len(ends)):
            if ends[c, 0] == b or ends[c, 1] == b:
                sign, (x, y, z), at = 1.0 if ends[c, 0] == b else -1.0, _arm(bodies, h, tries, b, places[c]), 3 * c
                of_body[0, at] = of_body[1, at + 1] = of_body[2, at + 2] = sign
                of_body[4, at], of_body[5, at], of_body[5, at + 1] = sign * z, -sign * y, sign * x
                of_body[3, at + 1], of_body[3, at + 2], of_body[4, at + 2] = -sign * z, sign * y, -sign * x


@jit_part
def add_answers(maps: Array, answers: Array, Wᵀ: Array) -> None:
    """Adds these to the operator of all pairs (3C, 3C), transposed: W + Σ M A Mᵀ with maps Mᵀ."""
    for b in range(len(maps)):
        of_body = np.dot(np.ascontiguousarray(maps[b].T), np.dot(np.ascontiguousarray(answers[b].T), maps[b]))
        for row in range(len(Wᵀ)):
            to, of = Wᵀ[row], of_body[row]
            for j in range(len(to)):
                to[j] += of[j]


@jit_part
def set_inverse(inverse: Array, maps: Array, answers: Array, whole: Array) -> bool:
    """Sets the inverse of (W + Σ M A Mᵀ)ᵀ, from that of a symmetric W (Woodbury); whether there is one.

    W⁻¹ - W⁻¹ M (A⁻ᵀ + Mᵀ W⁻¹ M)⁻¹ Mᵀ W⁻¹
    """
    n = 6 * len(maps)
    of_all, small = maps.reshape(n, len(inverse)), np.zeros((n, n))
    for b in range(len(maps)):
        for m in range(6):
            for k in range(6):
                small[6 * b + m, 6 * b + k] = answers[b, k, m]
    if not _invert(small):
        return False
    moved = np.dot(of_all, inverse)
    small += np.dot(moved, np.ascontiguousarray(of_all.T))
    if not _invert(small):
        return False
    gone = np.dot(np.ascontiguousarray(moved.T), np.dot(small, moved))
    for row in range(len(inverse)):
        to, of, less = whole[row], inverse[row], gone[row]
        for k in range(len(to)):
            to[k] = of[k] - less[k]
    return True


@jit_part
def _invert(matrix: Array) -> bool:
    """Inverts a small matrix (n, n) in place; whether it has an inverse."""
    n = len(matrix)
    inverse = np.empty((n, n))
    for k in range(n):
        inverse[k] = 0.0
        inverse[k, k] = 1.0
        if not solve(matrix.copy(), inverse[k], n):
            return False
    for i in range(n):
        for k in range(n):
            matrix[i, k] = inverse[k, i]
    return True


@jit_part
def _set(
    block: Array, rows: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
) -> None:
    for i in range(3):
        for k in range(3):
            block[i, k] = rows[i][k]
