"""Isotropic hyperelastic materials, point by point, in the Green strain E = ½ (H + Hᵀ + HᵀH) of H = ∇u.

    st_venant_kirchhoff    W = λ/2 (tr E)² + μ E:E
    neo_hookean            W = μ (tr E - ln J) + λ/2 ln²J,  ln J = ½ ln det C,  C = I + 2E

and, of the shape without the change of volume, laws with constants (`isochoric.py`), to which they add
U = κ/4 (J² - 1 - 2 ln J) with κ = λ + ⅔ μ.

All have the linear material of Lamé's λ and μ as their limit of small strain. As functions of E they do not see a
rotation, and stay finite where a point is turned inside out.

Strains and stresses are six components (`voigt.py`): arrays have them first, (6, P) of P points, Lamé's moduli are
(P,) each, Pa.
"""

import math

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.isochoric import (
    isochoric_terms,
    metric_products,
    power_trace,
    power_trace_curvature,
    power_trace_slope,
    principal_strains,
)
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS, VOIGT_SHEAR

_ONE, _OTHER = VOIGT_PAIRS[3:].T  # of the shears
_NEXT, _LAST = np.array([1, 2, 0, 4, 5, 3]), np.array([2, 0, 1, 5, 3, 4])  # of x, y, z, and of the shears
# Of matrices as nine rows: whose products less whose products are the cofactors, the transposed, and sums of entries.
_COFACTORS = np.array(
    [np.roll(np.arange(9).reshape(3, 3), t, (0, 1)).ravel() for t in ((2, 2), (1, 1), (2, 1), (1, 2))]
)
_TRANSPOSED = np.arange(9).reshape(3, 3).T.ravel()
_DIAGONAL, _THIRDS, _HALVES = np.eye(3).ravel(), np.full(9, 1 / 3), np.full(9, 0.5)
ROUND_OFF_STRAIN = 1e-7  # change of strain below which W(E⁺) - W(E) is round-off


def strain(H: Array) -> Array:
    """Green strain (6, P) of displacement gradients H (3, 3, P), H[i, j] = ∂u_i/∂X_j."""
    E = np.empty((6, *H.shape[2:]))
    np.einsum("kcp,kcp->cp", H, H, out=E[:3])
    E[:3] /= 2
    E[:3] += H.diagonal().T
    E[3] = np.einsum("kp,kp->p", H[:, 1], H[:, 2])
    E[4] = np.einsum("kp,kp->p", H[:, 0], H[:, 2])
    E[5] = np.einsum("kp,kp->p", H[:, 0], H[:, 1])
    E[3:] += H[_ONE, _OTHER]
    E[3:] += H[_OTHER, _ONE]
    return E


def small_strain(H: Array) -> Array:
    """(H + Hᵀ)/2, with the shears twice, (6, ...), of H (3, 3, ...)."""
    i, j = VOIGT_PAIRS.T
    strains: Array = (VOIGT_SHEAR[:, 0] / 2 * (H[i, j] + H[j, i]).T).T
    return strains


def strain_rate(F: Array, dH: Array) -> Array:
    """Change (6, P) of the Green strain, ½ (Fᵀ dH + dHᵀ F), with that of H (3, 3, P), where F = I + H."""
    FᵀdH = F[0][:, None] * dH[0] + F[1][:, None] * dH[1] + F[2][:, None] * dH[2]
    (i, j), shear = VOIGT_PAIRS.T, slice(3, None)
    rates = FᵀdH[i, j]
    rates[shear] += FᵀdH[j[shear], i[shear]]
    return rates


def principal_stretches(E: Array) -> Array:
    """(P, 3) of strains (6, P)."""
    stretches: Array = np.sqrt(1 + 2 * principal_strains(E)[0])
    return stretches


def energy_density(law: str, E: Array, λ: Array, μ: Array) -> Array:
    """W (P,), J/m³."""
    trace = E[:3].sum(axis=0)
    if law == "st_venant_kirchhoff":
        return λ / 2 * trace**2 + μ * (E * E / VOIGT_SHEAR).sum(axis=0)
    change = _adjugate(E)[1]
    lnJ = np.log1p(change) / 2
    if law == "neo_hookean":
        return μ * (trace - lnJ) + λ / 2 * lnJ**2
    W = (λ + 2 / 3 * μ) / 4 * (change - 2 * lnJ)
    for term in isochoric_terms(law):
        W += term.k * μ * term.energy(power_trace(E, term.β, lnJ))
    return W


