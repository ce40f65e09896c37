"""Families of fibres: what they store of their own strain, beside what an isotropic law stores.

A family has the strain e = M:E at a point, M = κ 1 + (1 - 3κ) a⊗a of its direction a and dispersion κ. So its
stress is ψ'(e) M, and its moduli are ψ''(e) M⊗M. With κ = 0 the stretch along a is √(1 + 2e).

    quadratic     ψ = k/2 (√(1 + 2e) - 1)²           a spring in the stretch, which pulls and pushes
    holzapfel     ψ = k/2s (exp(s (2e)²) - 1), e > 0   (Holzapfel, Gasser & Ogden, 2000; with κ Gasser et al., 2006)
    sheet         ψ = k/2 e²                           of a membrane, with M its plane, too

E is the strain with its change of volume. That of the shape alone would have fibres stretch under a pressure from all
sides, and say that a sphere stays one then (Sansour, 2008; Nolan et al., 2014). Where volume stays both are the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS

LARGEST_EXPONENT = 25.0  # s (2e)² from where on W is a parabola, so that an iteration that goes astray has numbers
SHORTEST = 1e-6  # square of the stretch below which a spring is not shortened further


class _Law(NamedTuple):
    """ψ, ψ' and ψ'' of e, over k and with s; and ψ''(0), where fibres neither pull nor push."""

    energy: Callable[[Array, Array], Array]
    slope: Callable[[Array, Array], Array]
    curvature: Callable[[Array, Array], Array]
    at_rest: float


def _stretch(e: Array) -> Array:
    stretch: Array = np.sqrt(np.maximum(1 + 2 * e, SHORTEST))
    return stretch


def _parted(e: Array, s: Array) -> tuple[Array, Array]:
    """2e where it is positive up to the parabola, and by how much it is beyond."""
    most = np.sqrt(LARGEST_EXPONENT / np.maximum(s, 1e-12))
    known = np.clip(2 * e, 0.0, most)
    return known, np.maximum(2 * e - most, 0.0)


def _holzapfel(e: Array, s: Array) -> tuple[Array, Array, Array]:
    """Energy over k, and its derivatives by 2e."""
    x, beyond = _parted(e, s)
    square = s * x * x
    grown = np.exp(square)
    curvature = np.where(e > 0, (1 + 2 * square) * grown, 0.0)
    small = s < np.finfo(float).eps
    energy = np.where(small, x * x / 2, np.expm1(square) / np.where(small, 1.0, 2 * s))
    slope = x * grown
    return energy + beyond * (slope + beyond * curvature / 2), slope + beyond * curvature, curvature


FIBRE_LAWS = {
    "quadratic": _Law(
        lambda e, s: (2 * e / (1 + _stretch(e))) ** 2 / 2,
        lambda e, s: 2 * e / (1 + _stretch(e)) / _stretch(e),
        lambda e, s: _stretch(e) ** -3,
        1.0,
    ),
    "holzapfel": _Law(
        lambda e, s: _holzapfel(e, s)[0],
        lambda e, s: 2 * _holzapfel(e, s)[1],
        lambda e, s: 4 * _holzapfel(e, s)[2],
        0.0,
    ),
    "sheet": _Law(lambda e, s: e * e / 2, lambda e, s: e, lambda e, s: np.ones_like(e), 1.0),
}


