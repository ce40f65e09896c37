"""Laws of rubber: energy densities of the shape without the change of volume, C̄ = C/J^⅔.

With x_β = tr C̄^β - 3, which is I₁ - 3 for β = 1 and I₂ - 3 for β = -1,

    mooney_rivlin C10 C01      W = C10 x₁ + C01 x₋₁                                     (Mooney, 1940; Rivlin, 1948)
    yeoh C10 C20 C30           W = Σ Cn0 x₁ⁿ                                            (Yeoh, 1993)
    ogden μ1 α1 μ2 α2 ...      W = Σ μn/αn x_(αn/2)                                     (Ogden, 1972)
    gent Jm                    W = -μ/2 Jm ln(1 - x₁/Jm)                                (Gent, 1996)
    arruda_boyce λm            W = μ Σ Cn/λm^(2n-2) ((x₁ + 3)ⁿ - 3ⁿ), five terms        (Arruda & Boyce, 1993)

Their size is that of μ: constants that are stresses count by their ratios, in any unit; Jm and λm are numbers. A law is
a text, of its name and its constants. Gent's x₁ ends at Jm, where chains are stretched out; beyond 0.99 of that W
goes on as a parabola, so that an iteration that goes astray has numbers.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS, VOIGT_SHEAR

LAWS = ("st_venant_kirchhoff", "neo_hookean")  # which have no constants, and no such terms
UNIT = np.array([1.0, 1, 1, 0, 0, 0])[:, None]  # the unit matrix
SAME_STRETCH = 1e-5  # difference of the eigenvalues of C below which a difference quotient is a derivative
LAST_SHARE = 0.99  # of the largest x, from where W is a parabola
LANGEVIN = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)  # of the inverse Langevin function, term by term


class IsochoricTerm(NamedTuple):
    """k μ xⁿ of an energy density, x = tr C̄^β - 3; with a largest x, -k μ x_max ln(1 - x/x_max)."""

    k: float
    β: float
    n: int = 1
    largest: float = math.inf  # x

    @property
    def bends(self) -> bool:
        """Whether it is not linear in x."""
        return self.n > 1 or self.largest < math.inf

    def energy(self, x: Array) -> Array:
        """Over k μ."""
        if self.largest == math.inf:
            return x**self.n
        share, beyond = self._parted(x)
        parabola = beyond / (1 - share) + beyond**2 / (2 * (1 - share) ** 2)
        return self.largest * (parabola - np.log1p(-share))

    def slope(self, x: Array) -> Array:
        """Derivative of the energy by x."""
        if self.largest == math.inf:
            return self.n * x ** (self.n - 1)
        share, beyond = self._parted(x)
        return 1 / (1 - share) + beyond / (1 - share) ** 2

    def curvature(self, x: Array) -> Array:
        """Second derivative."""
        if self.largest == math.inf:
            return self.n * (self.n - 1) * x ** max(self.n - 2, 0)
        return 1 / (self.largest * (1 - self._parted(x)[0]) ** 2)

    def _parted(self, x: Array) -> tuple[Array, Array]:
        """x/x_max up to the parabola, and by how much it is beyond."""
        share = x / self.largest
        known = np.minimum(share, LAST_SHARE)
        return known, share - known


class _Law(NamedTuple):
    """What constants a law has, and the terms that they make, of any size."""

    allowed: Callable[[Sequence[float]], bool]
    says: str  # of what is allowed
    terms: Callable[[Sequence[float]], list[IsochoricTerm]]


def _arruda_boyce(λm: float) -> list[IsochoricTerm]:
    """(x + 3)ⁿ - 3ⁿ in powers of x."""
    return [
        IsochoricTerm(
            sum(c * λm ** (2 - 2 * n) * math.comb(n, p) * 3 ** (n - p) for n, c in _counted(LANGEVIN)), 1.0, p
        )
        for p, _ in _counted(LANGEVIN)
    ]


def _counted(values: Sequence[float]) -> list[tuple[int, float]]:
    """From 1."""
    return list(enumerate(values, start=1))


_LAWS = {
    "mooney_rivlin": _Law(
        lambda c: len(c) == 2, "two, C10 and C01", lambda c: [IsochoricTerm(c[0], 1.0), IsochoricTerm(c[1], -1.0)]
    ),
    "yeoh": _Law(
        lambda c: 1 <= len(c) <= 3,
        "one to three, C10, C20 and C30",
        lambda c: [IsochoricTerm(constant, 1.0, n) for n, constant in _counted(c)],
    ),
    "ogden": _Law(
        lambda c: len(c) > 0 and len(c) % 2 == 0 and all(c[1::2]),
        "pairs of μ and of α, which is not 0",
        lambda c: [IsochoricTerm(μ / α, α / 2) for μ, α in zip(c[::2], c[1::2], strict=True)],
    ),
    "gent": _Law(
        lambda c: len(c) == 1 and c[0] > 0,
        "one, Jm > 0, the largest I1 - 3",
        lambda c: [IsochoricTerm(0.5, 1.0, largest=c[0])],
    ),
    "arruda_boyce": _Law(
        lambda c: len(c) == 1 and c[0] > 1,
        "one, λm > 1, the stretch at which chains lock",
        lambda c: _arruda_boyce(c[0]),
    ),
}
_NO_LAW = _Law(lambda c: False, "none", lambda c: [])
LAWS_WITH_CONSTANTS = tuple(_LAWS)


@cache
def isochoric_terms(law: str) -> tuple[IsochoricTerm, ...]:
    """Of a law with constants; none of one without.

    Raises:
        ValueError: what is wrong with its name or its constants, and what is allowed.
    """
    name, *texts = law.split(" ")
    constants = [float(text) for text in texts]
    if name in LAWS and not constants:
        return ()
    kind = _LAWS.get(name, _NO_LAW)
    if not kind.allowed(constants):
        raise ValueError(f"{name} has the constants {constants}: use {kind.says}")
    terms = kind.terms(constants)
    shear = shear_modulus(terms)
    if not shear > 0:
        raise ValueError(f"{name} has the constants {constants}, and {shear:g} as its shear modulus: use > 0")
    return tuple(term._replace(k=term.k / shear) for term in terms)


def shear_modulus(terms: Iterable[IsochoricTerm]) -> float:
    """At rest, over μ."""
    return sum(2 * term.k * term.β**2 for term in terms if term.n == 1)


def metric_products(c: Array) -> Array:
    """-∂C⁻¹/∂C (6, 6, P) of the inverse metric (6, P)."""
    C = c[VOIGT_INDEX]  # as matrices (3, 3, P)
    (i, j), (k, m) = VOIGT_PAIRS.T[:, :, None], VOIGT_PAIRS.T[:, None, :]
    products: Array = (C[i, k] * C[j, m] + C[i, m] * C[j, k]) / 2
    return products


# --- x and its derivatives by E -------------------------------------------------------------------------------------


def principal_strains(E: Array) -> tuple[Array, Array]:
    """Principal strains (P, 3) and their directions (P, 3, 3), in columns."""
    values, directions = np.linalg.eigh((E / VOIGT_SHEAR)[VOIGT_INDEX].transpose(2, 0, 1))
    return values, directions


def power_trace(E: Array, β: float, lnJ: Array) -> Array:
    """x (P,), without the cancellation of 3."""
    if β == 1:
        return 3 * np.expm1(-2 / 3 * lnJ) + 2 * np.exp(-2 / 3 * lnJ) * E[:3].sum(axis=0)
    x: Array = np.expm1(β * (np.log1p(2 * principal_strains(E)[0]) - 2 / 3 * lnJ[:, None])).sum(axis=1)
    return x


def _metric_power(E: Array, exponent: float) -> Array:
    """C^exponent (6, P)."""
    if exponent == 0:
        return np.repeat(UNIT, E.shape[1], axis=1)
    values, n = principal_strains(E)
    i, j = VOIGT_PAIRS.T
    return np.einsum("pa,pca,pca->cp", (1 + 2 * values) ** exponent, n[:, i], n[:, j])


def power_trace_slope(E: Array, β: float, inverse: Array, lnJ: Array) -> Array:
    """∂x/∂E (6, P) = 2β J^(-2β/3) (C^(β-1) - ⅓ tr C^β C⁻¹), with C⁻¹ (6, P)."""
    scale = np.exp(-2 * β / 3 * lnJ)
    third = (power_trace(E, β, lnJ) + 3) / scale / 3
    return 2 * β * scale * (_metric_power(E, β - 1) - third * inverse)


def power_trace_curvature(E: Array, β: float, inverse: Array, lnJ: Array) -> Array:
    """∂²x/∂E² (6, 6, P), with C⁻¹ (6, P)."""
    scale, power = np.exp(-2 * β / 3 * lnJ), _metric_power(E, β - 1)
    third = (power_trace(E, β, lnJ) + 3) / scale / 3
    mixed = power[:, None] * inverse[None, :]
    D = -β / 3 * (mixed + mixed.transpose(1, 0, 2)) + β / 3 * third * inverse[:, None] * inverse[None, :]
    D += third * metric_products(inverse)
    if β != 1:
        D += _metric_power_slope(E, β - 1)
    return 4 * β * scale * D


def _metric_power_slope(E: Array, exponent: float) -> Array:
    """∂C^exponent/∂C (6, 6, P), by its difference quotients in principal directions (Daleckii & Krein, 1965)."""
    values, n = principal_strains(E)
    c = 1 + 2 * values
    difference, mean = c[:, :, None] - c[:, None, :], (c[:, :, None] + c[:, None, :]) / 2
    apart = np.abs(difference) > SAME_STRETCH * mean
    powers = c**exponent
    quotients = exponent * mean ** (exponent - 1)
    np.divide(powers[:, :, None] - powers[:, None, :], difference, out=quotients, where=apart)
    i, j = VOIGT_PAIRS.T
    pairs = n[:, i, :, None] * n[:, j, None, :]  # n_a n_bᵀ in components (P, 6, 3, 3)
    pairs = (pairs + pairs.swapaxes(2, 3)) / 2
    return np.einsum("pab,pcab,pdab->cdp", quotients, pairs, pairs)
