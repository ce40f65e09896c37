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

from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.residual_part import strained_coordinates
from fenics_rom.rom.rom import ContactModel, Rom

REPORTED_LOSS = 0.01  # share of the stored energy, lost in one switch: some 10 % of a shape


@dataclass(frozen=True)
class SwitchLoss:
    """What a switch took out of the state, because the next contact mode's model cannot hold it."""

    energy: float = 0.0  # J
    share: float = 0.0  # of what was stored
    start: str = ""  # contact modes
    end: str = ""
    time: float = 0.0  # s

    @property
    def message(self) -> str:
        """What the user should know; empty where little was lost."""
        if self.share <= REPORTED_LOSS:
            return ""
        return (
            f"switching from {self.start!r} to {self.end!r} at t = {self.time:.4g} s lost {100 * self.share:.2g} % of "
            f"the stored energy ({self.energy:.2g} J), as the next model cannot hold all of that shape; a higher order "
            "loses less"
        )


class Projections:
    """The maps between the contact modes of a ROM, each found when it is first asked for."""

    def __init__(self, rom: Rom):
        self._rom = rom
        self._maps: dict[tuple[str, str], tuple[Array, Array]] = {}

    def between(self, start: str, end: str) -> tuple[Array, Array]:
        """Maps of ω q and of r, each (m_end, m_start), from one contact mode to another."""
        if (start, end) not in self._maps:
            models = self._rom.contact_models[start], self._rom.contact_models[end]
            oblique = self._rom.switching == "oblique"
            self._maps[start, end] = _project_obliquely(*models) if oblique else _project(self._rom, *models)
        return self._maps[start, end]


def _project(rom: Rom, start: ContactModel, end: ContactModel) -> tuple[Array, Array]:
    """Orthogonal projections in K and in M, which never add energy."""
    rigid, κ = rom.rigid, rom.stiffness
    potential = _clip_cosines(strained_coordinates(κ, end).T @ strained_coordinates(κ, start))
    kinetic = _clip_cosines(end.coordinates[:, rigid:].T @ start.coordinates[:, rigid:])
    if not rigid:
        return potential, kinetic
    return _stack_diagonally(np.zeros((rigid, rigid)), potential), _stack_diagonally(np.eye(rigid), kinetic)


def _stack_diagonally(rigid: Array, elastic: Array) -> Array:
    """One map of both parts of a state, which shares nothing between them."""
    ρ = len(rigid)
    whole = np.zeros((ρ + len(elastic), ρ + elastic.shape[1]))
    whole[:ρ, :ρ], whole[ρ:, ρ:] = rigid, elastic
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
