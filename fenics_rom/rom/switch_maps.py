"""Carrying a state from one contact mode's reduced model to another's.

Displacement and velocity are each projected orthogonally in their own energy,

    q_j = diag(1/γ_j) (W_jᵀ K W_i) q_i,    r_j = (W_jᵀ M W_i) r_i,

and an orthogonal projection lengthens no vector: potential energy is a length in K, kinetic energy one in M. So the
energy cannot grow, for any two bases, at any cadence. For bases of eigenvectors this is the paper's own (13).

Where the residual compliance of contact points is known, the displacement has a part beyond W_i: both together are
carried over by `ResidualMotion.carry_over`, orthogonally in K, too.

In energy coordinates (ω q, r) both maps are products of two orthonormal bases: contractions. Rigid motions are the
same in all contact modes: their velocities are carried over as they are, and their displacements are elsewhere.
"""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel, strained_coordinates


def switch_maps(κ: Array, start: ContactModel, end: ContactModel, switching: str) -> tuple[Array, Array]:
    """Maps of ω q and of r, each (m_end, m_start), from one contact mode to another; arguments as a Rom has them."""
    if switching == "oblique":
        return _project_obliquely(start, end)
    rigid = start.rigid
    potential = _clip_cosines(strained_coordinates(κ, end).T @ strained_coordinates(κ, start))
    kinetic = _clip_cosines(end.coordinates[:, rigid:].T @ start.coordinates[:, rigid:])
    if not rigid:
        return potential, kinetic
    return _stack_diagonally(np.zeros((rigid, rigid)), potential), _stack_diagonally(np.eye(rigid), kinetic)


def switch_map(
    κ: Array, start: ContactModel, end: ContactModel, switching: str, branches: int = 0, has_inertia: bool = True
) -> Array:
    """The map (s_end, s_start) of states as in StateSpace; displacements along rigid motions are carried over.

    Strains of so many branches of a material are carried over as displacements are; without inertia these are all.
    """
    potential, kinetic = switch_maps(κ, start, end, switching)
    strains = potential.copy()
    potential[: start.rigid, : start.rigid] = np.eye(start.rigid)
    if not has_inertia:
        return potential
    whole = _stack_diagonally(potential, kinetic)
    for _ in range(branches):
        whole = _stack_diagonally(whole, strains)
    return whole


def _stack_diagonally(first: Array, second: Array) -> Array:
    """One map of two parts that share nothing."""
    rows, columns = first.shape
    whole = np.zeros((rows + len(second), columns + second.shape[1]))
    whole[:rows, :columns], whole[rows:, columns:] = first, second
    return whole


def _project_obliquely(start: ContactModel, end: ContactModel) -> tuple[Array, Array]:
    """Maps of standard balanced truncation (paper (7)): they can add energy (paper, Prop. 1); for comparison only."""
    if end.left_inverse is None:
        raise ValueError("the ROM was not reduced for oblique switching")
    projection = end.left_inverse @ start.coordinates
    return np.sqrt(end.eigenvalues)[:, None] * projection / np.sqrt(start.eigenvalues), projection


def _clip_cosines(cosines: Array) -> Array:
    """A product of two orthonormal bases, with the round-off that would make it lengthen a vector taken out."""
    U, s, Vᵀ = np.linalg.svd(cosines, full_matrices=False)
    return (U * np.minimum(s, 1.0)) @ Vᵀ