@dataclass(frozen=True, eq=False)
class Fibres:
    """One family of fibres, at some points of a body.

    Attributes:
        law: of `FIBRE_LAWS`.
        points: (K,) which points of the body, each once.
        structure: M (6, K).
        modulus: k (K,), Pa.
        stiffening: s (K,).
    """

    law: str
    points: Array
    structure: Array
    modulus: Array
    stiffening: Array

    @property
    def stiffness_at_rest(self) -> Array:
        """ψ''(0) (K,), Pa: of fibres that only pull nothing."""
        return self.modulus * FIBRE_LAWS[self.law].at_rest

    def strains(self, E: Array) -> Array:
        """e (K, ...) of strains (6, P, ...)."""
        return np.einsum("ck,ck...->k...", self.structure, E[:, self.points])

    def exponent(self, E: Array) -> Array:
        """s (2e)² (K,) of strains (6, P) where they pull; beyond LARGEST_EXPONENT the energy is a parabola."""
        return self.stiffening * np.maximum(2 * self.strains(E), 0.0) ** 2

    def add_energy(self, W: Array, E: Array) -> None:
        """To those (P,) of strains (6, P), J/m³."""
        W[self.points] += self.modulus * FIBRE_LAWS[self.law].energy(self.strains(E), self.stiffening)

    def add_stress(self, S: Array, E: Array) -> None:
        """To those (6, P) of strains (6, P), Pa."""
        S[:, self.points] += self.modulus * self.slope(E) * self.structure

    def slope(self, E: Array) -> Array:
        """ψ' over k, (K,), of strains (6, P)."""
        return FIBRE_LAWS[self.law].slope(self.strains(E), self.stiffening)

    def add_moduli(self, D: Array, E: Array) -> None:
        """To those (6, 6, P) of strains (6, P), Pa."""
        D[:, :, self.points] += self._curvature(E) * self.structure[:, None] * self.structure[None, :]

    def add_stress_change(self, dS: Array, E: Array, dE: Array) -> None:
        """To that (6, P) with a change of strains (6, P), Pa."""
        dS[:, self.points] += self._curvature(E) * self.strains(dE) * self.structure

    def add_linear(self, S: Array, E: Array) -> None:
        """To the stress of small strains (6, P, ...), Pa."""
        of_point = self.stiffness_at_rest.reshape(-1, *(1,) * (E.ndim - 2))
        S[:, self.points] += np.einsum("k...,ck->ck...", of_point * self.strains(E), self.structure)

    def add_linear_moduli(self, D: Array) -> None:
        """To those (6, 6, P) of small strains, Pa."""
        D[:, :, self.points] += self.stiffness_at_rest * self.structure[:, None] * self.structure[None, :]

    def scaled(self, factors: Array) -> "Fibres":
        """With moduli times factors (P,) of the body's points."""
        return Fibres(self.law, self.points, self.structure, factors[self.points] * self.modulus, self.stiffening)

    def at(self, points: Array, count: int) -> "Fibres":
        """Of some of the `count` points of the body, in their order."""
        number = np.full(count, -1)
        number[points] = np.arange(len(points))
        kept = number[self.points] >= 0
        return Fibres(
            self.law, number[self.points[kept]], self.structure[:, kept], self.modulus[kept], self.stiffening[kept]
        )

    def repeated(self, count: int) -> "Fibres":
        """Of points each of which is so often there, one after the other."""
        points = (count * self.points[:, None] + np.arange(count)).ravel()
        each = (np.repeat(values, count, axis=-1) for values in (self.structure, self.modulus, self.stiffening))
        return Fibres(self.law, points, *each)

    def _curvature(self, E: Array) -> Array:
        """ψ'' (K,), Pa, of strains (6, P)."""
        return self.modulus * FIBRE_LAWS[self.law].curvature(self.strains(E), self.stiffening)


def pushed_along(fibres: tuple[Fibres, ...], E: Array) -> tuple[Array, Array]:
    """How hard fibres together push along one direction at most (P,), Pa, and the stretch there (P,).

    Beside a neo-Hookean law a change m⊗N of F, with m across all fibres, stores ½ (μ + N·S·N) m², where S = Σ ψ' M is
    the fibres' stress. From a push of μ on W is not elliptic, and fibres fold. Those that only pull never do.
    """
    S = np.zeros(E.shape)
    for family in fibres:
        family.add_stress(S, E)
    values, directions = np.linalg.eigh(S[VOIGT_INDEX].transpose(2, 0, 1))
    along = directions[:, :, 0]
    elongation = np.einsum("cp,cp->p", structure_of(along), E)
    return -values[:, 0], np.sqrt(np.maximum(1 + 2 * elongation, 0.0))


def structure_of(directions: Array, dispersion: float = 0.0) -> Array:
    """M (6, K) of unit directions (K, 3)."""
    i, j = VOIGT_PAIRS.T
    structure: Array = (1 - 3 * dispersion) * (directions[:, i] * directions[:, j]).T
    structure[:3] += dispersion
    return structure


def check_fibres(fibres: tuple[Fibres, ...], count: int) -> None:
    """Of a body of so many points.

    Raises:
        ValueError: they have no such law, are of no points or twice of one, or their moduli are no moduli.
    """
    for family in fibres:
        if family.law not in FIBRE_LAWS:
            raise ValueError(f"fibres have the law {family.law!r}; use {', '.join(FIBRE_LAWS)}")
        points, sizes = family.points, np.concatenate([family.modulus, family.stiffening])
        if len(np.unique(points)) < len(points) or not np.isin(points, np.arange(count)).all():
            raise ValueError("fibres are of points that are not there, or twice of one")
        if not (np.isfinite(sizes).all() and np.isfinite(family.structure).all()) or sizes.min(initial=0.0) < 0:
            raise ValueError("moduli of fibres are negative, or not finite")
