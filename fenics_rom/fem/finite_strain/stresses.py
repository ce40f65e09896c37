"""Stresses of a body in a step or in equilibrium, and how they change with the displacement at its end.

One step takes H, E to H⁺, E⁺ (Simo & Tarnow, 1992; Gonzalez, 2000), with the viscosity β of a Kelvin-Voigt solid in the
Green strain, which a rotation does not feel:

    P = F_m S,   F_m = I + (H + H⁺)/2,   S = Ŝ(E, E⁺) + β (2 μ ΔE + λ (C⁻¹:ΔE) C⁻¹)/h,   Ŝ:ΔE = W(E⁺) - W(E),

with ΔE = E⁺ - E and C = I + E + E⁺, the mean of both ends. C⁻¹ is I where PointMaterial.dilating says so.
Where the material relaxes, S has that of its branches, too (mechanics/viscoelasticity.py, with E for x and C₀ for K):
C₀ (history + stiffening time ΔE/h). In equilibrium P = F S(E).
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import strain, strain_rate
from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.viscoelasticity import MaxwellBranches
from fenics_rom.mechanics.voigt import VOIGT_INDEX

IDENTITY = np.eye(3)[:, :, None]


@dataclass(frozen=True, eq=False)
class HyperelasticMaterial(PointMaterial):
    """What points are made of, with their viscosity β (P,), s."""

    viscosity: Array = field(kw_only=True)


class Stresses:
    """What a force and its derivative are made of.

    Attributes:
        F: that takes S to P (3, 3, P).
        F_end: F⁺ (3, 3, P).
        F_share: ∂F/∂F⁺, a number.
        S: second Piola-Kirchhoff stress (6, P), Pa.
    """

    F_share: float
    F: Array
    F_end: Array
    S: Array

    @property
    def P(self) -> Array:
        """First Piola-Kirchhoff stress P = F S (3, 3, P), Pa."""
        return multiply_voigt(self.F, self.S)

    def jvp(self, dH: Array) -> Array:
        """∂P/∂H⁺ dH⁺ (3, 3, P) of a change (3, 3, P) of H⁺."""
        dS = np.einsum("cdp,dp->cp", self.moduli, strain_rate(self.F_end, dH))
        return self.F_share * multiply_voigt(dH, self.S) + multiply_voigt(self.F, dS)

    @property
    def moduli(self) -> Array:
        """∂S/∂E⁺ (6, 6, P), Pa."""
        raise NotImplementedError


class MidpointStresses(Stresses):
    """Of a midpoint step of h, s, from H (3, 3, P), E (6, P) and W (P,) to H⁺, with branches as they are before it.

    Attributes, beside those of Stresses:
        rate: of the strain, and C₀ times it, (2, 6, P), 1/s and Pa/s.
    """

    F_share = 0.5

    def __init__(
        self,
        material: HyperelasticMaterial,
        H: Array,
        E: Array,
        W: Array,
        H_end: Array,
        h: float,
        branches: MaxwellBranches | None = None,
    ):
        self._material, self._h = material, h
        self.F, self.F_end = IDENTITY + (H + H_end) / 2, IDENTITY + H_end
        self.E, self.E_end, self._W = E, strain(H_end), W
        elastic = material.discrete_gradient_stress(E, self.E_end, W)
        Ė = (self.E_end - E) / h
        self.rate = np.stack([Ė, material.linear_stress(Ė)])
        self._branches, self._viscous = branches, material.viscous_stress((E + self.E_end) / 2, *self.rate)
        self.S = elastic + material.viscosity * self._viscous
        if branches is not None:
            self.S += branches.stiffening_time * self.rate[1] + branches.pull[1].reshape(6, -1)

    @property
    def heat(self) -> Array:
        """What viscosity dissipates in the step, (P,), J/m³; never negative."""
        return self._h * self._material.viscosity * (self.rate[0] * self._viscous).sum(axis=0)

    @cached_property
    def moduli(self) -> Array:
        """As in Stresses."""
        m = self._material
        by_rates, by_strain = m.viscous_slopes((self.E + self.E_end) / 2, self.rate[0])
        viscous = m.viscosity * (by_rates / self._h + by_strain / 2)
        if self._branches is not None:
            viscous = viscous + self._branches.stiffening_time / self._h * m.linear_moduli
        if m.is_quadratic:
            return m.linear_moduli / 2 + viscous
        return viscous + next(m.discrete_gradient_slopes(self.E, self.E_end, self._W))


class EquilibriumStresses(Stresses):
    """Of an equilibrium at displacement gradients H (3, 3, P)."""

    F_share = 1.0

    def __init__(self, material: HyperelasticMaterial, H: Array):
        self._material = material
        self.F = self.F_end = IDENTITY + H
        self.E = strain(H)
        self.S = material.stress(self.E)

    @cached_property
    def moduli(self) -> Array:
        """As in Stresses."""
        return self._material.moduli(self.E)


def multiply_voigt(F: Array, S: Array) -> Array:
    """F S (3, 3, P) of deformation gradients (3, 3, P) and stresses (6, P)."""
    matrix = S[VOIGT_INDEX]
    return F[:, 0, None] * matrix[None, 0] + F[:, 1, None] * matrix[None, 1] + F[:, 2, None] * matrix[None, 2]