def stress(law: str, E: Array, λ: Array, μ: Array) -> Array:
    """Second Piola-Kirchhoff stress S = ∂W/∂E (6, P), Pa."""
    if law == "st_venant_kirchhoff":
        return linear_stress(E, λ, μ)
    if law == "neo_hookean":
        return _neo_hookean_stress(E, λ, μ)
    inverse, lnJ = _inverse_metric(E)
    S = (λ + 2 / 3 * μ) / 2 * np.expm1(2 * lnJ) * inverse
    for term in isochoric_terms(law):
        slope = term.slope(power_trace(E, term.β, lnJ))
        S += term.k * μ * slope * power_trace_slope(E, term.β, inverse, lnJ)
    return S


def _neo_hookean_stress(E: Array, λ: Array, μ: Array) -> Array:
    """μ (1 - C⁻¹) + λ ln J C⁻¹ (6, P), where 1 - C⁻¹ = (det C - adj C)/det C cancels nothing."""
    S, change = _adjugate(E)
    volumetric = λ * (np.log1p(change) / 2)
    shear = (volumetric - μ) / (1 + change)
    S *= shear
    S[:3] += volumetric - shear * change
    return S


def energy_and_piola(law: str, H: Array, λ: Array, μ: Array) -> tuple[Array, Array]:
    """W (P,), J/m³, and the first Piola-Kirchhoff stress ∂W/∂H (9, P), Pa, of H (9, P), row by row."""
    if law == "neo_hookean":
        return _neo_hookean_energy_and_piola(H, λ, μ)
    H = H.reshape(3, 3, -1)
    E, F = strain(H), H + np.eye(3)[:, :, None]
    S = stress(law, E, λ, μ)[VOIGT_INDEX]
    return energy_density(law, E, λ, μ), np.einsum("ijp,jkp->ikp", F, S).reshape(9, -1)


def _neo_hookean_energy_and_piola(H: Array, λ: Array, μ: Array) -> tuple[Array, Array]:
    """μ (tr E - ln J) + λ/2 ln²J and μ (F - F⁻ᵀ) + λ ln J F⁻ᵀ, where X = 1 - cof F, small as H, cancels nothing."""
    factors = H.take(_COFACTORS, 0)
    cofactors = factors[0] * factors[1]
    factors[2] *= factors[3]
    cofactors -= factors[2]
    trace = _DIAGONAL.dot(H)
    change = _DIAGONAL.dot(cofactors)  # J - 1
    change += trace
    change += _THIRDS.dot(H * cofactors)
    J = 1 + change
    lnJ = np.log1p(change * (1 + J)) / 2  # of |J|, where a point is turned inside out
    volumetric = λ * lnJ
    W: Array = trace - lnJ
    W += _HALVES.dot(H * H)
    W *= μ
    W += volumetric * lnJ / 2
    X = H.take(_TRANSPOSED, 0)
    X -= cofactors
    X[::4] -= trace
    X *= (μ - volumetric) / J
    P: Array = μ * H
    P += X
    P[::4] += (μ * change + volumetric) / J
    return W, P


def stress_change(law: str, E: Array, dE: Array, λ: Array, μ: Array) -> Array:
    """∂S/∂E dE (6, P), Pa; for neo-Hookean points in a fifth of the time of `moduli`."""
    if law == "st_venant_kirchhoff":
        return linear_stress(dE, λ, μ)
    if law != "neo_hookean":
        return np.einsum("cdp,dp->cp", moduli(law, E, λ, μ), dE)
    c, lnJ = _inverse_metric(E)
    inverse = c[VOIGT_INDEX].transpose(2, 0, 1)
    turned = inverse @ (dE / VOIGT_SHEAR)[VOIGT_INDEX].transpose(2, 0, 1) @ inverse
    i, j = VOIGT_PAIRS.T
    change: Array = λ * (c * dE).sum(axis=0) * c + 2 * (μ - λ * lnJ) * turned[:, i, j].T
    return change


