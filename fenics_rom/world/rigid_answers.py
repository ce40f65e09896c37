"""How a rigid body that joints hold answers more forces, exactly: the points where these act go with it."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import crossed
from fenics_rom.mechanics.frame_motion import Rotation, Vector, added, dot, rotated, rotated_back, rotation_of, turned
from fenics_rom.world.bodies import Points
from fenics_rom.world.turning import NONE, UNIT, cross_rows, inverse, product, sum_of, transposed

_EYE = np.eye(3)


class HeldAnswers(NamedTuple):
    """How a body that joints hold answers more forces, in world axes: the points where these act go with it.

    With R⁺ = R cay(h ω̂), w = R ω̂, D = (1 + h/2 w~)/(1 + h²/4 w²), F of contacts, and f of joints at y:

        δv̂ = h/2m δf,    δw = T (a × δf - h/2 δv̂ × F),    T⁻¹ = T₀⁻¹ - h/2 (N - tr N) D,    N = R⁺ Σ y fᵀ
        δu = δv̂ + δw × a - h/2 w~ δv̂ at a contact,    δv̂ + δw × R̄ y - h/2 w~ (R⁺ y)~ D δw at a joint

    where T₀ is `Answers.turning`.
    """

    per_force: float  # h/2m
    turning: Rotation  # T
    levered: Rotation  # δw per force, but for its torque
    spun: Rotation  # h/2 w~
    bent: Rotation  # D
    end: Rotation  # R⁺


def answers_where_held(
    h: float, mass: float, inertia: Rotation, R: Rotation, force: Vector, torque: Vector, held: Rotation, ω̂: Vector
) -> HeldAnswers:
    """Of a body that was tried in a step of h s under contacts, whose forces add up to `force`, and joints.

    `torque`: of all; `held`: Σ y fᵀ of joints, y in its axes.
    """
    per_force, whirl = h / 2 / mass, added(rotated(inertia, ω̂), h / 2, rotated_back(R, torque))
    spun = sum_of(h / 2, cross_rows(rotated(R, ω̂)), NONE)
    bent = sum_of(1 / (1 + h * h / 4 * dot(ω̂, ω̂)), sum_of(1.0, spun, UNIT), NONE)
    end = product(R, rotation_of(*turned((1.0, 0.0, 0.0, 0.0), (h * ω̂[0], h * ω̂[1], h * ω̂[2]))))
    N = product(end, held)
    following = product(sum_of(-N[0][0] - N[1][1] - N[2][2], UNIT, N), bent)
    A = sum_of(2 / h, inertia, product(cross_rows(ω̂), inertia))
    A = sum_of(1.0, A, cross_rows((-whirl[0], -whirl[1], -whirl[2])))
    back = product(sum_of(-h / 2, cross_rows(ω̂), UNIT), transposed(R))
    A = sum_of(-h / 2, product(product(back, following), R), A)
    turning = product(R, product(inverse(A), back))
    levered = sum_of(per_force * h / 2, product(turning, cross_rows(force)), NONE)
    return HeldAnswers(per_force, turning, levered, spun, bent, end)


def operator_where_held(answers: HeldAnswers, R: Rotation, points: Points, arms: Array) -> Array:
    """Velocities of its points per force on them, (3n, 3n).

    R: of its axes when the step begins; arms: (k, 3) of k contacts from the middle of the way of its centre, m.
    """
    per_force, k, n = answers.per_force, len(arms), len(arms) + len(points.arms)
    turning, levered, spun, bent, end = map(np.array, answers[1:])
    ends = points.arms.dot(end.T)
    forced, moved = np.zeros((2, n, 3, 6))
    forced[:, :, :3] = moved[:, :, :3] = _EYE
    forced[:, :, 3:] = moved[:, :, 3:] = crossed(np.concatenate([arms, (points.arms.dot(np.array(R).T) + ends) / 2]))
    moved[:k, :, :3] -= spun
    moved[k:, :, 3:] += spun @ crossed(ends) @ bent
    if len(points.couples):
        forced[points.couples, :, :3] = moved[points.couples, :, :3] = 0.0
        forced[points.couples, :, 3:] = moved[points.couples, :, 3:] = _EYE
    given = forced.reshape(-1, 6).T
    turned = turning.dot(given[3:]) + levered.dot(given[:3])
    whole: Array = moved.reshape(-1, 6).dot(np.concatenate([per_force * given[:3], turned]))
    return whole
