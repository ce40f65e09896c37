"""Back through a switch of the contact modes of a linear body."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.residual_part import ResidualPart
from fenics_rom.runtime.steppers.adjoint import NONE, StateAdjoint
from fenics_rom.runtime.steppers.residual_maps import carried_back, strained_back


class ResidualSwitch(NamedTuple):
    """The residual parts on both sides of a switch, and what they held at it."""

    left: ResidualPart
    entered: ResidualPart
    rows: Array  # [g, y, ġ, ẏ] and w and R w of each branch, (4 + 2N, 3P), before it
    e: Array  # (m - rigid,) before it
    strains: Array  # of branches, (N, m - rigid), before it

    def projected(self, e: Array, g: Array) -> Array:
        """What becomes of e (m - rigid,) and of what was beside it, g (3P,)."""
        there = self.left
        strained = there.points.T @ g - there.basis @ (there.basis_points.T @ g)
        projected: Array = self.entered.basis.T @ (there.basis @ e + strained)
        return projected

    def pull_back(self, to_e: Array, to_strains: Array, after: Array) -> tuple[Array, Array, Array]:
        """Derivatives with e, the strains of branches and the rows before from those after it.

        They are made as by ResidualMotion.carry_over and carry_branches.
        """
        here, there = self.entered, self.left
        ġ, ẏ = self.rows[2:4]
        inertia = (there.time_constant / here.time_constant) ** 2
        to_ẏ, by_motion = carried_back(here, ẏ, inertia * float(ġ @ ẏ), after[2:4])
        by_motion *= inertia
        e, rows = self._shape_back(self.e, self.rows[:2], to_e, after[:2])
        strains, parts = np.zeros(self.strains.shape), [rows, np.array([by_motion * ẏ, to_ẏ + by_motion * ġ])]
        for k, strain in enumerate(self.strains):
            own = slice(4 + 2 * k, 6 + 2 * k)
            strains[k], rows = self._shape_back(strain, self.rows[own], to_strains[k], after[own])
            parts.append(rows)
        return e, strains, np.concatenate(parts)

    def _shape_back(self, e: Array, rows: Array, to_e: Array, after: Array) -> tuple[Array, Array]:
        """Those with e and [g, y] (2, 3P) before, from those after."""
        here, there = self.entered, self.left
        g, y = rows
        e_after = self.projected(e, g)
        y_after = there.basis_points @ e + y - here.basis_points @ e_after
        to_y, by_most = carried_back(here, y_after, float(e @ e + g @ y - e_after @ e_after), after)
        to_e = here.basis @ (to_e - here.basis_points.T @ to_y - 2 * by_most * e_after)
        rows = np.array([by_most * y + strained_back(there, to_e), to_y + by_most * g])
        return there.basis.T @ to_e + there.basis_points.T @ to_y + 2 * by_most * e, rows


class StrainsSwitch(NamedTuple):
    """Strains of branches at a switch, which are made smaller where they would store more after it than before."""

    ratios: Array  # g (N, 1)
    strains: Array  # (N, m_start) before it
    projected: Array  # (N, m_end), not yet made smaller
    shares: tuple[Array, Array] | None  # of MaxwellBranches, before and after it; None: strains store what they do

    def pull_back(self, after: Array) -> tuple[Array, Array]:
        """Derivatives with those that are projected, (N, m_end), and beside that with those before, (N, m_start)."""
        if self.shares is None:
            return after, np.zeros(self.strains.shape)
        of_start, of_end = (
            self.ratios * x @ P for x, P in zip((self.strains, self.projected), self.shares, strict=True)
        )
        most, stored = float((self.strains * of_start).sum()), float((self.projected * of_end).sum())
        if stored <= most:
            return after, np.zeros(self.strains.shape)
        scale, slope = np.sqrt(max(most, 0.0) / stored), float((after * self.projected).sum())
        by_most = scale * slope / most if most > 0 else 0.0
        return scale * (after - slope / stored * of_end), by_most * of_start


class ProjectionAdjoint(NamedTuple):
    """A switch of a linear body, by maps of ω q and of r, (m_end, m_start)."""

    potential: Array
    kinetic: Array
    residual: ResidualSwitch | None
    branches: StrainsSwitch | None
    is_kink: bool = False

    def pull_back(self, after: StateAdjoint) -> StateAdjoint:
        """As in SwitchAdjoint."""
        rigid, end, of_strains = len(after.rigid), len(self.potential), np.empty(0)
        e, r = after.state.reshape(2, -1)
        start = np.concatenate([self.potential.T @ e, self.kinetic.T @ r])
        strains, rows = np.zeros((0, end)), after.auxiliary
        if self.branches is not None:
            own = len(rows) - self.branches.projected.size
            strains, of_strains = self.branches.pull_back(rows[own:].reshape(-1, end))
            rows, back = rows[:own], strains @ self.potential
        if self.residual is not None:
            of_points = rows.reshape(len(self.residual.rows), -1)
            shape, of_branches, both = self.residual.pull_back(e[rigid:], strains[:, rigid:], of_points)
            start[rigid : self.potential.shape[1]], rows = shape, both.ravel()
            if self.branches is not None:
                back[:, :rigid], back[:, rigid:] = 0.0, of_branches
        if self.branches is not None:
            of_strains = of_strains + back
        return StateAdjoint(start, after.rigid, np.concatenate([rows, of_strains.ravel()]), after.forces, after.tangent)


class ResidualKept(NamedTuple):
    """The residual parts on both sides of a switch that moves no point, and what they held at it; see take_over."""

    left: ResidualPart
    entered: ResidualPart
    rows: Array  # [g, y, ġ, ẏ] and w and R w of each branch, (4 + 2N, 3P), before it

    def pull_back(self, after: Array) -> Array:
        """Derivatives with the rows before from those after."""
        before, inertia = np.empty(after.shape), (self.left.time_constant / self.entered.time_constant) ** 2
        for first in range(0, len(after), 2):
            (g, y), share = self.rows[first : first + 2], inertia if first == 2 else 1.0
            to_y, by_most = carried_back(self.entered, y, share * float(g @ y), after[first : first + 2])
            before[first], before[first + 1] = share * by_most * y, to_y + share * by_most * g
        return before


class Further(NamedTuple):
    """Further modes that a switch made of the fields that it found: what the span changes by with these.

    With P (k, m) of the shapes afterwards, those of the contact mode C among them, P + (1 - P Pᵀ) δU L has C and the
    fields U + δU if L PᵀC = 0 and L PᵀU = 1; in it they have the coordinates PᵀU + Pᵀ δU.
    """

    shapes: Array  # P (k, m)
    followed: Array  # L (any, m)

    @classmethod
    def of(cls, P: Array, C: Array, fields: Array) -> "Further":
        """Of fields U (k, any), of which C has not all."""
        held, own = P.T @ fields, P.T @ C
        held = held - own @ (own.T @ held)
        sizes = np.linalg.norm(held, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        return cls(P, np.linalg.pinv(held / sizes) / sizes[:, None])

    def back(self, span_: Array) -> Array:
        """Derivatives with the fields (any, k) from those with P (k, m)."""
        P = self.shapes
        back: Array = self.followed @ (span_ - P @ (P.T @ span_)).T
        return back


class FieldsAdjoint(NamedTuple):
    """A switch of a body in a moving frame: shape, rate and strains of branches stay, in other coordinates."""

    shapes: tuple[Array, Array]  # of the coordinates before and after it, in the shared basis (k, m)
    frequencies: tuple[Array, Array]  # ω (m,) of both
    branches: int  # whose strains are those of the coordinates, of small strains
    further: Further | None = None
    residual: ResidualKept | None = None
    is_kink: bool = False

    def pull_back(self, after: StateAdjoint) -> StateAdjoint:
        """As in SwitchAdjoint."""
        (C, C_end), (ω, ω_end) = self.shapes, self.frequencies
        (e, r), m = after.state.reshape(2, -1), len(ω_end)
        own, rows = np.split(after.auxiliary, [self.branches * m])
        fields = np.vstack([ω_end * e, r, ω_end * own.reshape(-1, m)]) @ C_end.T
        if self.further is not None and len(after.span):
            fields = fields + self.further.back(after.span)
        back = fields @ C
        if self.residual is not None:
            rows = self.residual.pull_back(rows.reshape(self.residual.rows.shape)).ravel()
        auxiliary = np.concatenate([(back[2:] / ω).ravel(), rows])
        return after._replace(state=np.concatenate([back[0] / ω, back[1]]), auxiliary=auxiliary, span=NONE)
