"""Back through a step of a body that a base carries; see carried_frame.py, whose symbols these are.

Whatever the base does, the step is linear in what the body has: A r̂ = right, with y = A⁻ᵀ (what J owes to r̂)

    ∂right/∂q = Σ ω_k ω⁺_l I2_kl - Σ Δω_k/h G_k - γ,    ∂right/∂r = 2/h - ½ Σ Δω_k G_k,    ∂right/∂u: modal forces

and what it stores is quadratic in q and r. The base itself is given, and its motion not differentiated.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.contact_model import ContactModel
from fenics_rom.rom.moving_frame import MovingFrame
from fenics_rom.runtime.steppers.adjoint import Reads, StateAdjoint, StepSlopes, spread
from fenics_rom.runtime.steppers.carried_base import Motion
from fenics_rom.runtime.steppers.inertia import pairs


class Carried(NamedTuple):
    """What does not change from step to step."""

    model: ContactModel
    frame: MovingFrame
    second: Array  # I2 (6, m, m)
    h: float  # s


class CarriedAdjoint(NamedTuple):
    """A step of CarriedFrame without contact."""

    model: ContactModel
    h: float  # s
    A: Array  # (m,) or (m, m)
    by_shape: Array  # ∂right/∂q but for -γ (m, m)
    by_rate: Array  # ∂right/∂r (m, m)
    by_input: Array  # ∂right/∂u (m, p)
    states: tuple[Array, Array]  # [e, r] before and after it (2m,)
    stored_slopes: tuple[Array, Array]  # of what is stored after it, with q and r, but for elasticity (m,)
    is_kink: bool = False

    @staticmethod
    def of(
        body: Carried,
        motions: tuple[Motion, Motion],
        states: tuple[Array, Array],
        A: Array,
        by_input: Array,
        ties: tuple[Array, Array] | None,
    ) -> "CarriedAdjoint":
        """Of the step between two motions; with slopes of the ties to the ground, as GroundTies gives them."""
        (before, after), (model, frame, I2, h) = motions, body
        spun = np.tensordot(np.subtract(after.ω, before.ω), frame.coupling, 1)
        by_shape = np.tensordot(pairs(before.ω, after.ω), I2, 1) - spun / h
        by_rate = 2 / h * np.eye(model.order) - spun / 2

        ω, v, spin = (np.array(numbers) for numbers in (after.ω, after.v, pairs(after.ω, after.ω)))
        r = states[1][model.order :]
        spun, drift = np.tensordot(ω, frame.coupling, 1), frame.moment_modes
        bent = spin @ frame.inertia1 / 2 + np.tensordot(spin, I2, 1) @ after.q + spun.T @ r + np.cross(v, ω) @ drift
        if ties is not None:
            by_shape, bent = by_shape + ties[0], bent + ties[1]
        stored_slopes = bent, r + ω @ frame.coupling0 + spun @ after.q + v @ drift
        return CarriedAdjoint(model, h, A, by_shape, by_rate, by_input, states, stored_slopes)

    def pull_back(self, after: StateAdjoint, reads: Reads) -> StepSlopes:
        """As in StepAdjoint."""
        model, h = self.model, self.h
        ω = np.sqrt(model.eigenvalues)
        (e, r), (e_after, r_after) = (state.reshape(2, -1) for state in self.states)
        by_e, by_r = after.state.reshape(2, -1)
        q_ = reads.q + reads.energy * self.stored_slopes[0]
        μ_e, μ_r = by_e + reads.energy * e_after + q_ / ω, by_r + reads.energy * self.stored_slopes[1]
        r̂, to_v = (r + r_after) / 2, h * ω * μ_e + 2 * μ_r
        y = to_v / self.A if self.A.ndim == 1 else np.linalg.solve(self.A.T, to_v)
        to_q = self.by_shape.T @ y
        start = np.concatenate([μ_e - ω * y + to_q / ω, self.by_rate.T @ y - μ_r])
        along_ω = h * μ_e * r̂ - y * (e + h * ω * r̂) - (q_ * e_after + to_q * e) / ω**2
        damping = spread((y, r̂), model.damping)
        return StepSlopes(StateAdjoint(start, after.rigid, after.auxiliary), self.by_input.T @ y, along_ω, damping)
