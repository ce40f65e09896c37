"""The points of a body whose stress is not linear in the strain, at one shape or at those of many bodies.

Of one shape q (m,) arrays are (..., P), of B of them (m, B) they are (..., P B). Stresses hold the weights of points.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.point_material import PointMaterial
from fenics_rom.mechanics.voigt import VOIGT_INDEX, VOIGT_PAIRS
from fenics_rom.rom.deformation import ReducedDeformation

_I, _J = VOIGT_PAIRS.T
_TRANSPOSED = 3 * _J + _I
_QUARTERS = np.full(9, 0.25)


class MaterialPoints:
    """The points of a body.

    Attributes:
        most: energy of strains of order 1, J.
    """

    def __init__(self, body: ReducedDeformation):
        self._P, G = len(body.weights), body.gradients
        self._gradients = G.reshape(-1, body.order).copy()
        self._materials = {1: body.material.scaled(body.weights)}  # for so many bodies
        self.most = float(
            self._materials[1].shear.sum() + sum(part.modulus.sum() for part in self._materials[1].fibres)
        )

    def strain_squares(self, q: Array) -> Array:
        """|E|² (P,) at q."""
        H = self._gradients.dot(q).reshape(3, 3, -1)
        products = H[:, :, None] * H[:, None]
        twice = products[0]  # 2 E = HᵀH + H + Hᵀ
        twice += products[1]
        twice += products[2]
        twice += H
        twice += H.swapaxes(0, 1)
        twice *= twice
        squares: Array = _QUARTERS.dot(twice.reshape(9, -1))
        return squares

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

    def energies_and_forces(self, q: Array) -> tuple[Array, Array]:
        """Of each body (1,) or (B,), J, and what they are with q (m, 1) or (m, B), at q (m,) or (m, B)."""
        H = self._gradients.dot(q).reshape(9, -1)
        W, P = self._each(H).energy_and_piola(H)
        forces: Array = self._gradients.T.dot(P.reshape(len(self._gradients), -1))
        return self._summed(W), forces

    def energy_and_force(self, q: Array, middle: Array) -> tuple[float, Array]:
        """The energy at q (m,), J, and the forces (m,) at another shape, in one go."""
        H = np.empty((9, self._P, 2))
        H[:, :, 0], H[:, :, 1] = (self._gradients.dot(at).reshape(9, -1) for at in (q, middle))
        H = H.reshape(9, -1)
        W, P = self._each(H).energy_and_piola(H)
        force: Array = P[:, 1::2].ravel().dot(self._gradients)
        return float(np.add.reduce(W[::2])), force

    def stress(self, E: Array) -> Array:
        """S (6, P) of strains that `strains` found."""
        return self._each(E).stress(E)

    def resultant(self, F: Array, S: Array) -> Array:
        """Forces (m, B) of stresses S (6, P), of one body (m, 1)."""
        S = S.take(VOIGT_INDEX, 0)
        FS = F[:, 0, None] * S[0]
        FS += F[:, 1, None] * S[1]
        FS += F[:, 2, None] * S[2]
        force: Array = self._gradients.T.dot(FS.reshape(len(self._gradients), -1))
        return force

    def _each(self, E: Array) -> PointMaterial:
        """With the weights, of each column of E."""
        bodies = E.shape[1] // self._P
        if bodies not in self._materials:
            self._materials[bodies] = self._materials[1].repeated(bodies)
        return self._materials[bodies]

    def _summed(self, W: Array) -> Array:
        summed: Array = np.add.reduce(W.reshape(self._P, -1), 0)
        return summed
