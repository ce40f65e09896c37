"""Carrying a state from one contact mode's reduced model to another's.

Displacement and velocity are each projected orthogonally in their own energy,

    q_j = diag(1/γ_j) (W_jᵀ K W_i) q_i,    r_j = (W_jᵀ M W_i) r_i,

and an orthogonal projection lengthens no vector: potential energy is a length in K, kinetic energy one in M. So the
energy cannot grow, for any two bases, at any cadence. For bases of eigenvectors this is the paper's own (13).
"""

import numpy as np

from fenics_rom.rom import Mode, Rom

Array = np.ndarray


def energy_orthogonal(rom: Rom, start: Mode, end: Mode) -> tuple[Array, Array]:
    """Maps of displacement and velocity, each (m_end, m_start), that never add energy."""
    ω_start, ω_end = np.sqrt(start.eigenvalues), np.sqrt(end.eigenvalues)
    strained_start = np.sqrt(rom.stiffness)[:, None] * start.coordinates / ω_start
    strained_end = np.sqrt(rom.stiffness)[:, None] * end.coordinates / ω_end
    potential = _contraction(strained_end.T @ strained_start)
    kinetic = _contraction(end.coordinates.T @ start.coordinates)
    return potential * ω_start / ω_end[:, None], kinetic


def oblique(start: Mode, end: Mode) -> tuple[Array, Array]:
    """Maps of standard balanced truncation (paper (7)): they can add energy (paper, Prop. 1); for comparison only."""
    if end.left_inverse is None:
        raise ValueError("the ROM was not reduced for oblique switching")
    both = end.left_inverse @ start.coordinates
    return both, both


def _contraction(cosines: Array) -> Array:
    """A product of two orthonormal bases, with the round-off that would make it lengthen a vector taken out."""
    U, s, Vᵀ = np.linalg.svd(cosines, full_matrices=False)
    return (U * np.minimum(s, 1.0)) @ Vᵀ
