"""Frequency responses (K + iωD - ω²M)⁻¹ B of reduced models, and what they leave undone in the full model."""

import numpy as np

from fenics_rom.system.protocols import Array
from fenics_rom.system.system import System


def response(γ: Array, damping: Array, G: Array, ω: float) -> Array:
    """Amplitudes (m, p) of a model with M = I, K = diag(γ), D = diag(damping) or (m, m), at ω in rad/s."""
    if damping.ndim == 1:
        return G / (γ + 1j * ω * damping - ω**2)[:, None]
    return np.linalg.solve(np.diag(γ - ω**2) + 1j * ω * damping, G)


def dynamic_product(system: System, x: Array, ω: Array) -> Array:
    """(K + iωD - ω²M) x for complex columns x (rows here, c), each at its own ω (c,)."""
    Mx, Kx = system.mass @ x, system.stiffness @ x
    if system.rayleigh is None:
        return Kx + 1j * ω * (system.damping @ x) - ω**2 * Mx
    α, β = system.rayleigh
    return (1 + 1j * ω * β) * Kx + (1j * ω * α - ω**2) * Mx


def inner_products(system: System, left: Array, right: Array) -> Array:
    """leftᴴ right of complex columns, (c, d), summed over the ranks."""
    c, d = left.shape[1], right.shape[1]
    parts = system.algebra.inner(np.hstack([left.real, left.imag]), np.hstack([right.real, right.imag]))
    return parts[:c, :d] + parts[c:, d:] + 1j * (parts[:c, d:] - parts[c:, :d])


def mass_norms(system: System, x: Array) -> Array:
    """√(xᴴ M x) of complex columns, (c,)."""
    return np.sqrt(np.abs(np.diag(inner_products(system, x, system.mass @ x))))
