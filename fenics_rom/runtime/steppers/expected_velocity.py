"""Back through what a linearly implicit step expects its mid-step velocity to be; see held.py."""

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import stress_change
from fenics_rom.runtime.steppers.adjoint import NONE
from fenics_rom.runtime.steppers.definite import is_definite
from fenics_rom.runtime.steppers.deformation_maps import Expected, LinearlyImplicitMaps, Material


class Expectation(NamedTuple):
    """What is owed to what it was made of."""

    inputs: Array  # (p,)
    q: Array
    r: Array
    velocity: Array  # v̂ of the step before
    forces: Array  # of contact then, (3P,)
    reactions: Array  # of strokes then, (k,)
    tangent: Array  # T, if an earlier step made it


class ExpectedVelocity(NamedTuple):
    """That of a step under u (p,)."""

    maps: LinearlyImplicitMaps
    u: Array
    was: Expected

    def pull_back(self, value_: Array, tangent_: Array) -> Expectation:
        """What is owed to the value (m,), and by later steps to T, goes to what both came of."""
        maps, (v, reactions, middle, residual, T, made_tangent, whole, value) = self.maps, self.was
        body, strains, h = maps.body, maps.strains, maps.h
        if value is not whole:
            square = float(whole @ whole)
            share = body.training_radius / (h / 2 * math.sqrt(square))
            value_ = share * (value_ - float(whole @ value_) / square * whole)
        w = -T @ value_
        tangent_ = -np.outer(value_, residual) + (tangent_ if len(tangent_) else 0.0)
        around, at = strains.around(middle), None if maps.st_venant else maps.material(middle)
        σ = strains.stressed(around.damped(v, 0.0, maps.st_venant))
        σ_, middle_ = around.rates(w), strains.geometric(σ) @ w + body.springs @ w
        if made_tangent:
            of_σ, of_middle = self._tangent_back(tangent_, σ, at)
            σ_, middle_, tangent_ = σ_ + of_σ, middle_ + of_middle, NONE
        if at is not None:
            middle_ = middle_ + maps.stiffened(at, w)
        inputs, of_middle = maps.loads_back(self.u, middle, w)
        for reaction, stroke in zip(reactions, maps.strokes, strict=True):
            of_middle = of_middle + reaction * stroke.pull_back(middle, w)
        of_reactions = -np.array([stroke.force(middle) @ w for stroke in maps.strokes])
        ε_ = strains.stressed(σ_)
        rates_ = strains.viscosity * ε_
        middle_ = middle_ - of_middle + strains.geometric(rates_) @ v
        if maps.st_venant:
            middle_ = middle_ + around.pulled(ε_)
        v_ = value_ + 2 / h * w + body.external_damping @ w + around.pulled(rates_) + h / 2 * middle_
        return Expectation(-inputs, middle_, -2 / h * w, v_, -(w @ maps.Sᵀ), of_reactions, tangent_)

    def _tangent_back(self, tangent_: Array, σ: Array, at: Material | None) -> tuple[Array, Array]:
        """What T, made here, owes to σ, and to the middle (m,): T⁻¹ = fixed + AᵀC₀A (h/2 + β) + h/2 G."""
        maps, T, m = self.maps, self.was.tangent, len(self.was.tangent)
        body, strains, h = maps.body, maps.strains, maps.h
        N = -T @ (tangent_ + tangent_.T) @ T / 2
        around = strains.around(self.was.middle)
        A = np.stack([around.rates(unit) for unit in np.eye(m)], axis=1)
        strained = ((h / 2 + strains.viscosity) * A.T).T @ N
        rows = [strains.geometric(strains.stressed(column))[k] for k, column in enumerate(strained.T)]
        middle_ = 2 * np.sum(rows, axis=0)
        geometric = strains.geometric(σ) + (0.0 if at is None else body.geometric(at.S))
        if not is_definite(maps.fixed + around.stiffness(h / 2) + h / 2 * geometric):
            return np.zeros(strains.size), middle_
        if at is not None:
            of_strains = h / 2 * body.geometric_back(N)
            dS = stress_change(body.law, at.E, of_strains, body.first_lame, body.shear)  # D is symmetric
            middle_ = middle_ + body.resultant(at.H, body.weights * dS)
        return h / 2 * strains.geometric_back(N), middle_
