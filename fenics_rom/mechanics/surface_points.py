"""Points of a surface that its nodes carry by weights, and how a surface turns as a whole.

With weights w_i of nodes at x_i, whose sum is 1, their mean x̄ and arms d_i = x_i - x̄,

    s = Σ w_i ŝ_i,    ω = J⁻¹ Σ w_i d_i × ŝ_i,    J = Σ w_i (|d_i|² - d_i d_iᵀ)

say how it moves and turns, and a force F and a couple τ on it are w_i (F + J⁻¹τ × d_i) on the nodes, which do the work
of F and τ on s and ω, and have their momenta.
"""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.frame_geometry import crossed

NONE = np.empty(0, dtype=int)


def mean_turning_maps(arms: Array, weights: Array) -> Array:
    """J⁻¹ w_i d_i~ (n, 3, 3), 1/m, of arms d (n, 3), m: from velocities of nodes to how the surface turns."""
    weighed = weights[:, None] * arms
    J = np.eye(3) * (weighed * arms).sum() - weighed.T @ arms
    return np.linalg.solve(J, -weights[:, None, None] * crossed(arms))


def spread_matrix(
    nodes: Array, weights: Array, couples: Array = NONE, turning: Sequence[Array] | Array = ()
) -> tuple[Array, Array]:
    """Which nodes (n,) carry k points, and by which matrix (3 k, 3 n) of their velocities; both are (k, c) of these.

    `couples`: which of the points stand for how their nodes turn, by `turning` (c, 3, 3) each.
    """
    carriers, row = np.unique(nodes, return_inverse=True)
    row = row.reshape(nodes.shape)
    share = np.zeros((len(nodes), len(carriers)))
    np.add.at(share, (np.arange(len(share))[:, None], row), weights)
    spread: Array = np.kron(share, np.eye(3))
    for couple, maps in zip(couples.tolist(), turning, strict=True):
        own = np.zeros((len(carriers), 3, 3))
        np.add.at(own, row[couple], maps)
        spread[3 * couple : 3 * couple + 3] = own.transpose(1, 0, 2).reshape(3, -1)
    return carriers, spread
