"""How a rigid body turns in a step, and what forces on it answer: equations in `world.rigid`.

NumPy's steps call these functions; compiled ones (`world.compiled`) have them compiled.
"""

import math
from typing import NamedTuple

from fenics_rom.mechanics.frame_motion import (
    ZERO,
    Rotation,
    Vector,
    added,
    cross,
    dot,
    mean,
    rotated,
    rotated_back,
    rotation_of,
    turned,
)

TOLERANCE = 1e-16  # of the angular velocity: what the next correction may be
STAGNATION = 1e-12  # of it: as near as round-off of large forces of joints lets it come
MOST_ITERATIONS = 50
SMALL = 1e-4  # of an angle: below it y/atan y is its series
NONE: Rotation = (ZERO, ZERO, ZERO)
UNIT: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def find_turning(
    h: float, inertia: Rotation, R: Rotation, ω: Vector, τ: Vector, held: Rotation, forced: float
) -> tuple[Vector, Vector, Rotation, float]:
    """How a body turns in a step of h s.

    Args:
        h: s.
        inertia: its rows, kg m².
        R: of its axes when the step begins.
        ω: in these, when it begins, rad/s.
        τ: torque about the centre of mass, N m.
        held: moment Σ y fᵀ of joints at y in its axes, N m.
        forced: what it may turn by for that, rad/s; 0 where no joint holds it.

    Returns:
        ω̂ in its axes, rad/s; the whole torque; (R + R⁺)/2; and 0, or what share of ω̂ is left to find: too much, or
        no finite number.
    """
    twice, half, x, before, left = 2 / h, h / 2, ω, 0.0, 1.0
    L, whole, middle, t = rotated(inertia, x), τ, R, rotated_back(R, τ)
    for _ in range(MOST_ITERATIONS):
        if forced != 0.0:
            middle = mean_rotation(R, h, x)
            whole = added(τ, 1.0, torque_of(middle, held))
            t = rotated_back(R, whole)
        Ix = rotated(inertia, x)
        w = added(Ix, half, t)
        ρ = added(added(added(cross(x, w), twice, Ix), -twice, L), -1.0, t)
        if ρ[0] == 0.0 and ρ[1] == 0.0 and ρ[2] == 0.0:
            left = 0.0
            break
        # Columns of the Jacobian 2/h I + x~ I - w~, and Cramer's rule.
        (p, q, r), (a, b, c) = w, inertia
        u = added(added(cross(x, a), twice, a), -1.0, (0.0, r, -q))
        v = added(added(cross(x, b), twice, b), -1.0, (-r, 0.0, p))
        z = added(added(cross(x, c), twice, c), -1.0, (q, -p, 0.0))
        vz, zu, uv = cross(v, z), cross(z, u), cross(u, v)
        determinant = dot(u, vz)
        change = dot(ρ, vz) / determinant, dot(ρ, zu) / determinant, dot(ρ, uv) / determinant
        x = added(x, -1.0, change)
        size = max(abs(change[0]), abs(change[1]), abs(change[2]))
        scale = max(abs(x[0]), abs(x[1]), abs(x[2])) + forced
        if not math.isfinite(size):
            return x, whole, middle, math.inf
        left = size / scale if scale > 0 else 1.0
        is_found = size <= 4 * TOLERANCE * scale or size * size <= TOLERANCE * scale * before
        is_found = is_found or (forced == 0.0 and h * size <= TOLERANCE)  # by less it is not linear
        if is_found or (size <= STAGNATION * scale and size > before / 4 > 0):
            left = 0.0
            break
        before = size
    if forced != 0.0:
        middle = mean_rotation(R, h, x)
        whole = added(τ, 1.0, torque_of(middle, held))
    return x, whole, middle, left


def mean_rotation(R: Rotation, h: float, ω̂: Vector) -> Rotation:
    """(R + R⁺)/2 of a step of h s."""
    C = rotation_of(*turned((1.0, 0.0, 0.0, 0.0), (h * ω̂[0], h * ω̂[1], h * ω̂[2])))
    (a, b, c), (x, y, z) = R, product(R, C)
    return mean(a, x), mean(b, y), mean(c, z)


def torque_of(R: Rotation, moment: Rotation) -> Vector:
    """Σ (R a) × f from Σ a fᵀ."""
    x, y, z = product(R, moment)
    return y[2] - z[1], z[0] - x[2], x[1] - y[0]


def turning_along(along: Vector, turn: Vector, other: Vector) -> Vector:
    """Direction of the row of a hinge along ā, of bodies that turn by w in the step: `joint_rows`."""
    size = dot(along, along)
    c = dot(added(other, -1.0, turn), along) / size
    X = 1 + (dot(turn, turn) + c * dot(turn, along)) / 4
    y = c / (2 * X)
    share = 1 + y * y / 3 if abs(y) < SMALL else y / math.atan(y)
    scale = 1 / (size * X * share)
    return scale * along[0], scale * along[1], scale * along[2]


class Answers(NamedTuple):
    """How a body that was tried under forces answers more of them, in world axes.

    A force f at an arm a moves the centre, so that F has other arms, and the body, which in turn moves the point:

        δv̂ = h/2m δf,    δ(R ω̂) = R A⁻¹ (1 - h/2 ω̂~) Rᵀ (a × δf - h/2 δv̂ × F)
        δu = (1 - h/2 (R ω̂)~) δv̂ + δ(R ω̂) × a

    Forces of joints, which go with the body, do not have the last part of the torque.
    """

    moving: Rotation  # (1 - h/2 (R ω̂)~) δv̂ per force
    turning: Rotation  # δ(R ω̂) per torque
    levered: Rotation  # δ(R ω̂) per force that stays in place


def answers_to(
    h: float, mass: float, inertia: Rotation, R: Rotation, force: Vector, torque: Vector, ω̂: Vector
) -> Answers:
    """Of a body that was tried under a force and a torque, in a step of h s."""
    per_force, whirl = h / 2 / mass, added(rotated(inertia, ω̂), h / 2, rotated_back(R, torque))
    rates = sum_of(2 / h, inertia, product(cross_rows(ω̂), inertia))
    A = sum_of(1.0, rates, cross_rows((-whirl[0], -whirl[1], -whirl[2])))
    back = transposed(R)
    bent = product(sum_of(-h / 2, cross_rows(ω̂), UNIT), back)
    moving, turning = product(R, bent), product(R, product(inverse(A), bent))
    levered = product(turning, cross_rows(force))
    return Answers(sum_of(per_force, moving, NONE), turning, sum_of(per_force * h / 2, levered, NONE))


def cross_rows(a: Vector) -> Rotation:
    """a~."""
    return (0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)


def transposed(A: Rotation) -> Rotation:
    """Aᵀ."""
    (a, b, c) = A
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


def product(A: Rotation, B: Rotation) -> Rotation:
    """A B."""
    (a, b, c) = A
    return rotated_back(B, a), rotated_back(B, b), rotated_back(B, c)


def sum_of(factor: float, A: Rotation, B: Rotation) -> Rotation:
    """factor A + B."""
    (a, b, c), (x, y, z) = A, B
    return added(x, factor, a), added(y, factor, b), added(z, factor, c)


def inverse(A: Rotation) -> Rotation:
    """A⁻¹, by Cramer's rule."""
    (a, b, c) = A
    bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
    share = 1 / dot(a, bc)
    return sum_of(share, transposed((bc, ca, ab)), NONE)
