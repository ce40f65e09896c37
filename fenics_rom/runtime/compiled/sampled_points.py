"""An elastic law by a discrete gradient of points, compiled: `steppers.elastic.sampled`, of two materials and fibres.

f̂ = Aᵀ ω Ŝ(E, E⁺)         A = ∂E/∂q in the middle of the step
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.hyperelastic import ROUND_OFF_STRAIN
from fenics_rom.runtime.compiled.branches import add_row_of_pull, step_branches
from fenics_rom.runtime.compiled.carried_strains import Law
from fenics_rom.runtime.compiled.material_points import (
    ST_VENANT,
    Points,
    add_resultant,
    add_stressed,
    displacement_gradients,
    energy_of,
    linear_stress_of,
    set_strains,
    stress_of,
    work,
)
from fenics_rom.runtime.compiled.small_matrices import dot
from fenics_rom.runtime.compiled.threads import Six, add_along, curvature_along, stiffness_at_rest, strain_along

PAIRS = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])  # of the six components


class Sampled(NamedTuple):
    """P points."""

    points: Points
    viscosity: Array  # β, and that with what branches resist strain rates by (2, P), s
    round_off: float  # of forces, however small the strains
    is_linear: bool  # whether stresses are, in the strains


class InStep(NamedTuple):
    """What points begin a step with, and what they are at a velocity."""

    E: Array  # strains (6, P)
    W: Array  # energies (P,), J
    history: Array  # stresses (6, P) of branches; these, and others, have the weights
    middle: Array  # displacement gradients (9, P) in its middle,
    end: Array  # and at its end
    mean: Array  # of the strains (6, P)
    after: Array  # strains (6, P) at its end
    S: Array  # (6, P)


@jit_part
def begin_points(sampled: Sampled, law: Law, relaxed: Array, q: Array) -> InStep:
    """From q (m,), with strains of branches and their stresses (N, 2, 6 P)."""
    H = displacement_gradients(sampled.points, q)
    P = H.shape[1]
    strains = np.empty((6, P)), np.empty((6, P)), np.empty((6, P)), np.empty((6, P))
    step = InStep(strains[0], np.empty(P), np.zeros((6, P)), H, np.empty((9, P)), *strains[1:])
    set_strains(H, step.E)
    for p in range(P):
        step.W[p] = energy_of(sampled.points, _six(step.E, p), p)
    add_row_of_pull(law.branches, relaxed, 1, step.history.reshape(-1))
    return step


@jit_part
def _six(E: Array, p: int) -> Six:
    """Of point p."""
    return E[0, p], E[1, p], E[2, p], E[3, p], E[4, p], E[5, p]


@jit_part
def _grown(step: InStep, p: int) -> Six:
    """What strains of point p grow by in the step."""
    E, after = step.E, step.after
    x, y, z = after[0, p] - E[0, p], after[1, p] - E[1, p], after[2, p] - E[2, p]
    return x, y, z, after[3, p] - E[3, p], after[4, p] - E[4, p], after[5, p] - E[5, p]


@jit_part
def _defect(sampled: Sampled, step: InStep, stress: Six, p: int) -> tuple[float, float]:
    """What the energy of point p grows by beside the work of a stress, over a square of its strains, and this one."""
    share, square = energy_of(sampled.points, _six(step.after, p), p) - step.W[p], ROUND_OFF_STRAIN**2
    for c in range(6):
        Δ = step.after[c, p] - step.E[c, p]
        share, square = share - stress[c] * Δ, square + (Δ * Δ if c < 3 else Δ * Δ / 2)
    return share / square, square


@jit_part
def set_resistance(sampled: Sampled, law: Law, step: InStep, q: Array, v: Array, force: Array) -> None:
    """Sets f̂ (m,) at v, from q (m,)."""
    m, h, points, S, E, after = len(q), law.h, sampled.points, step.S, step.E, step.after
    at = np.empty(m)
    for i in range(m):
        at[i] = q[i] + h * v[i]
    step.end[:] = displacement_gradients(points, at)
    for i in range(m):
        at[i] = q[i] + h / 2 * v[i]
    step.middle[:] = displacement_gradients(points, at)
    set_strains(step.end, after)
    for c in range(6):
        for p in range(len(step.W)):
            step.mean[c, p] = (E[c, p] + after[c, p]) / 2
    for p in range(len(step.W)):
        stress, share = stress_of(points, _six(step.mean, p), p), 0.0
        if not sampled.is_linear:
            share = _defect(sampled, step, stress, p)[0]
        viscous, history = _viscous(sampled, law, step, 1, p), step.history
        for c in range(6):
            Δ = after[c, p] - E[c, p]
            S[c, p] = stress[c] + share * (Δ if c < 3 else Δ / 2) + viscous[c] + history[c, p]
    for i in range(m):
        force[i] = dot(law.springs[i], at) + dot(law.damping[i], v)
    add_resultant(points, step.middle, S, force)


@jit_part
def _viscous(sampled: Sampled, law: Law, step: InStep, row: int, p: int) -> Six:
    """Stress of the strain rates of point p, by a row of viscosities."""
    Δ = _grown(step, p)
    S = linear_stress_of(sampled.points, sampled.viscosity[row, p] / law.h, Δ, p)
    share = _dilating(sampled, p) / law.h
    if not share > 0:
        return S
    a, b, c, d, e, f = _inverse_metric(step.mean, p)
    of_volume, trace = share * work((a, b, c, d, e, f), Δ), share * (Δ[0] + Δ[1] + Δ[2])
    return (
        S[0] + of_volume * a - trace,
        S[1] + of_volume * b - trace,
        S[2] + of_volume * c - trace,
        S[3] + of_volume * d,
        S[4] + of_volume * e,
        S[5] + of_volume * f,
    )


@jit_part
def _dilating(sampled: Sampled, p: int) -> float:
    """β λ of point p, where viscosity resists J'/J: see `PointMaterial.dilating`."""
    is_linear = sampled.points.kind[0] == ST_VENANT
    return 0.0 if is_linear else sampled.viscosity[0, p] * max(sampled.points.moduli[0, p], 0.0)


