"""The points of a body whose stress is not linear in the strain, compiled: `rom.material_points`."""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.compilation import jit_part
from fenics_rom.mechanics.compiled.copying import fill
from fenics_rom.runtime.compiled.small_matrices import add_products, dot, set_row_products
from fenics_rom.runtime.compiled.threads import (
    Six,
    energy_along,
    pulled_along,
    slope_along,
    stiffness_at_rest,
    strain_along,
)

ST_VENANT, NEO_HOOKEAN = range(2)
Nine = tuple[float, float, float, float, float, float, float, float, float]


class Points(NamedTuple):
    """P points."""

    gradients: Array  # of each mode (m, 9 P): [i j P], ∂W_i/∂X_j
    moduli: Array  # λ and μ with the weights, (2, P), J
    kind: Array  # of their law beside fibres (1,)
    starts: Array  # of the fibres of each (P + 1,)
    threads: Array  # fibres (K, 9), see `threads`


@jit_part
def displacement_gradients(points: Points, q: Array) -> Array:
    """H (9, P) at q (m,)."""
    G = points.gradients
    H = np.zeros(G.shape[1])
    for i in range(len(q)):
        row, size = G[i], q[i]
        for k in range(len(H)):
            H[k] += size * row[k]
    return H.reshape(9, -1)


@jit_part
def set_piola(points: Points, H: Array) -> float:
    """Sets ∂W/∂H (9, P) in the place of H, and returns the energy, J: see `hyperelastic.energy_and_piola`."""
    energy, kind = 0.0, points.kind[0]
    for p in range(H.shape[1]):
        λ, μ = points.moduli[0, p], points.moduli[1, p]
        a, b, c, d, e, f, g, i, k = H[0, p], H[1, p], H[2, p], H[3, p], H[4, p], H[5, p], H[6, p], H[7, p], H[8, p]
        if kind == ST_VENANT or points.starts[p + 1] > points.starts[p]:
            E, S = strains_at(H, p), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            if kind == ST_VENANT:
                S = linear_stress(λ, μ, E)
                energy += work(S, E) / 2
            for t in range(points.starts[p], points.starts[p + 1]):
                along = strain_along(points.threads, t, E)
                energy += energy_along(points.threads, t, along)
                S = pulled_along(points.threads, t, slope_along(points.threads, t, along), S)
            _set_piola(H, p, S)
            if kind == ST_VENANT:
                continue
        else:
            for row in range(9):
                H[row, p] = 0.0
        aa, bb, cc = e * k - f * i, f * g - d * k, d * i - e * g  # cofactors of H: those of F are 1 - X
        dd, ee, ff = c * i - b * k, a * k - c * g, b * g - a * i
        gg, ii, kk = b * f - c * e, c * d - a * f, a * e - b * d
        trace = a + e + k
        change = aa + ee + kk + trace + a * aa + b * bb + c * cc
        J = 1 + change
        lnJ = math.log1p(change * (1 + J)) / 2  # of |J|, where a point is turned inside out
        volumetric = λ * lnJ
        square = a * a + b * b + c * c + d * d + e * e + f * f + g * g + i * i + k * k
        energy += μ * (trace - lnJ + square / 2) + volumetric * lnJ / 2
        scale, spread = (μ - volumetric) / J, (μ * change + volumetric) / J
        H[0, p] += μ * a + scale * (a - aa - trace) + spread
        H[1, p] += μ * b + scale * (d - bb)
        H[2, p] += μ * c + scale * (g - cc)
        H[3, p] += μ * d + scale * (b - dd)
        H[4, p] += μ * e + scale * (e - ee - trace) + spread
        H[5, p] += μ * f + scale * (i - ff)
        H[6, p] += μ * g + scale * (c - gg)
        H[7, p] += μ * i + scale * (f - ii)
        H[8, p] += μ * k + scale * (k - kk - trace) + spread
    return energy


