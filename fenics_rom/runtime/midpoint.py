"""Passive midpoint integration (PMI) of one reduced model at one step size.

Kim, Lee et al., IJRR, doi 10.1177/0278364917731821; the paper's (2)-(4). With M = I and K = diag(γ):

    v̂ = (2/h + D + h/2 γ)⁻¹ (G u + 2/h r - γ q),   q⁺ = q + h v̂,   r⁺ = 2 v̂ - r,

and E⁺ - E = h (G u)ᵀ v̂ - h v̂ᵀ D v̂ exactly, whatever h is.
"""

import numpy as np

from fenics_rom.rom import Mode

Array = np.ndarray


class Midpoint:
    """The coefficients of a step, and the buffers it overwrites.

    Args:
        mode: the reduced model.
        h: time step, s.
    """

    def __init__(self, mode: Mode, h: float):
        self._γ = mode.eigenvalues
        self._inertia = 2 / h
        self._damping = mode.damping
        self._elastic = np.empty(mode.order)
        if mode.damping.ndim == 1:
            self._compliance = 1 / (2 / h + mode.damping + h / 2 * self._γ)
        else:
            matrix = mode.damping.copy()
            matrix.flat[:: mode.order + 1] += 2 / h + h / 2 * self._γ
            # v̂ = L⁻ᵀ (L⁻¹ b): the product keeps the inverse symmetric and positive in round-off too
            self._inverse_root = np.linalg.inv(np.linalg.cholesky(matrix))
        self._v = np.empty(mode.order)
        self._half = np.empty(mode.order)

    def representative_velocity(self, q: Array, r: Array, force: Array) -> Array:
        """v̂ (m,), the mean velocity of the step, in a buffer that the next call overwrites.

        Args:
            q, r: (m,) reduced displacement and velocity.
            force: (m,) G u.
        """
        v = self._v
        np.multiply(self._γ, q, out=self._elastic)
        np.multiply(self._inertia, r, out=v)
        v += force
        v -= self._elastic
        if self._damping.ndim == 1:
            v *= self._compliance
        else:
            np.dot(self._inverse_root, v, out=self._half)
            np.dot(self._half, self._inverse_root, out=v)
        return v

    def dissipation(self, v: Array) -> float:
        """v̂ᵀ D v̂ of the last step, W."""
        if self._damping.ndim == 1:
            np.multiply(self._damping, v, out=self._half)
        else:
            np.dot(self._damping, v, out=self._half)
        return float(self._half.dot(v))
