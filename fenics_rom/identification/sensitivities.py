"""A linear run by passive midpoint integration, and its exact derivatives: those of the run, step by step.

With A = 2/h M + D + h/2 K a step is A v̂ = f + 2/h M v - K x, x⁺ = x + h v̂, v⁺ = 2 v̂ - v (the paper's (2)-(4)). In a
direction of the parameters the same step holds of (dx, dv), pushed by df - dA v̂ + 2/h dM v - dK x.
"""

from itertools import pairwise

import numpy as np

from fenics_rom.identification.affine import Matrices

Array = np.ndarray


class MidpointPropagator:
    """The step of one model at one step size.

    Args:
        matrices: M, D and K.
        h: time step, s.
    """

    def __init__(self, matrices: Matrices, h: float):
        M, K = matrices.mass, matrices.stiffness
        self._h, self._step_operator = h, step_operator(matrices, h)
        v = np.linalg.solve(self._step_operator, np.hstack([-K, 2 / h * M]))
        k = len(M)
        self._after = np.vstack([h * v, 2 * v]) + np.diag(np.repeat([1.0, -1.0], k))

    def run(self, forces: Array) -> Array:
        """Displacements and velocities [x, v] from rest, (steps + 1, 2 k, c), under forces (steps, k, c)."""
        steps, k, c = forces.shape
        pushed = np.linalg.solve(self._step_operator, forces.transpose(1, 0, 2).reshape(k, -1))
        pushed = pushed.reshape(k, steps, c).transpose(1, 0, 2)
        states = np.zeros((steps + 1, 2 * k, c))
        states[1:, :k], states[1:, k:] = self._h * pushed, 2 * pushed
        for before, after in pairwise(states):
            after += self._after @ before
        return states


def step_operator(matrices: Matrices, h: float) -> Array:
    """A = 2/h M + D + h/2 K, or its derivative."""
    return 2 / h * matrices.mass + matrices.damping + h / 2 * matrices.stiffness


def sensitivity_forces(along: Matrices, h: float, states: Array) -> Array:
    """-dA v̂ + 2/h dM v - dK x of a run (steps + 1, 2 k), (steps, k): what a change of the matrices pushes with."""
    k = states.shape[1] // 2
    x, v = states[:-1, :k], states[:-1, k:]
    middle = (v + states[1:, k:]) / 2
    return 2 / h * v @ along.mass - x @ along.stiffness - middle @ step_operator(along, h)
