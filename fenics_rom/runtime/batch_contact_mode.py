"""What a contact mode is to the bodies of a batch that are in it."""

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.batch_contact_solver import Response
from fenics_rom.mechanics.complementarity.splitting import Splitting
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.midpoint_map import compliance
from fenics_rom.rom.residual_part import ResidualPart
from fenics_rom.runtime.steppers.kernel import symmetric
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
    relaxation: Relaxation
    h: float

    def __init__(self, model: ContactModel, rows: Array, part: ResidualPart, order: int):
        self.model, self.part = model, part
        self.S = np.zeros((len(rows), order))  # filled up to the order of the largest model
        self.S[:, : model.order] = rows @ model.coordinates

    def set_time_step(self, h: float, β: float) -> None:
        """Makes what depends on the time step, s, with residual parts that are damped by β, s."""
        self.h = h
        a, _ = compliance(self.model, h)
        m = self.model.order
        S, spread = self.S[:, :m], np.zeros(self.S.shape)
        spread[:, :m] = S * a if a.ndim == 1 else S @ a
        # With 4/h of the batch's a, which is yet to come where it is dense; and fᵀ S A⁻¹ Sᵀ f of what it makes of f.
        self._push, self._work = 2 * spread if a.ndim == 1 else h / 2 * self.S, np.zeros((self.S.shape[1],) * 2)
        self._work[:m, :m] = np.diag(1 / (4 * a)) if a.ndim == 1 else 4 / h**2 * a
        self.relaxation = relaxation(h, self.part.time_constant, β)
        inertia, whole, _ = self.relaxation
        self._rates = np.kron([[-1 / whole, inertia / whole]], np.identity(2))
        self._yields = self.part.compliance / self.relaxation.whole
        W = spread @ self.S.T
        self.operator = Splitting((W + W.T) / 2 + self._yields)

    def stored(self, x: Array, r: Array) -> Array:
        """Energy (B,) in the basis, of x = 2 q/h and r (B, m), J."""
        strained = x[:, : self.model.order] * (self.h / 2 * np.sqrt(self.model.eigenvalues))
        energy: Array = (np.square(strained).sum(axis=1) + np.square(r).sum(axis=1)) / 2
        return energy

    def unforced(self, residual: Array) -> Array:
        """Mid-step ġ and ẏ (2, 3P, B), if no forces act, of residual parts (4, 3P, B): g, y, ġ and ẏ at the start."""
        rates = np.matmul(self._rates, residual.reshape(4, -1))
        return rates.reshape(2, *residual.shape[1:])

    def respond(self, forces: Array) -> Response:
        """What bodies do under forces (3, P, T) on their points, N."""
        f = forces.reshape(len(self.S), -1)
        push, yields = f.T @ self._push, (self._yields @ f).reshape(forces.shape)
        work = np.einsum("bm,bm->b", push @ self._work, push)
        work += np.einsum("apb,apb->b", forces, yields)
        return Response(push, yields, work)


def part_by_axis(part: ResidualPart, axes: Array) -> ResidualPart:
    """The same with its points by axis."""
    points, basis_points = by_axis(part.points, axes), by_axis(part.basis_points, axes)
    compliance = symmetric(by_axis(by_axis(part.compliance, axes).T, axes))
    root = by_axis(part.inverse_root.T, axes).T
    return ResidualPart(points, part.basis, basis_points, compliance, part.time_constant, root)


def by_axis(rows: Array, axes: Array) -> Array:
    """Rows (3P, n) of points one after the other, along x, y and z, as all along the first of the axes (3, 3), ..."""
    turned = np.einsum("ab,pbn->apn", axes, rows.reshape(len(rows) // 3, 3, rows.shape[1]))
    return turned.reshape(rows.shape)
