"""What pairs have to do with bodies in a step with rows of joints: how forces there move all pairs."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_apart, jit_part, jit_shared
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.mechanics.frame_motion import Rotation, Vector
from fenics_rom.runtime.compiled.frames import added, rotated, vector
from fenics_rom.world import rigid_answers, turning
from fenics_rom.world.compiled.couples import couple_of
from fenics_rom.world.compiled.rigid_bodies import rows_of
from fenics_rom.world.compiled.tables import SLIDES, freedoms_at, joined_at, near_at, rigid_at

_answers_where_held, _product = jit_shared(rigid_answers.answers_where_held), jit_shared(turning.product)


class Maps(NamedTuple):
    """Of n pairs, K contacts, then points of joints."""

    rigid: Array  # (n, 2) bodies that move freely; -1: others
    motion: Array  # (n, 2, 3, 6) what v̂ and R ω̂ of these move a pair by
    forced: Array  # (n, 2, 3, 6) by which a force of a pair is one, and a torque, on these
    answers: Array  # (B, 6, 6) v̂ and R ω̂ per force and torque
    at: Array  # (n,) of pairs at soft bodies, where they are in: -1: others
    softᵀ: Array  # (3s, 3s) Wᵀ of soft bodies
    slack: Array  # (K,) what is added to the compliance of contacts, m/s/N


@jit_apart
def set_maps(world: Array, h: float, among: Array, K: int, f: Array, maps: Maps) -> None:
    """Sets those of rigid bodies as forces f (n, 3) of some pairs (n,) were tried."""
    near, rigid, freedoms = near_at(world), rigid_at(world), freedoms_at(world)
    B, n = len(rigid.mass), len(among)
    pushed, held = np.zeros((B, 3)), np.zeros((B, 3, 3))
    for i in range(n):
        c = among[i]
        couples = couple_of(near.meetings, near.features, c) >= 0
        for side in range(2):
            b = near.rigid[c, side]
            maps.rigid[i, side] = b
            if b < 0 or couples:
                continue
            for k in range(3):
                force = (1.0 - 2 * side) * f[i, k]
                if i < K or (side == 0 and near.features[c] == SLIDES):
                    pushed[b, k] += force
                else:
                    for m in range(3):
                        held[b, m, k] += near.arms[c, side, m] * force
    spun, bent, ends = np.empty((B, 3, 3)), np.empty((B, 3, 3)), np.empty((B, 3, 3))
    for b in range(B):
        tried, R = freedoms.tries[b], rows_of(rigid.rotation[b])
        of_body = rigid.mass[b], rows_of(rigid.inertia[b]), R
        loads = vector(pushed[b], 0), vector(tried[1], 0), rows_of(held[b]), vector(tried[3], 0)
        found, answer = _answers_where_held(h, *of_body, *loads), maps.answers[b]
        fill(answer, 0.0)
        for i in range(3):
            answer[i, i] = found.per_force
            for k in range(3):
                answer[3 + i, k], answer[3 + i, 3 + k] = found.levered[i][k], found.turning[i][k]
                spun[b, i, k], bent[b, i, k], ends[b, i, k] = found.spun[i][k], found.bent[i][k], found.end[i][k]
    for i in range(n):
        c = among[i]
        couples = couple_of(near.meetings, near.features, c) >= 0
        for side in range(2):
            b = maps.rigid[i, side]
            if b < 0:
                continue
            motion, forced = maps.motion[i, side], maps.forced[i, side]
            if couples:
                set_couple(motion)
                set_couple(forced)
            elif i < K or (side == 0 and near.features[c] == SLIDES):
                middle = added(vector(rigid.motion[b, 0], 0), h / 2, vector(freedoms.tries[b, 2], 0))
                arm = added(vector(near.places[c], 0), -1.0, middle)
                set_point(motion, arm)
                set_point(forced, arm)
                for m in range(3):
                    for k in range(3):
                        motion[m, k] -= spun[b, m, k]
            else:
                y = vector(near.arms[c, side], 0)
                begin, end = rotated(rows_of(rigid.rotation[b]), y), rotated(rows_of(ends[b]), y)
                arm = (begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2, (begin[2] + end[2]) / 2
                set_point(motion, arm)
                set_point(forced, arm)
                more = _product(_product(rows_of(spun[b]), _crossed(end)), rows_of(bent[b]))
                for m in range(3):
                    for k in range(3):
                        motion[m, 3 + k] += more[m][k]


@jit_part
def _crossed(a: Vector) -> Rotation:
    """C with C ω = ω × a."""
    return (0.0, a[2], -a[1]), (-a[2], 0.0, a[0]), (a[1], -a[0], 0.0)


@jit_part
def set_point(of: Array, arm: Vector) -> None:
    """Sets what a body's velocity and turning (6,) move a point at an arm by, (3, 6)."""
    rows = _crossed(arm)
    for m in range(3):
        for k in range(3):
            of[m, k], of[m, 3 + k] = 1.0 if m == k else 0.0, rows[m][k]


