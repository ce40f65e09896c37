"""What a contact mode is to the bodies of a batch that are in it."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.complementarity.splitting import Splitting
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.residual_part import ResidualPart
from fenics_rom.runtime.steppers.residual_motion import Relaxation, relaxation


class BatchContactMode:
    """A contact mode, its residual part, and what a time step makes of them.

    Args:
        model: of the contact mode.
        rows: S (3P, k) of the contact points in the shared basis, by axis.
        part: what it lacks, points by axis, too.
        order: the largest of a contact model.
    """

    operator: Splitting
    push: Array  # (3P, m)
    relaxation: Relaxation

    def __init__(self, model: ContactModel, rows: Array, part: ResidualPart, order: int):
        self.model, self.part = model, part
        self.S = np.zeros((len(rows), order))  # filled up to the order of the largest model
        self.S[:, : model.order] = rows @ model.coordinates

    def set_time_step(self, h: float, β: float) -> None:
        """Makes what depends on the time step, s, with residual parts that are damped by β, s."""
        a, _ = compliance(self.model, h)
        m = self.model.order
        S, self.push = self.S[:, :m], h / 2 * self.S
        spread = S * a if a.ndim == 1 else S @ a
        if a.ndim == 1:
            self.push = np.zeros(self.S.shape)
            self.push[:, :m] = 2 * spread  # with 4/h of the batch's a
        self.relaxation = relaxation(h, self.part.time_constant, β)
        W = spread @ S.T
        self.operator = Splitting((W + W.T) / 2 + self.part.compliance / self.relaxation.whole)


def by_axis(rows: Array) -> Array:
    """Rows (3P, n) of points one after the other as all x, all y, all z."""
    return rows.reshape(-1, 3, rows.shape[1]).transpose(1, 0, 2).reshape(rows.shape)
