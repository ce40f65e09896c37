"""Springs and dashpots between the ground and bodies of a batch that bases carry: those of `steppers/ground_ties.py`.

Arrays have bodies first.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from fenics_rom.rom.moving_frame import MovingFrame


class BatchTieForces(NamedTuple):
    """What ties do in a step, as sums over fields (B, 3, 4 + 3m)."""

    forces: Array
    rates: Array
    arms: Array

    @property
    def force(self) -> Array:
        """(B, 3), N, in world axes."""
        return self.forces[:, :, 0]

    @property
    def torque(self) -> Array:
        """About the frames' origins (B, 3), N m, in world axes."""
        products = np.matmul(self.arms, self.forces.transpose(0, 2, 1))
        return np.stack([products[:, i, j] - products[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)

    def modal(self, middle: Array) -> Array:
        """On the coordinates (B, m), with R* (B, 3, 3)."""
        B = len(middle)
        return np.einsum("bx,bxm->bm", middle.reshape(B, 9), self.forces[:, :, 4:].reshape(B, 9, -1))

    @property
    def power(self) -> Array:
        """Of the forces (B,), W."""
        power: Array = np.einsum("bif,bif->b", self.forces, self.rates)
        return power


class BatchTies:
    """Of one contact mode, with its moving frame."""

    def __init__(self, frame: MovingFrame):
        nothing = np.zeros((4 + 3 * frame.order,) * 2)
        self._springs = nothing if frame.springs is None else frame.springs
        self._dashpots = nothing if frame.dashpots is None else frame.dashpots
        self._origin = frame.origin

    def set_time_step(self, h: float) -> None:
        """Of a step of h s."""
        self._h, T = h, h / 2 * self._springs + self._dashpots
        m = (len(T) - 4) // 3
        self._resistance, self._by_modes = T, T[4:, 4:].reshape(3, m, 3, m).transpose(0, 2, 1, 3).reshape(9, -1)

    def stored(self, position: Array, R: Array, q: Array) -> Array:
        """Of bodies there (B,), J."""
        displaced = self._displaced(position, R, q)
        stored: Array = np.einsum("bif,bif->b", displaced @ self._springs, displaced) / 2
        return stored

    def _displaced(self, position: Array, R: Array, q: Array) -> Array:
        return _fields(position - self._origin, R - np.eye(3), R, q)

    def begin(self, positions: tuple[Array, Array], turns: tuple[Array, Array], q: Array) -> BatchTieForces:
        """What ties do in a step between places and rotations of bases that changes no shape."""
        R, R_end = turns
        J, mean = (R_end - R) / self._h, (R + R_end) / 2
        rates = _fields((positions[1] - positions[0]) / self._h, J, J, q)
        forces = -(self._displaced(positions[0], R, q) @ self._springs) - rates @ self._resistance
        return BatchTieForces(forces, rates, _fields(np.zeros_like(positions[0]), mean, mean, q))

    def resisting(self, middle: Array, R_end: Array) -> Array:
        """What they add to A, (B, m, m)."""
        across = np.matmul(middle.transpose(0, 2, 1), R_end).reshape(len(middle), 9)
        m = (len(self._resistance) - 4) // 3
        added: Array = (across @ self._by_modes).reshape(-1, m, m)
        return added

    def end(self, tied: BatchTieForces, R_end: Array, r̂: Array) -> BatchTieForces:
        """The same with the r̂ that was found."""
        moved = _modes(R_end, r̂)
        rates, arms = tied.rates.copy(), tied.arms.copy()
        rates[:, :, 4:] += moved
        arms[:, :, 4:] += self._h / 2 * moved
        return BatchTieForces(tied.forces - moved @ self._resistance[4:], rates, arms)

    def dissipated(self, tied: BatchTieForces) -> Array:
        """By dashpots in a step (B,), J."""
        heat: Array = self._h * np.einsum("bif,bif->b", tied.rates @ self._dashpots, tied.rates)
        return heat


def _fields(first: Array, along: Array, turned: Array, q: Array) -> Array:
    """[a, B, C ⊗ q] (B, 3, 4 + 3m)."""
    return np.concatenate([first[:, :, None], along, _modes(turned, q)], axis=2)


def _modes(C: Array, q: Array) -> Array:
    """C ⊗ q (B, 3, 3m)."""
    modes: Array = (C[:, :, :, None] * q[:, None, None]).reshape(len(q), 3, -1)
    return modes
