"""Back through a midpoint step with contact, and through a switch.

With derivatives μ after the step and ψ of the law of contact (mechanics.contact_adjoint),

    y = A⁻¹ (h ω μ_e + 2 μ_r + Sᵀ ψ),    μ_e - ω y and 2/h y - μ_r before it,    Gᵀ y with the inputs,

and what the contact points' displacement and velocity at its start owe is added. As S v̂ = free + W f with the v̂ that
the step came to, -y v̂ᵀ is what J owes to A, contact or not.

Strokes that are held, Bᵀv̂ = c, have forces z of their own, so that A⁻¹ - A⁻¹B (BᵀA⁻¹B)⁻¹ BᵀA⁻¹ is in place of A⁻¹; what
J owes to c is (BᵀA⁻¹B)⁻¹ BᵀA⁻¹ times what it owes to v̂.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.actuator_forces import SHARE
from fenics_rom.mechanics.contact_adjoint import ContactAdjoint
from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.residual_part import ResidualPart
from fenics_rom.runtime.steppers.adjoint import NONE, Reads, StateAdjoint, StepSlopes, spread
from fenics_rom.runtime.steppers.residual_motion import ResidualMaps, carried_back, strained_back


class MidpointStrokes(NamedTuple):
    """Strokes that are given (k,), of which n are held."""

    places: Array  # of all of them in the input (k,)
    held: Array  # which (n,)
    columns: Array  # B (m, n)
    targets: Array  # (BᵀA⁻¹B)⁻¹ BᵀA⁻¹ (n, m)


class MidpointMaps(NamedTuple):
    """Of one contact mode and step size."""

    model: ContactModel
    h: float  # s
    a: Array  # A⁻¹, (m,) or (m, m); where strokes are held, of what they let go
    Sᵀ: Array  # (m, 3P); (m, 0) where nothing can touch
    residual: ResidualMaps | None
    strokes: MidpointStrokes | None


class MidpointAdjoint(NamedTuple):
    """A step of ContactMidpoint. Residual rows are [g, y, ġ, ẏ] (4, 3P)."""

    maps: MidpointMaps
    before: Array  # [e, r] (2m,)
    after: Array
    residual_after: Array | None
    contact: ContactAdjoint | None
    is_kink: bool

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """As in StepAdjoint."""
        (model, h, a, Sᵀ, residual, strokes), rigid = self.maps, len(after.rigid)
        ω, inverse_ω = np.sqrt(model.eigenvalues), 1 / model.safe_frequencies
        (e, r), (e_after, r_after) = self.before.reshape(2, -1), self.after.reshape(2, -1)
        μ_e, μ_r = (after.state + reads.energy * self.after).reshape(2, -1)
        μ_e[rigid:] += (reads.q * inverse_ω)[rigid:]
        along_rigid = after.rigid + reads.q[:rigid]
        v̂ = (r + r_after) / 2

        to_v = h * ω * μ_e + 2 * μ_r
        to_v[:rigid] += h * along_rigid
        by_force = rows = NONE
        if residual is not None and self.residual_after is not None:
            rows = after.auxiliary.reshape(4, -1) + reads.energy * residual.of_energy(self.residual_after)
            rows[0] += strained_back(residual.part, reads.beyond)
            rows, by_force = residual.pull_back(rows)
        to_q, to_r = np.zeros((2, model.order))
        if self.contact is not None:
            φ = (a * to_v if a.ndim == 1 else a @ to_v) @ Sᵀ
            moved = np.reshape(self.contact.pull_back((φ + by_force if residual else φ).reshape(-1, 3)), (3, -1))
            to_q, to_r, push = moved @ Sᵀ.T
            to_v += push
            if residual is not None:
                rows += residual.of_points(moved)
        y = a * to_v if a.ndim == 1 else a @ to_v
        by_inputs = model.inputs.T @ y
        if strokes is not None:
            by_targets = strokes.targets @ to_v
            by_inputs[strokes.places] = 0.0
            by_inputs[strokes.places[strokes.held]] = SHARE / h * by_targets
            to_q = to_q - SHARE / h * (strokes.columns @ by_targets)
            to_r = to_r + (1 - SHARE) * (strokes.columns @ by_targets)
        start = np.concatenate([μ_e - ω * y, 2 / h * y - μ_r + to_r])
        start[rigid : len(e)] += (to_q * inverse_ω)[rigid:]
        along_ω = h * μ_e * v̂ - y * (e + h * ω * v̂) - (reads.q * e_after + to_q * e) * inverse_ω**2
        before = StateAdjoint(start, along_rigid + to_q[:rigid], rows.ravel())
        return StepSlopes(before, by_inputs, along_ω, spread((y, v̂), model.damping))


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
