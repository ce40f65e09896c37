"""What steps do with strains that are carried along, as their adjoint asks for it; see elastic/carried_strains.py.

∂J/∂x is written x_.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import strain, strain_rate
from fenics_rom.rom.carried_strains import MonomialStrains, PointStrains
from fenics_rom.rom.deformation import ReducedDeformation
from fenics_rom.rom.volume_viscosity import VolumeViscosity

UNIT = np.eye(3)[:, :, None]
E_OF_Q = np.empty((0, 0))  # strains that are those of the shape


class Expected(NamedTuple):
    """What v̂ of a step was expected to be, and what that came of."""

    before: Array  # v̂ of the step before
    reactions: Array  # of strokes then (n,)
    touched: bool  # whether contact forces were under them
    middle: Array  # with that
    residual: Array  # forces out of balance there
    tangent: Array  # T
    made_tangent: bool  # whether in this step
    whole: Array  # before - T residual
    value: Array  # no longer than what was trained


class Carried(NamedTuple):
    """What a step hands on to the next one, beside the state."""

    velocity: Array  # v̂ (m,)
    strained: Array  # ε and C₀ε (2, size); (0, 0): ε is E(q)
    left: float  # ½ s² - c, J
    c: float  # J
    tank: float  # what may be given back, J
    energy: float  # of ε, J

    @staticmethod
    def of(numbers: Array, size: int) -> "Carried":
        """Of what `in_one` makes of so many strains."""
        strains, v, energies = np.split(numbers, [2 * size, -4])
        return Carried(v.copy(), strains.reshape(2, -1).copy() if strains.any() else E_OF_Q, *energies.tolist())

    def in_one(self, size: int) -> Array:
        """(2 size + m + 4,): ε and C₀ε, 0 for None, and the others."""
        strains = self.strained.ravel() if len(self.strained) else np.zeros(2 * size)
        return np.concatenate([strains, self.velocity, self[2:]])


def s_of(energy: float) -> float:
    """s of ½ s², J."""
    return math.sqrt(2 * max(energy, 0.0))


class Material(NamedTuple):
    """The points at a shape."""

    H: Array  # (3, 3, P)
    E: Array  # (6, P)
    S: Array  # (6, P) with the weights
    is_beyond: bool  # whether S lacks that of linear elasticity


class StrainsMaps(NamedTuple):
    """What steps of one size do with strains that are carried along."""

    body: ReducedDeformation
    strains: MonomialStrains | PointStrains
    volumes: VolumeViscosity | None
    h: float  # s
    steady: Array  # what of the slope of f̂ does not change (m, m)
    stiffening_time: float  # of branches, s
    st_venant: bool
    most: float  # largest c, J
    steepest: float  # largest |b|, 1/s

    def material(self, q: Array) -> Material:
        """At q."""
        body, H = self.body, self.body.displacement_gradients(q)
        E = strain(H)
        return Material(H, E, body.weights * body.material.stress(E), False)

    def stiffened(self, at: Material, w: Array) -> Array:
        """(AᵀDA + G(S)) w (m,), D = ∂S/∂E."""
        body, dH = self.body, self.body.displacement_gradients(w)
        dE = strain_rate(at.H + UNIT, dH)
        dS = body.material.stress_change(at.E, dE)
        if at.is_beyond:
            dS -= body.material.linear_stress(dE)
        return body.resultant(at.H, body.weights * dS) + body.resultant(dH - UNIT, at.S)

    def left(self, q: Array) -> tuple[float, Array, Material]:
        """Energy at q that is not ½ E:C₀E, J, ∂/∂q of it (m,), and the points without C₀."""
        body, at = self.body, self.material(q)
        S_linear = body.weights * body.material.linear_stress(at.E)
        left, S = float(body.elastic_energy(at.E) - (S_linear * at.E).sum() / 2), at.S - S_linear
        return left, body.resultant(at.H, S), at._replace(S=S, is_beyond=True)


class Slope(NamedTuple):
    """b = ∂√(2 (Ψ + c))/∂q, as StrainsCarried makes it."""

    maps: StrainsMaps
    at: Material
    numerator: Array  # ∂Ψ/∂q (m,)
    denominator: float
    is_flat: bool  # where Ψ + c is taken to be c/4
    c: float  # after it grew, J
    c_by_c: float
    c_by_left: float
    steep: Array  # b before it is made as flat as may be
    b: Array

    @staticmethod
    def at_shape(maps: StrainsMaps, q: Array, c: float) -> "Slope":
        """At q, with the c before, J."""
        left, numerator, at = maps.left(q)
        c_by_c, c_by_left = 1.0, 0.0
        if left + c < c / 2:
            grown = c + 4 * abs(left)
            c_by_c, c_by_left = (1.0, math.copysign(4.0, left)) if grown < maps.most else (0.0, 0.0)
            c = min(grown, maps.most)
        is_flat = left + c < c / 4
        denominator = math.sqrt(2 * max(left + c, c / 4))
        steep = numerator / denominator
        share = min(1.0, maps.steepest / math.sqrt(steep @ steep)) if steep.any() else 1.0
        return Slope(maps, at, numerator, denominator, is_flat, c, c_by_c, c_by_left, steep, share * steep)

    def pull_back(self, b_: Array, c_: float) -> tuple[Array, float]:
        """What b and the c after owe to q (m,), and to the c before."""
        steep, square = self.steep, float(self.steep @ self.steep)
        if square > self.maps.steepest**2:
            b_ = self.maps.steepest / math.sqrt(square) * (b_ - float(b_ @ steep) / square * steep)
        twice = -float(b_ @ self.numerator) / self.denominator**3  # with Ψ + c
        left_ = 0.0 if self.is_flat else twice
        c_ += twice / 4 if self.is_flat else twice
        left_ += self.c_by_left * c_
        by_q = self.maps.stiffened(self.at, b_ / self.denominator) + left_ * self.numerator
        return by_q, self.c_by_c * c_
