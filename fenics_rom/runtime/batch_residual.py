"""How contact points of the bodies of a batch yield beyond the bases of their contact modes.

The law of one body is in `steppers.residual_motion`. Arrays hold bodies along their last axis, and rows of the contact
points are all along the first of the axes of contact, then all along the next.
"""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.body_axis import put, taken
from fenics_rom.runtime.batch_contact_mode import BatchContactMode
from fenics_rom.runtime.steppers.residual_motion import FORGOTTEN

NEGLIGIBLE = 1e-20  # of a body's energy: what is stored in its residual part no more


class BatchResidual:
    """The residual parts of bodies.

    Args:
        modes: the contact modes.
        rigid: how many motions of the basis are rigid.
        axes: of contact (3, 3), rows.
        size: number of bodies.

    Attributes:
        state: (4, 3P, size) g, y, ġ and ẏ.
        moves: (size,) whether the part does.
    """

    def __init__(self, modes: Sequence[BatchContactMode], rigid: int, axes: Array, size: int):
        self._modes, self._rigid, self._axes = modes, rigid, axes
        self.state, self.moves = np.zeros((4, len(modes[0].S), size)), np.zeros(size, bool)

    def begin(self, bodies: Array) -> None:
        """Bodies are at rest in their residual parts."""
        self.state[..., bodies] = 0.0
        self.moves[bodies] = False

    def stored(self, bodies: Array, mode: Array) -> Array:
        """Energy (B,) in the residual parts of bodies in contact modes (B,), J."""
        g, y, ġ, ẏ = taken(self.state, bodies)
        τ = np.array([kind.part.time_constant for kind in self._modes])[mode]
        stored: Array = (np.einsum("pb,pb->b", g, y) + τ**2 * np.einsum("pb,pb->b", ġ, ẏ)) / 2
        return stored

    def carry_over(self, start: int, end: int, bodies: Array, strained: Array) -> Array:
        """Goes on in another contact mode, with the whole displacement; see ResidualMotion.carry_over.

        Args:
            start, end: numbers of the contact modes.
            bodies: (B,) which.
            strained: (B, m) energy coordinates √γ q in the mode before; those (B, m_end - rigid) in the next return.
        """
        there, here = self._modes[start].part, self._modes[end].part
        e_start, (g, y, ġ, ẏ) = strained[:, self._rigid : self._modes[start].model.order], taken(self.state, bodies)
        e = (e_start @ there.basis.T + there.strained(g.T)) @ here.basis
        stored = np.square(e_start).sum(axis=1) + np.einsum("pb,pb->b", g, y) - np.square(e).sum(axis=1)
        moving = there.time_constant**2 * np.einsum("pb,pb->b", ġ, ẏ) / here.time_constant**2
        y = y + there.basis_points @ e_start.T - here.basis_points @ e.T
        for place, points, most in ((0, y, stored), (2, ẏ, moving)):
            carried = here.inverse_root.T @ (here.inverse_root @ points)
            points = here.compliance @ carried
            held = np.einsum("pb,pb->b", carried, points)  # not |C⁻¹ y|²; see ResidualMotion
            over = held > most
            share = np.sqrt(np.maximum(most[over], 0.0) / held[over])
            carried[:, over] *= share
            points[:, over] *= share
            put(self.state[place], bodies, carried)
            put(self.state[place + 1], bodies, points)
        self.moves[bodies] = True
        return e

    def strained(self, mode: Array, bodies: Array) -> Array:
        """What residual parts of bodies in contact modes (B,) add in the shared basis; see ResidualPart.strained."""
        strained = np.zeros((len(bodies), len(self._modes[0].part.basis)))
        for k in np.unique(mode[self.moves[bodies]]):
            own = (mode == k).nonzero()[0]
            strained[own] = self._modes[k].part.strained(taken(self.state[0], bodies[own]).T)
        return strained

    def beyond_shared(self, body: int, mode: int) -> Array:
        """What no shape of the shared basis has of the displacement of the points, (P, 3), m."""
        part, (g, y) = self._modes[mode].part, self.state[:2, :, body]
        beyond: Array = (y - part.points @ part.strained(g)).reshape(3, -1).T @ self._axes
        return beyond

    # --- a step ------------------------------------------------------------------------------------------------------

    def step(self, kind: BatchContactMode, bodies: Array | slice, rates: Array) -> Array:
        """Takes the step of bodies (B,) with mid-step ġ and ẏ (2, 3P, B), which it spends; what they dissipate, J."""
        state = taken(self.state, bodies)  # itself, if they are a slice
        dissipated: Array = kind.h * kind.relaxation.heat * np.einsum("pb,pb->b", *rates)
        rates *= 2
        np.subtract(rates, state[2:], out=state[2:])
        rates *= kind.h / 2
        state[:2] += rates
        if not isinstance(bodies, slice):
            put(self.state, bodies, state)
        self.moves[bodies] = True
        return dissipated

    def forget(self, kind: BatchContactMode, bodies: Array, energy: Array) -> None:
        """Brings residual parts to rest of bodies (B,) that nothing touches, beside their energies (B,), J."""
        g, y, ġ, ẏ = taken(self.state, bodies)
        τ = kind.part.time_constant
        stored = np.einsum("pb,pb->b", g, y) + τ**2 * np.einsum("pb,pb->b", ġ, ẏ)
        resting = bodies[stored <= np.maximum(2 * FORGOTTEN, NEGLIGIBLE * energy)]
        self.state[..., resting] = 0.0
        self.moves[resting] = False
