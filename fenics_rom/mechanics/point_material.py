"""What points of a body are made of: an isotropic law, and families of fibres beside it.

Strains and stresses are six components (`voigt.py`): arrays have them first, (6, P) of P points.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics import hyperelastic
from fenics_rom.mechanics.fibres import Fibres
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_SHEAR

ST_VENANT = "st_venant_kirchhoff"


@dataclass(frozen=True, eq=False)
class PointMaterial:
    """The material of P points: a law as `hyperelastic` has them, λ and μ (P,), Pa, and fibres."""

    law: str
    first_lame: Array
    shear: Array
    fibres: tuple[Fibres, ...] = ()

    @property
    def is_quadratic(self) -> bool:
        """Whether its energy is that of small strains, so that its stress is linear in the Green strain."""
        return self.law == ST_VENANT and all(family.law == "sheet" for family in self.fibres)

    def energy_density(self, E: Array) -> Array:
        """W (P,), J/m³."""
        W = hyperelastic.energy_density(self.law, E, self.first_lame, self.shear)
        for family in self.fibres:
            family.add_energy(W, E)
        return W

    def stress(self, E: Array) -> Array:
        """Second Piola-Kirchhoff stress S = ∂W/∂E (6, P), Pa."""
        S = hyperelastic.stress(self.law, E, self.first_lame, self.shear)
        for family in self.fibres:
            family.add_stress(S, E)
        return S

    def moduli(self, E: Array) -> Array:
        """∂S/∂E (6, 6, P), Pa."""
        if self.is_quadratic:
            return self.linear_moduli
        D = hyperelastic.moduli(self.law, E, self.first_lame, self.shear)
        for family in self.fibres:
            family.add_moduli(D, E)
        return D

    def stress_change(self, E: Array, dE: Array) -> Array:
        """∂S/∂E dE (6, P), Pa."""
        dS = hyperelastic.stress_change(self.law, E, dE, self.first_lame, self.shear)
        for family in self.fibres:
            family.add_stress_change(dS, E, dE)
        return dS

    def linear_stress(self, E: Array) -> Array:
        """C₀E (6, P, ...), Pa, of small strains (6, P, ...)."""
        λ, μ = (values.reshape(-1, *(1,) * (E.ndim - 2)) for values in (self.first_lame, self.shear))
        S = hyperelastic.linear_stress(E, λ, μ)
        for family in self.fibres:
            family.add_linear(S, E)
        return S

    @cached_property
    def linear_moduli(self) -> Array:
        """C₀ (6, 6, P), Pa, of small strains."""
        D = hyperelastic.moduli(ST_VENANT, np.zeros((6, len(self.shear))), self.first_lame, self.shear)
        for family in self.fibres:
            family.add_linear_moduli(D)
        return D

    @cached_property
    def dilating(self) -> Array:
        """λ (P,), Pa, of points whose viscosity resists J'/J; 0 where it resists tr Ė.

        That is so of St. Venant-Kirchhoff's law, whose elasticity has tr E for the change of volume, too, and where
        λ < 0: there 2μ Ė:Ė + λ (J'/J)² may be negative.
        """
        λ = self.first_lame
        return np.zeros_like(λ) if self.law == ST_VENANT else np.maximum(λ, 0.0)

    def viscous_stress(self, E: Array, rates: Array, linear: Array) -> Array:
        """2μ Ė + λ J'/J C⁻¹ (6, P), Pa/s, of strain rates (6, P) at E, and C₀Ė of fibres; times β it is a stress.

        `linear`: C₀Ė.
        """
        return linear + hyperelastic.volume_viscosity(E, rates, self.dilating) if self.dilating.any() else linear

    def viscous_slopes(self, E: Array, rates: Array) -> tuple[Array, Array]:
        """What the viscous stress changes by with the rates, and with E, (6, 6, P) each, or (6, 6, 1)."""
        if not self.dilating.any():
            return self.linear_moduli, np.zeros((6, 6, 1))
        by_rates, by_strain = hyperelastic.volume_viscosity_slopes(E, rates, self.dilating)
        return self.linear_moduli + by_rates, by_strain

    def energy_and_piola(self, H: Array) -> tuple[Array, Array]:
        """W (P,), J/m³, and the first Piola-Kirchhoff stress ∂W/∂H (9, P), Pa, of H (9, P), row by row."""
        W, first = hyperelastic.energy_and_piola(self.law, H, self.first_lame, self.shear)
        if self.fibres:
            H = H.reshape(3, 3, -1)
            E, S = hyperelastic.strain(H), np.zeros((6, H.shape[2]))
            for family in self.fibres:
                family.add_energy(W, E)
                family.add_stress(S, E)
            S = S[VOIGT_INDEX]
            first += (S + np.einsum("ijp,jkp->ikp", H, S)).reshape(9, -1)
        return W, first

    def discrete_gradient_stress(self, E: Array, after: Array, stored: Array | None = None) -> Array:
        """A stress Ŝ (6, P) with Ŝ:(E⁺ - E) = W(E⁺) - W(E), of second order: so a step balances energy exactly.

        The stress of the averaged strain (Simo & Tarnow, 1992), with Gonzalez' correction (2000) where W is not
        quadratic. W(E) (P,) may be known already, as `stored`.
        """
        S = self.stress((E + after) / 2)
        if self.is_quadratic:
            return S
        ΔE = after - E
        ΔW = self.energy_density(after) - (self.energy_density(E) if stored is None else stored)
        defect = ΔW - (S * ΔE).sum(axis=0)
        return S + defect / ((ΔE**2 / VOIGT_SHEAR).sum(axis=0) + hyperelastic.ROUND_OFF_STRAIN**2) * (ΔE / VOIGT_SHEAR)

    def discrete_gradient_slopes(self, E: Array, after: Array, stored: Array | None = None) -> Iterator[Array]:
        """∂Ŝ/∂E⁺, then ∂Ŝ/∂E, (6, 6, P), Pa, of the discrete gradient's stress; W(E) may be known, as `stored`."""
        mean = (E + after) / 2
        C = self.moduli(mean) / 2
        if self.is_quadratic:
            yield from (C, C)
            return
        ΔE, S = after - E, self.stress(mean)
        along = ΔE / VOIGT_SHEAR
        before = self.energy_density(E) if stored is None else stored
        defect = self.energy_density(after) - before - (S * ΔE).sum(axis=0)
        square = (ΔE * along).sum(axis=0) + hyperelastic.ROUND_OFF_STRAIN**2
        bent = np.einsum("cdp,cp->dp", C, ΔE)
        for side, at in ((1, after), (-1, E)):
            by_defect = side * (self.stress(at) - S) - bent - side * 2 * defect / square * along
            slope = C + along[:, None] * (by_defect / square)
            slope[np.arange(6), np.arange(6)] += side * defect / square / VOIGT_SHEAR
            yield slope

    def scaled(self, factors: Array) -> "PointMaterial":
        """With moduli times factors (P,): weights, as a rule."""
        fibres = tuple(family.scaled(factors) for family in self.fibres)
        return replace(self, first_lame=factors * self.first_lame, shear=factors * self.shear, fibres=fibres)

    def at(self, points: Array | slice) -> "PointMaterial":
        """Of some of the points, in their order."""
        count = len(self.shear)
        numbers = np.arange(count)[points]
        fibres = tuple(family.at(numbers, count) for family in self.fibres)
        return PointMaterial(self.law, self.first_lame[points], self.shear[points], fibres)

    def repeated(self, count: int) -> "PointMaterial":
        """Of points each of which is so often there, one after the other."""
        λ, μ = (np.repeat(values, count) for values in (self.first_lame, self.shear))
        return PointMaterial(self.law, λ, μ, tuple(family.repeated(count) for family in self.fibres))