@jit_part
def _inverse_metric(E: Array, p: int) -> Six:
    """C⁻¹ of point p."""
    x, y, z, u, v, w = 1 + 2 * E[0, p], 1 + 2 * E[1, p], 1 + 2 * E[2, p], E[3, p], E[4, p], E[5, p]
    first, fifth, sixth = y * z - u * u, w * u - v * y, u * v - w * z
    share = 1 / (x * first + v * fifth + w * sixth)
    return (
        share * first,
        share * (z * x - v * v),
        share * (x * y - w * w),
        share * (v * w - u * x),
        share * fifth,
        share * sixth,
    )


@jit_part
def set_slope_of_points(sampled: Sampled, law: Law, step: InStep, is_exact: bool, slope: Array) -> None:
    """Sets what f̂ changes by with v (m, m), at that of the last `set_resistance`; definite unless it is to be exact."""
    m, h, P, points = len(slope), law.h, len(step.W), sampled.points
    moduli, C, at_end = np.empty((6, 6, P)), np.empty((3, 3)), step.end if is_exact else step.middle
    for p in range(P):
        _set_moduli(sampled, step, is_exact, p, h, C, moduli)
    rates, stressed, own = np.empty((m, 6, P)), np.empty((m, 6, P)), np.empty((6, P))
    for j in range(m):
        G = points.gradients[j].reshape(9, P)
        _set_rates(step.middle, G, rates[j])
        _set_rates(at_end, G, own)
        for c in range(6):
            into = stressed[j, c]
            into[:] = 0.0
            for d in range(6):
                for p in range(P):
                    into[p] += moduli[c, d, p] * own[d, p]
    for i in range(m):
        for j in range(m):
            slope[i, j] = law.steady[i, j] + dot(rates[i].reshape(-1), stressed[j].reshape(-1))
    if is_exact:
        add_stressed(points, step.S, h / 2, slope)


@jit_part
def _set_rates(H: Array, G: Array, rates: Array) -> None:
    """Sets what strains (6, P) change by with a mode of gradients (9, P), of points deformed by H."""
    for c in range(6):
        i, j, row = PAIRS[c, 0], PAIRS[c, 1], rates[c]
        for p in range(len(row)):
            row[p] = G[3 * i + j, p]
        if i != j:
            for p in range(len(row)):
                row[p] += G[3 * j + i, p]
        for k in range(3):
            for p in range(len(row)):
                row[p] += H[3 * k + i, p] * G[3 * k + j, p]
            if i != j:
                for p in range(len(row)):
                    row[p] += H[3 * k + j, p] * G[3 * k + i, p]


@jit_part
def _set_moduli(sampled: Sampled, step: InStep, is_exact: bool, p: int, h: float, C: Array, into: Array) -> None:
    """Sets h ∂Ŝ/∂E⁺, and what is viscous, of point p (6, 6); where it need not be exact what is definite of it."""
    points, viscosity = sampled.points, sampled.viscosity[1, p]
    λ, μ, first, end = points.moduli[0, p], points.moduli[1, p], points.starts[p], points.starts[p + 1]
    into[:, :, p] = 0.0
    if points.kind[0] == ST_VENANT:
        _add_linear(λ, μ, p, h / 2, into)
    else:
        _add_neo_hookean(λ, μ, step.mean, p, h / 2, C, into)
    for t in range(first, end):
        along = strain_along(points.threads, t, _six(step.mean, p))
        add_along(points.threads, t, h / 2 * curvature_along(points.threads, t, along), p, into)
    if is_exact and not sampled.is_linear:
        _correct(sampled, step, p, h, into)
    if viscosity > 0 and points.kind[0] != ST_VENANT:
        _add_volumes(sampled, step, is_exact, p, C, into)
    _add_linear(λ, μ, p, viscosity, into)
    for t in range(first, end):
        add_along(points.threads, t, viscosity * stiffness_at_rest(points.threads, t), p, into)