@jit_part
def _set_piola(H: Array, p: int, S: Six) -> None:
    """Sets F S of point p in place of H."""
    for row in range(0, 9, 3):
        a, b, c = H[row, p] + (row == 0), H[row + 1, p] + (row == 3), H[row + 2, p] + (row == 6)
        H[row, p] = a * S[0] + b * S[5] + c * S[4]
        H[row + 1, p] = a * S[5] + b * S[1] + c * S[3]
        H[row + 2, p] = a * S[4] + b * S[3] + c * S[2]


@jit_part
def add_resultants(points: Points, piola: Array, force: Array) -> None:
    """Adds Σ P : ∇W_k (m,) of first Piola-Kirchhoff stresses (9, P)."""
    flat = piola.reshape(-1)
    for i in range(len(force)):
        force[i] += dot(points.gradients[i], flat)


@jit_part
def _inverse(H: Array, p: int) -> Nine:
    """F⁻ᵀ of point p, row by row, of displacement gradients (9, P)."""
    a, b, c, d, e, f = 1 + H[0, p], H[1, p], H[2, p], H[3, p], 1 + H[4, p], H[5, p]
    g, i, k = H[6, p], H[7, p], 1 + H[8, p]
    aa, bb, cc = e * k - f * i, f * g - d * k, d * i - e * g
    share = 1 / (a * aa + b * bb + c * cc)
    aa, bb, cc = share * aa, share * bb, share * cc
    dd, ee, ff = share * (c * i - b * k), share * (a * k - c * g), share * (b * g - a * i)
    return aa, bb, cc, dd, ee, ff, share * (b * f - c * e), share * (c * d - a * f), share * (a * e - b * d)


@jit_part
def volume_piola(points: Points, H: Array, before: Array, size: float, β: float) -> Array:
    """What viscosity adds in volumes, (9, P), at H, where rates are so many times H less `before`.

    See `rom.volume_viscosity`.
    """
    piola = np.zeros(H.shape)
    for p in range(H.shape[1] if β > 0 and points.kind[0] == NEO_HOOKEAN else 0):
        inverse, of_volume, trace = _inverse(H, p), 0.0, 0.0
        for c in range(9):
            rate = size * (H[c, p] - before[c, p])
            of_volume, trace = of_volume + inverse[c] * rate, trace + (H[c, p] + (c % 4 == 0)) * rate
        share = β * max(points.moduli[0, p], 0.0)
        for c in range(9):
            piola[c, p] = share * (of_volume * inverse[c] - trace * (H[c, p] + (c % 4 == 0)))
    return piola


@jit_part
def set_volume_viscosity(points: Points, H: Array, β: float, N: Array) -> None:
    """Sets what viscosity in volumes changes forces by with rates (m, m), symmetric."""
    m, P = len(N), H.shape[1]
    if not (β > 0 and P > 0 and points.kind[0] == NEO_HOOKEAN):
        N[:] = 0.0
        return
    less, more, left, right = np.empty((9, P)), np.empty((9, P)), np.empty((m, P)), np.empty((m, P))
    for p in range(P):
        inverse, share = _inverse(H, p), β / 2 * max(points.moduli[0, p], 0.0)
        for c in range(9):
            F = H[c, p] + (c % 4 == 0)
            less[c, p], more[c, p] = share * (inverse[c] - F), inverse[c] + F
    for n in range(m):
        _set_weighted(points.gradients[n], less, left[n])
        _set_weighted(points.gradients[n], more, right[n])
    half = np.empty((m, m))
    set_row_products(left, right, False, half)
    for i in range(m):
        for j in range(m):
            N[i, j] = half[i, j] + half[j, i]


@jit_part
def _set_weighted(G: Array, weights: Array, sums: Array) -> None:
    """Sets sums (P,) of the nine numbers of each point, of gradients (9 P,), times weights (9, P)."""
    P = len(sums)
    fill(sums, 0.0)
    for c in range(0, 9, 3):
        first, second, third = G[c * P : (c + 1) * P], G[(c + 1) * P : (c + 2) * P], G[(c + 2) * P : (c + 3) * P]
        add_products(weights[c], first, weights[c + 1], second, weights[c + 2], third, sums)


