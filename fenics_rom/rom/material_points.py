"""The points of a body whose stress is not linear in the strain, at one shape or at those of many bodies.

Of one shape q (m,) arrays are (..., P), of B of them (m, B) they are (..., P B). Stresses hold the weights of points.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.hyperelastic import (
    VOIGT_INDEX,
    VOIGT_PAIRS,
    energy_beyond_linear,
    linear_stress,
    stress,
    stress_and_beyond_linear,
)
from fenics_rom.rom.deformation import ReducedDeformation

_I, _J = VOIGT_PAIRS.T
_TRANSPOSED = 3 * _J + _I


class MaterialPoints:
    """The points of a body.

    Attributes:
        most: energy of strains of order 1, J.
    """

    def __init__(self, body: ReducedDeformation):
        self._law, self._P, G = body.law, len(body.weights), body.gradients
        self._gradients = G.reshape(-1, body.order).copy()
        self._moduli = {1: (body.weights * body.first_lame, body.weights * body.shear)}  # for so many bodies
        self.most = float(self._moduli[1][1].sum())

    def strains(self, q: Array) -> tuple[Array, Array]:
        """F (3, 3, P) and E (6, P) at q."""
        moved = self._gradients.dot(q).reshape(9, -1)  # H, with which FᵀH + Hᵀ is twice the strain
        F = moved.copy()
        F[::4] += 1.0
        F = F.reshape(3, 3, -1)
        products = F.take(_I, 1)
        products *= moved.reshape(F.shape).take(_J, 1)
        E: Array = moved.take(_TRANSPOSED, 0)
        E += products[0]
        E += products[1]
        E += products[2]
        E[:3] /= 2
        return F, E

    def rates(self, F: Array, v: Array) -> Array:
        """What E (6, P) changes by at F (3, 3, P) with v."""
        moves = self._gradients.dot(v).reshape(F.shape)
        products, others = F.take(_I, 1), F.take(_J, 1)
        products *= moves.take(_J, 1)
        others *= moves.take(_I, 1)
        products += others
        rates: Array = products[0]
        rates += products[1]
        rates += products[2]
        rates[:3] /= 2
        return rates

    def with_next(self, q: Array, soon: Array) -> tuple[Array, float, Array, Array]:
        """E (6, P) and what `left` says at one shape (m,), F and S (6, P) at another one."""
        F, E = self.strains(np.array([q, soon]).T)
        S, W = stress_and_beyond_linear(self._law, E, *self._each(E))
        return E[:, ::2], float(self._summed(W)[0]), F[:, :, 1::2], S[:, 1::2]

    def stress(self, E: Array) -> Array:
        """S (6, P) of strains that `strains` found."""
        return stress(self._law, E, *self._each(E))

    def left(self, E: Array) -> Array:
        """Energy that is not ½ E:C₀E, of each body (1,) or (B,), J."""
        return self._summed(energy_beyond_linear(self._law, E, *self._each(E)))

    def beyond_linear(self, E: Array) -> tuple[Array, Array]:
        """The same energy, and the stress of it (6, P)."""
        λ, μ = self._each(E)
        S, W = stress_and_beyond_linear(self._law, E, λ, μ)
        S -= linear_stress(E, λ, μ)
        return self._summed(W), S

    def resultant(self, F: Array, S: Array) -> Array:
        """Forces (m, B) of stresses S (6, P), of one body (m, 1)."""
        S = S.take(VOIGT_INDEX, 0)
        FS = F[:, 0, None] * S[0]
        FS += F[:, 1, None] * S[1]
        FS += F[:, 2, None] * S[2]
        force: Array = self._gradients.T.dot(FS.reshape(len(self._gradients), -1))
        return force

    def _each(self, E: Array) -> tuple[Array, Array]:
        """λ and μ with the weights, of each column of E."""
        bodies = E.shape[1] // self._P
        if bodies not in self._moduli:
            λ, μ = self._moduli[1]
            self._moduli[bodies] = np.repeat(λ, bodies), np.repeat(μ, bodies)
        return self._moduli[bodies]

    def _summed(self, W: Array) -> Array:
        summed: Array = np.add.reduce(W.reshape(self._P, -1), 0)
        return summed