@jit_part
def set_couple(of: Array) -> None:
    """The same of a pair that stands for how bodies turn."""
    for m in range(3):
        for k in range(3):
            of[m, k], of[m, 3 + k] = 0.0, 1.0 if m == k else 0.0


@jit_apart
def move(maps: Maps, f: Array, u: Array) -> None:
    """Adds W f to velocities u (n, 3)."""
    B, n = len(maps.answers), len(f)
    wrenches, twists = np.zeros((B, 6)), np.zeros((B, 6))
    for i in range(n):
        for side in range(2):
            b = maps.rigid[i, side]
            if b >= 0:
                for m in range(3):
                    share = (1.0 - 2 * side) * f[i, m]
                    if share != 0.0:
                        for k in range(6):
                            wrenches[b, k] += share * maps.forced[i, side, m, k]
    for b in range(B):
        for k in range(6):
            for m in range(6):
                twists[b, k] += maps.answers[b, k, m] * wrenches[b, m]
    for i in range(n):
        for side in range(2):
            b = maps.rigid[i, side]
            if b >= 0:
                for m in range(3):
                    for k in range(6):
                        u[i, m] += (1.0 - 2 * side) * maps.motion[i, side, m, k] * twists[b, k]
        if i < len(maps.slack):
            for m in range(3):
                u[i, m] += maps.slack[i] * f[i, m]
    for i in range(n if len(maps.softᵀ) else 0):
        for j in range(n if maps.at[i] >= 0 else 0):
            if maps.at[j] >= 0:
                add_soft_answer(maps.softᵀ, maps.at[j], maps.at[i], f[j], u[i])


@jit_part
def add_soft_answer(Wᵀ: Array, of: int, to: int, f: Array, u: Array) -> None:
    """Adds what a pair moves by a force (3,) on another one to u (3,)."""
    for k in range(3):
        for m in range(3):
            u[m] += Wᵀ[3 * of + k, 3 * to + m] * f[k]


@jit_part
def answer_to(answer: Array, of: Array, at: int, twist: Array) -> None:
    """Sets the twist (6,) that a body answers a force and torque with, which begin in a row at some place."""
    for k in range(6):
        twist[k] = 0.0
        for m in range(6):
            twist[k] += answer[k, m] * of[at + m]


@jit_part
def along(of: Array, at: int, twist: Array) -> float:
    """What a twist (6,) moves by a map, which begins in a row at some place."""
    total = 0.0
    for k in range(6):
        total += of[at + k] * twist[k]
    return total


@jit_part
def maps_of(world: Array, K: int, at: Array, softᵀ: Array) -> Maps:
    """Room for those of K contacts and all points of joints."""
    n, B = K + len(joined_at(world).ends), len(rigid_at(world).mass)
    rigid, answers = np.full((n, 2), -1), np.zeros((B, 6, 6))
    return Maps(rigid, np.zeros((n, 2, 3, 6)), np.zeros((n, 2, 3, 6)), answers, at, softᵀ, np.zeros(K))