@jit_part
def add_geometric(points: Points, H: Array, rates: Array, β: float, size: float, matrix: Array) -> None:
    """Adds, so many times, what stresses at H (9, P) make stiff (m, m); also those that rates (9, P) add in volumes."""
    S = np.empty((6, H.shape[1]))
    for p in range(H.shape[1]):
        for n, stress in enumerate(stress_of(points, strains_at(H, p), p)):
            S[n, p] = stress
        if β > 0 and points.kind[0] == NEO_HOOKEAN:
            inverse, of_volume, trace, share = _inverse(H, p), 0.0, 0.0, β * max(points.moduli[0, p], 0.0)
            for n in range(9):
                of_volume += share * inverse[n] * rates[n, p]
                trace += share * (H[n, p] + (n % 4 == 0)) * rates[n, p]
            a, b, c, d, e, f, g, i, k = inverse
            S[0, p] += of_volume * (a * a + d * d + g * g) - trace
            S[1, p] += of_volume * (b * b + e * e + i * i) - trace
            S[2, p] += of_volume * (c * c + f * f + k * k) - trace
            S[3, p] += of_volume * (b * c + e * f + i * k)
            S[4, p] += of_volume * (a * c + d * f + g * k)
            S[5, p] += of_volume * (a * b + d * e + g * i)
    add_stressed(points, S, size, matrix)


@jit_part
def add_stressed(points: Points, S: Array, size: float, matrix: Array) -> None:
    """Adds, so many times, Σ S_jl ∂W_i/∂X_j ∂W_i/∂X_l (m, m) of stresses S (6, P), which hold the weights."""
    m, P = len(matrix), S.shape[1]
    stressed, sized, products = np.zeros((m, 9 * P)), size * S, np.empty((m, m))
    for k in range(m):
        for row in range(0, 9, 3):
            G, SG = points.gradients[k, row * P : (row + 3) * P], stressed[k, row * P : (row + 3) * P]
            first, second, third = G[:P], G[P : 2 * P], G[2 * P :]
            add_products(sized[0], first, sized[5], second, sized[4], third, SG[:P])
            add_products(sized[5], first, sized[1], second, sized[3], third, SG[P : 2 * P])
            add_products(sized[4], first, sized[3], second, sized[2], third, SG[2 * P :])
    set_row_products(points.gradients, stressed, True, products)
    for i in range(m):
        matrix[i, i] += products[i, i]
        for j in range(i + 1, m):
            matrix[i, j] += products[i, j]
            matrix[j, i] += products[i, j]


@jit_part
def add_resultant(points: Points, H: Array, S: Array, force: Array) -> None:
    """Adds Σ (F S) : ∇W_k (m,) of stresses S (6, P), which hold the weights, on points deformed by H (9, P)."""
    P = S.shape[1]
    piola = np.empty((9, P))
    for i in range(3):
        for p in range(P):
            a, b, c = H[3 * i, p] + (i == 0), H[3 * i + 1, p] + (i == 1), H[3 * i + 2, p] + (i == 2)
            piola[3 * i, p] = a * S[0, p] + b * S[5, p] + c * S[4, p]
            piola[3 * i + 1, p] = a * S[5, p] + b * S[1, p] + c * S[3, p]
            piola[3 * i + 2, p] = a * S[4, p] + b * S[3, p] + c * S[2, p]
    flat = piola.reshape(-1)
    for k in range(len(force)):
        force[k] += dot(points.gradients[k], flat)


@jit_part
def set_strains(H: Array, E: Array) -> None:
    """Sets Green's strains (6, P) of displacement gradients (9, P)."""
    for p in range(H.shape[1]):
        a, b, c, d, e, f, g, i, k = H[0, p], H[1, p], H[2, p], H[3, p], H[4, p], H[5, p], H[6, p], H[7, p], H[8, p]
        E[0, p] = a + (a * a + d * d + g * g) / 2
        E[1, p] = e + (b * b + e * e + i * i) / 2
        E[2, p] = k + (c * c + f * f + k * k) / 2
        E[3, p], E[4, p], E[5, p] = (
            f + i + b * c + e * f + i * k,
            c + g + a * c + d * f + g * k,
            b + d + a * b + d * e + g * i,
        )


