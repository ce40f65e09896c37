"""Steps of what contact points yield beyond the basis, transposed; see residual_motion.py."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.residual_part import ResidualPart


class ResidualMaps(NamedTuple):
    """A residual part in steps of one length, transposed: of derivatives with its n rows (n, 3P).

    These are [g, y, ġ, ẏ], and of a material that relaxes w and R w of each branch.
    """

    step: Array  # (n + 2, n + 2): the rows after a step, then ġ and ẏ in it, from those before, f and R f
    added: Array  # (3, n): displacement, velocity and free mid-step velocity of the points from the rows
    part: ResidualPart
    τ: float  # s
    heat: float  # of ġ̂ᵀ R ġ̂, that a step dissipates, s²
    ratios: Array  # g of each branch

    @property
    def rows(self) -> int:
        """n."""
        return len(self.step) - 2

    def pull_back(self, after: Array) -> tuple[Array, Array]:
        """Those before a step, and those with the forces (3P,), from those after it."""
        rows = self.step[:-2].T @ after
        return rows[:-2], rows[-2] + self.part.compliance @ rows[-1]

    @property
    def delassus(self) -> Array:
        """As ResidualMotion.delassus."""
        return self.step[-1, -1] * self.part.compliance

    @property
    def yielding(self) -> Array:
        """Of what the points go by in a step, from the rows (n,)."""
        yielding: Array = self.step[-1, :-2]
        return yielding

    def of_points(self, moved: Array) -> Array:
        """Those of what it adds to displacement, velocity and free mid-step velocity of the points, (3, 3P)."""
        return self.added.T @ moved

    def of_energy(self, rows: Array) -> Array:
        """Those of what is stored."""
        g, y, ġ, ẏ = rows[:4]
        of_branches = [row for k, ratio in enumerate(self.ratios) for row in ratio * rows[[5 + 2 * k, 4 + 2 * k]]]
        return np.array([y, g, self.τ**2 * ẏ, self.τ**2 * ġ, *of_branches]) / 2


def strained_back(part: ResidualPart, slope: Array) -> Array:
    """Derivatives with g (3P,) from those with what of it lies in the shared basis, (k - rigid,)."""
    by_force: Array = part.points @ slope - part.basis_points @ (part.basis.T @ slope)
    return by_force


def carried_back(part: ResidualPart, y: Array, most: float, after: Array) -> tuple[Array, float]:
    """Derivatives with y (3P,) and `most` from those with g and R g, (2, 3P), that a switch makes of them."""
    w, to_w = part.inverse_root @ y, part.inverse_root @ (after[0] + part.compliance @ after[1])
    square, by_most = float(w @ w), 0.0
    if square > most:
        share, along = np.sqrt(max(most, 0.0) / square), float(to_w @ w)
        by_most = along * share / (2 * most) if most > 0 else 0.0
        to_w = share * (to_w - along / square * w)
    return to_w @ part.inverse_root, by_most
