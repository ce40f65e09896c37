"""How rigid bodies answer forces of contact, all at once: `world.rigid`, where no joint holds them."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit, jit_shared
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


@jit
def _row(values: Array) -> tuple[float, float, float]:
    return values[0], values[1], values[2]


@jit
def _rows(matrix: Array) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    return _row(matrix[0]), _row(matrix[1]), _row(matrix[2])


@jit
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


@jit
def _arm(bodies: RigidBodies, h: float, tries: Array, b: int, place: Array) -> tuple[float, float, float]:
    """Of a place from the centre of mass of a body in the middle of the step."""
    return _added(_added(_row(place), -1.0, _row(bodies.motion[b, 0])), -h / 2, _row(tries[b, 2]))


@jit
def add_answers(bodies: RigidBodies, h: float, ends: Array, places: Array, tries: Array, Wᵀ: Array) -> None:
    """Adds how these bodies answer to the operator of all pairs (3C, 3C), transposed; arguments as in `attempt`."""
    C, answers, pushed = len(ends), np.zeros((6, 6)), np.empty(6)
    for b in range(len(tries)):
        given = bodies.mass[b], _rows(bodies.inertia[b]), _rows(bodies.rotation[b])
        found = _answers_to(h, *given, _row(tries[b, 0]), _row(tries[b, 1]), _row(tries[b, 3]))
        _set(answers[:3, :3], found.moving)
        _set(answers[3:, 3:], found.turning)
        _set(answers[3:, :3], found.levered)
        maps = np.zeros((6, 3 * C))  # what v̂ and R ω̂ move pairs by
        for c in range(C):
            if ends[c, 0] == b or ends[c, 1] == b:
                sign, (x, y, z), at = 1.0 if ends[c, 0] == b else -1.0, _arm(bodies, h, tries, b, places[c]), 3 * c
                maps[0, at] = maps[1, at + 1] = maps[2, at + 2] = sign
                maps[4, at], maps[5, at], maps[5, at + 1] = sign * z, -sign * y, sign * x
                maps[3, at + 1], maps[3, at + 2], maps[4, at + 2] = -sign * z, sign * y, -sign * x
        v_x, v_y, v_z, ω_x, ω_y, ω_z = maps[0], maps[1], maps[2], maps[3], maps[4], maps[5]
        for row in range(3 * C):
            if ends[row // 3, 0] != b and ends[row // 3, 1] != b:
                continue
            for m in range(6):
                pushed[m] = 0.0
                for k in range(6):
                    pushed[m] += answers[m, k] * maps[k, row]
            a, b_, c_, d, e, g = pushed[0], pushed[1], pushed[2], pushed[3], pushed[4], pushed[5]
            to = Wᵀ[row]
            for j in range(3 * C):
                to[j] += a * v_x[j] + b_ * v_y[j] + c_ * v_z[j] + d * ω_x[j] + e * ω_y[j] + g * ω_z[j]


@jit
def _set(
    block: Array, rows: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
) -> None:
    for i in range(3):
        for k in range(3):
            block[i, k] = rows[i][k]