@jit_part
def strains_at(H: Array, p: int) -> Six:
    """Green's strain of point p."""
    a, b, c, d, e, f, g, i, k = H[0, p], H[1, p], H[2, p], H[3, p], H[4, p], H[5, p], H[6, p], H[7, p], H[8, p]
    x, y, z = 2 * a + a * a + d * d + g * g, 2 * e + b * b + e * e + i * i, 2 * k + c * c + f * f + k * k
    return (
        x / 2,
        y / 2,
        z / 2,
        f + i + b * c + e * f + i * k,
        c + g + a * c + d * f + g * k,
        b + d + a * b + d * e + g * i,
    )


@jit_part
def stress_of(points: Points, E: Six, p: int) -> Six:
    """S of point p, with its weight."""
    λ, μ = points.moduli[0, p], points.moduli[1, p]
    if points.kind[0] == ST_VENANT:
        S = linear_stress(λ, μ, E)
    else:
        S = neo_hookean_stress(λ, μ, 2 * E[0], 2 * E[1], 2 * E[2], E[3], E[4], E[5])
    for t in range(points.starts[p], points.starts[p + 1]):
        slope = slope_along(points.threads, t, strain_along(points.threads, t, E))
        S = pulled_along(points.threads, t, slope, S)
    return S


@jit_part
def energy_of(points: Points, E: Six, p: int) -> float:
    """Of point p, J."""
    λ, μ, trace, (u, v, w) = points.moduli[0, p], points.moduli[1, p], E[0] + E[1] + E[2], (E[3], E[4], E[5])
    if points.kind[0] == ST_VENANT:
        square = E[0] ** 2 + E[1] ** 2 + E[2] ** 2
        energy = λ / 2 * trace**2 + μ * (square + (u * u + v * v + w * w) / 2)
    else:
        x, y, z = 2 * E[0], 2 * E[1], 2 * E[2]
        first = y * z + y + z - u * u
        lnJ = math.log1p(x * first + x + first + v * (w * u - v - v * y) + w * (u * v - w - w * z)) / 2
        energy = μ * (trace - lnJ) + λ / 2 * lnJ**2
    for t in range(points.starts[p], points.starts[p + 1]):
        energy += energy_along(points.threads, t, strain_along(points.threads, t, E))
    return energy


@jit_part
def linear_stress(λ: float, μ: float, E: Six) -> Six:
    """That of small strains."""
    on = λ * (E[0] + E[1] + E[2])
    return 2 * μ * E[0] + on, 2 * μ * E[1] + on, 2 * μ * E[2] + on, μ * E[3], μ * E[4], μ * E[5]


@jit_part
def linear_stress_of(points: Points, size: float, E: Six, p: int) -> Six:
    """So many times that of small strains at point p, with its weight and its fibres."""
    S = linear_stress(size * points.moduli[0, p], size * points.moduli[1, p], E)
    for t in range(points.starts[p], points.starts[p + 1]):
        slope = stiffness_at_rest(points.threads, t) * strain_along(points.threads, t, E)
        S = pulled_along(points.threads, t, size * slope, S)
    return S


@jit_part
def work(S: Six, E: Six) -> float:
    """S:E."""
    return S[0] * E[0] + S[1] * E[1] + S[2] * E[2] + S[3] * E[3] + S[4] * E[4] + S[5] * E[5]


@jit_part
def neo_hookean_stress(λ: float, μ: float, x: float, y: float, z: float, u: float, v: float, w: float) -> Six:
    """S where C - 1 has x, y and z on its diagonal, and yz, xz and xy are u, v and w: see `hyperelastic`."""
    first, second, third = y * z + y + z - u * u, z * x + z + x - v * v, x * y + x + y - w * w
    fourth, fifth, sixth = v * w - u - u * x, w * u - v - v * y, u * v - w - w * z
    change = x * first + x + first + v * fifth + w * sixth
    volumetric = λ * math.log1p(change) / 2
    shear = (volumetric - μ) / (1 + change)
    on = volumetric - shear * change
    return shear * first + on, shear * second + on, shear * third + on, shear * fourth, shear * fifth, shear * sixth