def linear_stress(E: Array, λ: Array, μ: Array) -> Array:
    """λ tr(E) I + 2 μ E (6, P), Pa."""
    S = μ * E
    S[:3] *= 2
    S[:3] += λ * (E[0] + E[1] + E[2])
    return S


def volume_viscosity(E: Array, rates: Array, λ: Array) -> Array:
    """λ (J'/J C⁻¹ - tr Ė 1) (6, P), Pa/s: what strain rates Ė (6, P) at E make beside `linear_stress` of them.

    J'/J = C⁻¹:Ė is the rate at which a volume changes. Ė itself has a trace where volumes stay as they are.
    """
    g = _inverse_metric(E)[0]
    S: Array = λ * (g * rates).sum(axis=0) * g
    S[:3] -= λ * (rates[0] + rates[1] + rates[2])
    return S


def volume_viscosity_slopes(E: Array, rates: Array, λ: Array) -> tuple[Array, Array]:
    """What `volume_viscosity` changes by with the rates, and with E, (6, 6, P) each."""
    g = _inverse_metric(E)[0]
    turned = metric_products(g)
    by_rates = λ * g[:, None] * g[None, :]
    by_rates[:3, :3] -= λ
    along = np.einsum("cdp,dp->cp", turned, rates)
    by_strain: Array = -2 * λ * (g[:, None] * along[None, :] + (g * rates).sum(axis=0) * turned)
    return by_rates, by_strain


def strain_of_excess_damping(poisson: float, share: float = 0.1) -> float:
    """Strain at which `linear_stress` of a rate takes a share more power than shear does, though the volume stays.

    Green's strain (e^2ε - 1)/2, twice (e^-ε - 1)/2 of such a stretch has a trace of 3/2 ε², which λ takes for a change
    of volume: (λ (3 ε ε̇)²) / (2 μ 3/2 ε̇²) = 3 λ/μ ε². Infinite of materials that are as soft against it as in shear.
    """
    ratio = 2 * poisson / (1 - 2 * poisson)
    return math.sqrt(share / (3 * ratio)) if ratio > 1 else math.inf


def _adjugate(E: Array) -> tuple[Array, Array]:
    """Of C = I + 2E: adj(C) but for the 1 of its diagonal, (6, P), and det C - 1 (P,).

    Without the cancellation of large terms. J is √det C.
    """
    X = E.copy()  # C - I
    X[:3] *= 2
    on, off = X[:3], X[3:]
    adjugate, last = X.take(_NEXT, axis=0), X.take(_LAST, axis=0)
    beside = adjugate[:3] + last[:3]
    adjugate *= last
    adjugate[:3] += beside
    adjugate[:3] -= off * off
    adjugate[3:] -= off
    adjugate[3:] -= off * on
    change = on[0] * adjugate[0]
    change += on[0]
    change += adjugate[0]
    change += off[1] * adjugate[4]
    change += off[2] * adjugate[5]
    return adjugate, change


def _inverse_metric(E: Array) -> tuple[Array, Array]:
    """C⁻¹ (6, P) and ln J (P,)."""
    inverse, change = _adjugate(E)
    inverse[:3] += 1
    inverse /= 1 + change
    return inverse, np.log1p(change) / 2


def moduli(law: str, E: Array, λ: Array, μ: Array) -> Array:
    """∂S/∂E (6, 6, P), Pa."""
    if law == "st_venant_kirchhoff":
        D = np.zeros((6, 6, E.shape[1]))
        D[:3, :3] = λ
        D[np.arange(6), np.arange(6)] += 2 * μ / VOIGT_SHEAR
        return D
    c, lnJ = _inverse_metric(E)
    turned = metric_products(c)
    if law == "neo_hookean":
        return λ * c[:, None] * c[None, :] + 2 * (μ - λ * lnJ) * turned
    κ, change = λ + 2 / 3 * μ, np.expm1(2 * lnJ)
    D = κ * ((1 + change) * c[:, None] * c[None, :] - change * turned)
    for term in isochoric_terms(law):
        x = power_trace(E, term.β, lnJ)
        D += term.k * μ * term.slope(x) * power_trace_curvature(E, term.β, c, lnJ)
        if term.bends:
            along = power_trace_slope(E, term.β, c, lnJ)
            D += term.k * μ * term.curvature(x) * along[:, None] * along[None, :]
    return D
