"""Back through a switch of the contact modes of a linear body."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.residual_part import ResidualPart
from fenics_rom.runtime.steppers.adjoint import StateAdjoint
from fenics_rom.runtime.steppers.residual_maps import carried_back, strained_back


class ResidualSwitch(NamedTuple):
    """The residual parts on both sides of a switch, and what they held at it."""

    left: ResidualPart
    entered: ResidualPart
    rows: Array  # [g, y, ġ, ẏ] (4, 3P) before it
    e: Array  # (m - rigid,) before it

    def pull_back(self, to_e: Array, after: Array) -> tuple[Array, Array]:
        """Derivatives with e and the rows before from those after, as ResidualMotion.carry_over makes them."""
        here, there = self.entered, self.left
        g, y, ġ, ẏ = self.rows
        strained = there.points[:, : len(there.basis)].T @ g - there.basis @ (there.basis_points.T @ g)
        e_after = here.basis.T @ (there.basis @ self.e + strained)
        y_after = there.basis_points @ self.e + y - here.basis_points @ e_after
        most = float(self.e @ self.e + g @ y - e_after @ e_after)
        to_y, by_most = carried_back(here, y_after, most, after[:2])
        inertia = (there.time_constant / here.time_constant) ** 2
        to_ẏ, by_motion = carried_back(here, ẏ, inertia * float(ġ @ ẏ), after[2:])
        by_motion *= inertia
        to_e = here.basis @ (to_e - here.basis_points.T @ to_y - 2 * by_most * e_after)
        rows = np.array(
            [by_most * y + strained_back(there, to_e), to_y + by_most * g, by_motion * ẏ, to_ẏ + by_motion * ġ]
        )
        return there.basis.T @ to_e + there.basis_points.T @ to_y + 2 * by_most * self.e, rows


class ProjectionAdjoint(NamedTuple):
    """A switch of a linear body, by maps of ω q and of r, (m_end, m_start)."""

    potential: Array
    kinetic: Array
    residual: ResidualSwitch | None

    def pull_back(self, after: StateAdjoint) -> StateAdjoint:
        """As in SwitchAdjoint."""
        rigid, rows = len(after.rigid), after.auxiliary
        e, r = after.state.reshape(2, -1)
        start = np.concatenate([self.potential.T @ e, self.kinetic.T @ r])
        if self.residual is not None:
            start[rigid : self.potential.shape[1]], both = self.residual.pull_back(e[rigid:], rows.reshape(4, -1))
            rows = both.ravel()
        return StateAdjoint(start, after.rigid, rows, after.forces, after.tangent)


class SpanAdjoint(NamedTuple):
    """A switch of a body in a moving frame to a contact mode of the same span: q⁺ = M q, r⁺ = M r."""

    shape: Array  # M (m_end, m_start)
    start: Array  # ω of both contact modes
    end: Array
    branches: int  # whose strains are those of the coordinates, of small strains

    def pull_back(self, after: StateAdjoint) -> StateAdjoint:
        """As in SwitchAdjoint."""
        (e, r), m = after.state.reshape(2, -1), len(self.end)
        strained = (self.end * self.shape.T / self.start[:, None]).T  # e⁺ by e
        own, rows = np.split(after.auxiliary, [self.branches * m])
        of_branches = own.reshape(-1, m) @ strained
        auxiliary = np.concatenate([of_branches.ravel(), rows])
        state = np.concatenate([e @ strained, r @ self.shape])
        return after._replace(state=state, auxiliary=auxiliary)
