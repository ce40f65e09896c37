"""Which contact points of a soft body carry the points that others push or hold, and by how much."""

from collections.abc import Callable

import numpy as np
from numpy import ndarray as Array

from fenics_rom.mechanics.surface_points import mean_turning_maps, spread_matrix
from fenics_rom.world.bodies import Points


class Carriers:
    """Of a body with P contact points; values and forces are (P, 3) there, and (k, 3) at points."""

    def __init__(self, P: int):
        self._count = P
        self._points: Points | None = None
        self._turning = np.empty((0, 3, 3, 3))  # how surfaces that couples act on turn, per velocity of their points

    def _reach(self, points: Points) -> None:
        """Finds which contact points forces at these points act on; kept as long as they are the same."""
        if self._points is points:
            return
        self._points, self._nodes = points, np.unique(points.nodes[points.weights != 0])
        on_nodes = bool(points.weights.shape[1]) and bool((points.weights[:, 0] == 1.0).all())
        on_nodes = on_nodes and not points.weights[:, 1:].any()
        self._are_nodes = on_nodes and not len(points.couples)  # and none is between them
        self._is_each_once = self._are_nodes and len(self._nodes) == len(points.nodes)

    def mean(self, points: Points, values: Array) -> Array:
        """Values at points; of couples how their surfaces turn."""
        self._reach(points)
        if self._are_nodes:
            mean: Array = values[points.nodes[:, 0]]
            return mean
        mean = (points.weights[:, :, None] * values[points.nodes]).sum(axis=1)
        if len(points.couples):
            mean[points.couples] = np.einsum("cnij,cnj->ci", self._turning, values[points.nodes[points.couples]])
        return mean

    def turn(self, points: Points, places: Array) -> None:
        """Takes note of how the surfaces that couples act on turn, with contact points at places."""
        if len(points.couples):
            held = zip(places[points.nodes[points.couples]], points.weights[points.couples], strict=True)
            self._turning = np.array([mean_turning_maps(own - weights.dot(own), weights) for own, weights in held])

    def spread(self, points: Points, forces: Array) -> tuple[Array, Array]:
        """Forces on contact points by those at points, and which may have some (s,)."""
        self._reach(points)
        spread = np.zeros((self._count, 3))
        if self._is_each_once:
            spread[points.nodes[:, 0]] = forces
        else:
            shares, couples = points.weights[:, :, None] * forces[:, None, :], points.couples
            if len(couples):
                shares[couples] = np.matmul(forces[couples, None, None], self._turning)[:, :, 0]
            np.add.at(spread, points.nodes, shares)
        return spread, self._nodes

    def operator(self, points: Points, of_nodes: Callable[[Array], Array]) -> Array:
        """Velocities of points per force, (3 k, 3 k), from what gives those of contact points (s,), (3 s, 3 s).

        Of contact points alone it is that.
        """
        self._reach(points)
        if self._are_nodes:
            return of_nodes(points.nodes[:, 0])
        turning = self._turning if len(points.couples) else ()  # that of before, where there is no couple
        nodes, spread = spread_matrix(points.nodes, points.weights, points.couples, turning)
        W: Array = spread.dot(of_nodes(nodes)).dot(spread.T)
        return W
