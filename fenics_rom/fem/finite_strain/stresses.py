"""Stresses of a body in a step or in equilibrium, and how they change with the displacement at its end.

One step takes H, E to H⁺, E⁺ (Simo & Tarnow, 1992; Gonzalez, 2000), with the viscosity β of a Kelvin-Voigt solid in the
Green strain, which a rotation does not feel:

    P = F_m S,   F_m = I + (H + H⁺)/2,   S = Ŝ(E, E⁺) + β (λ tr ΔE I + 2 μ ΔE)/h,   Ŝ:ΔE = W(E⁺) - W(E),  ΔE = E⁺ - E.

In equilibrium P = F S(E).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_rom.mechanics.hyperelastic import (
    ROUND_OFF_STRAIN,
    VOIGT_INDEX,
    VOIGT_SHEAR,
    discrete_gradient_stress,
    energy_density,
    linear_stress,
    moduli,
    strain,
    strain_rate,
    stress,
)

Array = np.ndarray
UNIT = np.eye(3)[:, :, None]


@dataclass(frozen=True)
class Material:
    """The hyperelastic material of points.

    Attributes:
        law: one of `hyperelastic.LAWS`.
        first_lame, shear: λ and μ (P,), Pa.
        viscosity: β (P,), s.
    """

    law: str
    first_lame: Array
    shear: Array
    viscosity: Array

    def energy_density(self, E: Array) -> Array:
        """W (P,), J/m³."""
        return energy_density(self.law, E, self.first_lame, self.shear)

    def viscous(self, ΔE: Array, h: float) -> Array:
        """Viscous stress (6, P), Pa, where the strain changes by ΔE in h, s."""
        return self.viscosity / h * linear_stress(ΔE, self.first_lame, self.shear)

    @cached_property
    def linear_moduli(self) -> Array:
        """(6, 6, P), Pa, of small strains."""
        return moduli("st_venant_kirchhoff", np.zeros((6, len(self.shear))), self.first_lame, self.shear)

    def moduli(self, E: Array) -> Array:
        """∂S/∂E (6, 6, P), Pa."""
        if self.law == "st_venant_kirchhoff":
            return self.linear_moduli
        return moduli(self.law, E, self.first_lame, self.shear)


class Stresses:
    """What a force and its derivative are made of.

    Attributes:
        frame: F that takes S to P (3, 3, P).
        end: F⁺ (3, 3, P).
        S: second Piola-Kirchhoff stress (6, P), Pa.
    """

    share: float  # ∂frame/∂F⁺
    frame: Array
    end: Array
    S: Array

    @property
    def first(self) -> Array:
        """First Piola-Kirchhoff stress P = F S (3, 3, P), Pa."""
        return carried(self.frame, self.S)

    def changed(self, dH: Array) -> Array:
        """Change (3, 3, P) of P with that of H⁺, (3, 3, P)."""
        dS = np.einsum("cdp,dp->cp", self.moduli, strain_rate(self.end, dH))
        return self.share * carried(dH, self.S) + carried(self.frame, dS)

    @property
    def moduli(self) -> Array:
        """∂S/∂E⁺ (6, 6, P), Pa."""
        raise NotImplementedError


class StressesInStep(Stresses):
    """Of a step.

    Args:
        material: of the points.
        H, E: at the start of the step, (3, 3, P) and (6, P).
        after: H⁺ (3, 3, P).
        h: of the step, s.
    """

    share = 0.5

    def __init__(self, material: Material, H: Array, E: Array, after: Array, h: float):
        self._material, self._h = material, h
        self.frame, self.end = UNIT + (H + after) / 2, UNIT + after
        self.E, self.E_after = E, strain(after)
        self._elastic = discrete_gradient_stress(material.law, E, self.E_after, material.first_lame, material.shear)
        self._viscous = material.viscous(self.E_after - E, h)
        self.S = self._elastic + self._viscous

    @property
    def heat(self) -> Array:
        """What viscosity dissipates in the step, (P,), J/m³; never negative."""
        return (self._viscous * (self.E_after - self.E)).sum(axis=0)

    @cached_property
    def moduli(self) -> Array:
        """As in Stresses."""
        m = self._material
        D = m.moduli((self.E + self.E_after) / 2) / 2 + m.viscosity / self._h * m.linear_moduli
        if m.law == "st_venant_kirchhoff":
            return D
        return D + self._of_correction()

    def _of_correction(self) -> Array:
        """∂/∂E⁺ of Gonzalez' correction c ΔE, c = (W(E⁺) - W(E) - S(Ē):ΔE)/(ΔE:ΔE + ε²)."""
        m, ΔE = self._material, self.E_after - self.E
        moduli_times = np.einsum("cdp,dp->cp", m.moduli((self.E + self.E_after) / 2), ΔE)
        at_mean = stress(m.law, (self.E + self.E_after) / 2, m.first_lame, m.shear)
        at_end = stress(m.law, self.E_after, m.first_lame, m.shear)
        size = (ΔE**2 / VOIGT_SHEAR).sum(axis=0) + ROUND_OFF_STRAIN**2
        gained = m.energy_density(self.E_after) - m.energy_density(self.E)
        c = (gained - (at_mean * ΔE).sum(axis=0)) / size
        slope = (at_end - at_mean - moduli_times / 2 - 2 * c * ΔE / VOIGT_SHEAR) / size  # ∂c/∂E⁺
        D = (ΔE / VOIGT_SHEAR)[:, None] * slope[None, :]
        D[np.arange(6), np.arange(6)] += c / VOIGT_SHEAR
        return D


class StressesAtRest(Stresses):
    """Of an equilibrium.

    Args:
        material: of the points.
        H: (3, 3, P).
    """

    share = 1.0

    def __init__(self, material: Material, H: Array):
        self._material = material
        self.frame = self.end = UNIT + H
        self.E = strain(H)
        self.S = stress(material.law, self.E, material.first_lame, material.shear)

    @cached_property
    def moduli(self) -> Array:
        """As in Stresses."""
        return self._material.moduli(self.E)


def carried(F: Array, S: Array) -> Array:
    """F S (3, 3, P) of deformation gradients (3, 3, P) and stresses (6, P)."""
    full = S[VOIGT_INDEX]
    return F[:, 0, None] * full[None, 0] + F[:, 1, None] * full[None, 1] + F[:, 2, None] * full[None, 2]
