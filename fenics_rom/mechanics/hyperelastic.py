"""Isotropic hyperelastic materials, point by point, in the Green strain E = ½ (H + Hᵀ + HᵀH) of H = ∇u.

    st_venant_kirchhoff    W = λ/2 (tr E)² + μ E:E
    neo_hookean            W = μ (tr E - ln J) + λ/2 ln²J,  ln J = ½ ln det C,  C = I + 2E

Both have the linear material of Lamé's λ and μ as their limit of small strain. As functions of E they do not see a
rotation, and stay finite where a point is turned inside out.

A strain is kept as its six components (xx, yy, zz, yz, xz, xy), the shears twice: then S:E is a plain product, with the
stress in the same order. Arrays have the components first, (6, P) of P points, Lamé's moduli are (P,) each, Pa.
"""

import numpy as np
from numpy import ndarray as Array

LAWS = ("st_venant_kirchhoff", "neo_hookean")
VOIGT_PAIRS = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])  # of the six components
VOIGT_INDEX = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # which component each entry of a symmetric matrix is
VOIGT_SHEAR = np.array([1.0, 1, 1, 2, 2, 2])[:, None]  # how often each counts in S:E
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # of x, y, z
ROUND_OFF_STRAIN = 1e-7  # change of strain below which W(E⁺) - W(E) is round-off


def strain(H: Array) -> Array:
    """Green strain (6, P) of displacement gradients H (3, 3, P), H[i, j] = ∂u_i/∂X_j."""
    i, j = VOIGT_PAIRS.T
    return (VOIGT_SHEAR / 2) * (H[i, j] + H[j, i] + np.einsum("kcp,kcp->cp", H[:, i], H[:, j]))


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


def energy_density(law: str, E: Array, λ: Array, μ: Array) -> Array:
    """W (P,), J/m³."""
    trace = E[:3].sum(axis=0)
    if law == "st_venant_kirchhoff":
        return λ / 2 * trace**2 + μ * (E * E / VOIGT_SHEAR).sum(axis=0)
    lnJ = np.log1p(_adjugate(E)[2]) / 2
    return μ * (trace - lnJ) + λ / 2 * lnJ**2


def stress(law: str, E: Array, λ: Array, μ: Array) -> Array:
    """Second Piola-Kirchhoff stress S = ∂W/∂E (6, P), Pa."""
    if law == "st_venant_kirchhoff":
        return linear_stress(E, λ, μ)
    inverse, lnJ = _inverse_metric(E)
    unit = np.zeros((6, 1))
    unit[:3] = 1.0
    return μ * (unit - inverse) + λ * lnJ * inverse


def linear_stress(E: Array, λ: Array, μ: Array) -> Array:
    """λ tr(E) I + 2 μ E (6, P), Pa."""
    S = 2 * μ * E / VOIGT_SHEAR
    S[:3] += λ * E[:3].sum(axis=0)
    return S


def discrete_gradient_stress(law: str, E: Array, after: Array, λ: Array, μ: Array) -> Array:
    """A stress Ŝ (6, P) with Ŝ:(E⁺ - E) = W(E⁺) - W(E), of second order: so a step with it balances energy exactly.

    The stress of the averaged strain (Simo & Tarnow, 1992), with Gonzalez' correction (2000) where W is not quadratic.
    """
    S = stress(law, (E + after) / 2, λ, μ)
    if law == "st_venant_kirchhoff":
        return S
    ΔE = after - E
    ΔW = energy_density(law, after, λ, μ) - energy_density(law, E, λ, μ)
    defect = ΔW - (S * ΔE).sum(axis=0)
    return S + defect / ((ΔE**2 / VOIGT_SHEAR).sum(axis=0) + ROUND_OFF_STRAIN**2) * (ΔE / VOIGT_SHEAR)


def _adjugate(E: Array) -> tuple[Array, Array, Array]:
    """Of C = I + 2E: adj(C) but for the 1 of its diagonal, (3, P), and beside it, (3, P); and det C - 1 (P,).

    Without the cancellation of large terms. J is √det C.
    """
    on, off = 2 * E[:3], E[3:]  # of C - I
    one, other = on.take(_NEXT, axis=0), on.take(_LAST, axis=0)
    diagonal = one * other
    diagonal += one
    diagonal += other
    diagonal -= off * off
    beside = off.take(_NEXT, axis=0) * off.take(_LAST, axis=0)
    beside -= off
    beside -= off * on
    change = on[0] * diagonal[0]
    change += on[0]
    change += diagonal[0]
    change += off[1] * beside[1]
    change += off[2] * beside[2]
    return diagonal, beside, change


def _inverse_metric(E: Array) -> tuple[Array, Array]:
    """C⁻¹ (6, P) and ln J (P,)."""
    diagonal, beside, change = _adjugate(E)
    diagonal += 1
    inverse = np.concatenate([diagonal, beside])
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
    effective_shear = μ - λ * lnJ
    C = c[VOIGT_INDEX]  # the inverse metric as matrices (3, 3, P)
    (i, j), (k, m) = VOIGT_PAIRS.T[:, :, None], VOIGT_PAIRS.T[:, None, :]
    return λ * c[:, None] * c[None, :] + effective_shear * (C[i, k] * C[j, m] + C[i, m] * C[j, k])
