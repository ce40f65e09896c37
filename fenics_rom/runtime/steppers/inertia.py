"""Inertia and rotation of a body in plain numbers; of symmetric matrices the six entries xx, yy, zz, yz, xz, xy."""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.errors import StepError
from fenics_rom.mechanics.frame_geometry import TOO_FAR
from fenics_rom.mechanics.frame_motion import Vector, added, cross, dot, length
from fenics_rom.mechanics.voigt import VOIGT_INDEX

TOLERANCE = 1e-15  # of the velocities: what the next correction may be
ROUND_OFF = 4e-15  # of the velocities: a correction that is none
SLOW = 0.2  # of one correction to the next, from which on slopes are found anew
MOST_ITERATIONS = 60

Inertia = tuple[float, ...]  # its six entries


def solved_inertia(inertia: Inertia, L: Vector) -> Vector:
    """I⁻¹ L."""
    (xx, yy, zz, yz, xz, xy), (x, y, z) = inertia, L
    A, B, C = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    D, E, F = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    determinant = xx * A + xy * B + xz * C
    return (
        (A * x + B * y + C * z) / determinant,
        (B * x + D * y + E * z) / determinant,
        (C * x + E * y + F * z) / determinant,
    )


def check_definite(inertia: Inertia, b: Array) -> None:
    """A StepError where kinetic energy is not positive definite, [[I, b], [bᵀ, 1]], with b (3, m)."""
    if not is_definite(inertia, b.dot(b.T)):
        raise StepError(TOO_FAR)


def definite_up_to(inertia0: Array, inertia1: Array, inertia2: Array, coupling: Array) -> float:
    """Up to which |e|² kinetic energy is positive definite for sure.

    Of I = I0 + I1 e + eᵀI2 e and b = G e, by I0 (6,), I1 (6, m), I2 (6, m, m) and G (3, m, m): in axes in which I0 is
    1 and with norms a of I1, c of I2 and g of G, where 1 = a |e| + (c + g²) |e|².
    """
    m, (λ, axes) = len(coupling[0]), np.linalg.eigh(inertia0[VOIGT_INDEX])
    scaled = axes / np.sqrt(λ)
    I1, I2 = (np.einsum("ki,kl...,lj->ij...", scaled, part[VOIGT_INDEX], scaled) for part in (inertia1, inertia2))
    G = np.tensordot(scaled.T, coupling, 1)
    a, g = (np.linalg.norm(part.reshape(-1, m), 2) for part in (I1, G))
    c = np.linalg.norm(np.linalg.norm(I2, 2, axis=(2, 3))) + g**2
    return float((2 / (a + np.sqrt(a**2 + 4 * c))) ** 2) if a or c else math.inf


def is_definite(inertia: Inertia, bbᵀ: Array) -> bool:
    """Whether I - b bᵀ is positive definite."""
    xx, yy, zz = inertia[0] - bbᵀ[0, 0], inertia[1] - bbᵀ[1, 1], inertia[2] - bbᵀ[2, 2]
    yz, xz, xy = inertia[3] - bbᵀ[1, 2], inertia[4] - bbᵀ[0, 2], inertia[5] - bbᵀ[0, 1]
    minor = xx * yy - xy * xy
    return bool(xx > 0 and minor > 0 and zz * minor - yz * (xx * yz - xy * xz) + xz * (xy * yz - yy * xz) > 0)


def times_inertia(inertia: Inertia, ω: Vector) -> Vector:
    """I ω."""
    (xx, yy, zz, yz, xz, xy), (x, y, z) = inertia, ω
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def momenta_of(
    inertia: Inertia, moved: Vector, moment: Vector, drift: Vector, v: Vector, ω: Vector, mass: float
) -> tuple[Vector, Vector]:
    """Linear and, about the frame's origin, angular, in its axes: of a `Shape` at the twist of the base."""
    P = added(added(cross(ω, moment), mass, v), 1.0, drift)
    L = added(added(times_inertia(inertia, ω), 1.0, moved), 1.0, cross(moment, v))
    return P, L


def pairs(ω: Vector, η: Vector) -> tuple[float, float, float, float, float, float]:
    """Σ_kl ω_k η_l X_kl of a symmetric X as a sum of its six entries: their factors."""
    (a, b, c), (x, y, z) = ω, η
    return a * x, b * y, c * z, b * z + c * y, a * z + c * x, a * y + b * x


def contraction(factor: float, ω: Vector) -> Array:
    """(3, 6), which makes factor Σ_l ω_l X_kl of the six entries of a symmetric X."""
    x, y, z = factor * ω[0], factor * ω[1], factor * ω[2]
    return np.array(((x, 0.0, 0.0, 0.0, z, y), (0.0, y, 0.0, z, 0.0, x), (0.0, 0.0, z, y, x, 0.0)))


def turn_of_top(
    inertia: Inertia, L: Vector, torque: Vector, ω: Vector, start: Vector, h: float
) -> tuple[Vector, float]:
    """The mid-step ω̂ of a top that turns with ω and L at the start of a step of h s, and how little of it is not found.

    In its axes, 2/h (I ω̂ - L) + ω̂ × I ω̂ = torque; the iteration is Newton's from `start` with kept slopes.
    """
    ω̂, slopes, before, size = start, _slopes(inertia, start, h), math.inf, math.inf
    known = length(start) + length(ω)  # nothing from rest, where there is but what the torque makes
    for _ in range(MOST_ITERATIONS):
        M = times_inertia(inertia, ω̂)
        lack = added(added(cross(ω̂, M), -1.0, torque), 2 / h, added(M, -1.0, L))
        change = _solved(slopes, lack)
        ω̂, size = added(ω̂, -1.0, change), length(change)
        scale, ratio = max(known, length(ω̂)), size / before
        if not math.isfinite(size):
            return ω̂, math.inf
        if size <= ROUND_OFF * scale or (0 < ratio < 1 and size * ratio <= TOLERANCE * scale):
            return ω̂, 0.0
        if ratio > SLOW:
            slopes = _slopes(inertia, ω̂, h)
        before = size
    return ω̂, size / scale


def _slopes(inertia: Inertia, ω̂: Vector, h: float) -> tuple[Vector, Vector, Vector]:
    """What 2/h I ω̂ + ω̂ × I ω̂ changes by with each part of ω̂."""
    (xx, yy, zz, yz, xz, xy), (x, y, z) = inertia, times_inertia(inertia, ω̂)
    return (
        added(added(cross(ω̂, (xx, xy, xz)), 2 / h, (xx, xy, xz)), 1.0, (0.0, -z, y)),
        added(added(cross(ω̂, (xy, yy, yz)), 2 / h, (xy, yy, yz)), 1.0, (z, 0.0, -x)),
        added(added(cross(ω̂, (xz, yz, zz)), 2 / h, (xz, yz, zz)), 1.0, (-y, x, 0.0)),
    )


def _solved(columns: tuple[Vector, Vector, Vector], b: Vector) -> Vector:
    """A⁻¹ b of the columns of A, by Cramer's rule."""
    a0, a1, a2 = columns
    minor = cross(a1, a2)
    determinant = dot(a0, minor)
    return dot(b, minor) / determinant, dot(b, cross(a2, a0)) / determinant, dot(b, cross(a0, a1)) / determinant