@jit_part
def _add_linear(λ: float, μ: float, p: int, size: float, into: Array) -> None:
    """Adds, so many times, moduli of small strains of point p."""
    for c in range(3):
        for d in range(3):
            into[c, d, p] += size * λ
        into[c, c, p] += 2 * size * μ
        into[3 + c, 3 + c, p] += size * μ


@jit_part
def _add_volumes(sampled: Sampled, step: InStep, is_exact: bool, p: int, C: Array, into: Array) -> None:
    """Adds h times what viscosity in volumes makes; C (3, 3): the inverse metric."""
    share, of_volume, along = _dilating(sampled, p), 0.0, np.zeros(6)
    for d in range(6):
        k, n = PAIRS[d, 0], PAIRS[d, 1]
        Δ = step.after[d, p] - step.E[d, p]
        of_volume += C[k, n] * Δ
        for c in range(6):
            i, j = PAIRS[c, 0], PAIRS[c, 1]
            along[c] += (C[i, k] * C[j, n] + C[i, n] * C[j, k]) / 2 * Δ
    for c in range(6):
        i, j = PAIRS[c, 0], PAIRS[c, 1]
        for d in range(6):
            k, n = PAIRS[d, 0], PAIRS[d, 1]
            into[c, d, p] += share * (C[i, j] * C[k, n] - (1.0 if c < 3 and d < 3 else 0.0))
            if is_exact:
                turned = (C[i, k] * C[j, n] + C[i, n] * C[j, k]) / 2
                into[c, d, p] -= share * (C[i, j] * along[d] + of_volume * turned)


@jit_part
def _add_neo_hookean(λ: float, μ: float, E: Array, p: int, size: float, C: Array, into: Array) -> None:
    """Adds, so many times, moduli of point p; C (3, 3) is set."""
    x, y, z, u, v, w = 2 * E[0, p], 2 * E[1, p], 2 * E[2, p], E[3, p], E[4, p], E[5, p]
    first, second, third = y * z + y + z - u * u, z * x + z + x - v * v, x * y + x + y - w * w
    fourth, fifth, sixth = v * w - u - u * x, w * u - v - v * y, u * v - w - w * z
    change = x * first + x + first + v * fifth + w * sixth
    C[0, 0], C[1, 1], C[2, 2] = (1 + first) / (1 + change), (1 + second) / (1 + change), (1 + third) / (1 + change)
    C[1, 2] = C[2, 1] = fourth / (1 + change)
    C[0, 2] = C[2, 0] = fifth / (1 + change)
    C[0, 1] = C[1, 0] = sixth / (1 + change)
    turned = size * (μ - λ * math.log1p(change) / 2)
    for c in range(6):
        i, j = PAIRS[c, 0], PAIRS[c, 1]
        for d in range(6):
            k, n = PAIRS[d, 0], PAIRS[d, 1]
            into[c, d, p] += size * λ * C[i, j] * C[k, n] + turned * (C[i, k] * C[j, n] + C[i, n] * C[j, k])


@jit_part
def _correct(sampled: Sampled, step: InStep, p: int, h: float, into: Array) -> None:
    """Adds h times what ∂Ŝ/∂E⁺ of point p is beside ½ ∂S/∂E of the mean strain: see `discrete_gradient_slopes`."""
    stress = stress_of(sampled.points, _six(step.mean, p), p)
    after = stress_of(sampled.points, _six(step.after, p), p)
    share, square = _defect(sampled, step, stress, p)
    by_defect = np.empty(6)
    for d in range(6):
        bent, along = 0.0, (step.after[d, p] - step.E[d, p]) * (1.0 if d < 3 else 0.5)
        for c in range(6):
            bent += into[c, d, p] / h * (step.after[c, p] - step.E[c, p])
        by_defect[d] = (after[d] - stress[d] - bent - 2 * share * along) / square
    for c in range(6):
        size = h * (1.0 if c < 3 else 0.5)
        for d in range(6):
            into[c, d, p] += size * (step.after[c, p] - step.E[c, p]) * by_defect[d]
        into[c, c, p] += size * share


@jit_part
def close_points(sampled: Sampled, law: Law, step: InStep, relaxed: Array, v: Array) -> tuple[float, float]:
    """Ends a step with v (m,), that of the last `set_resistance`: energy of the points, and what was dissipated, J."""
    h, P, energy, heat = law.h, len(step.W), 0.0, 0.0
    for i in range(len(v)):
        heat += h * v[i] * dot(law.damping[i], v)
    for p in range(P):
        energy += energy_of(sampled.points, _six(step.after, p), p)
        heat += work(_viscous(sampled, law, step, 0, p), _grown(step, p))
    if law.branches.size > 0:
        rates, stresses = step.mean, step.S
        for p in range(P):
            for c in range(6):
                rates[c, p] = (step.after[c, p] - step.E[c, p]) / h
            stress = linear_stress_of(sampled.points, 1.0, _six(rates, p), p)
            for c in range(6):
                stresses[c, p] = stress[c]
        heat += step_branches(law.branches, relaxed, rates.reshape(-1), stresses.reshape(-1))
    return energy, heat
