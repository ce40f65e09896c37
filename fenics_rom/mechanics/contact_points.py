"""The nodes that obstacles can touch, and the contact mode that is nearest to one."""

from collections.abc import Mapping

import numpy as np

Array = np.ndarray

NEARNESS = 0.05  # of the size of the contact surfaces: an obstacle that far away begins to matter
HYSTERESIS = 1e-3  # of it: by so much another contact mode must be closer, so that two do not take turns


class ContactPoints:
    """All nodes that obstacles can touch, and which contact mode is the one that is touched.

    Args:
        nodes_of: nodes (P_i,) of each contact mode.
        coordinates: of all nodes at rest, (N, 3), m.

    Attributes:
        nodes: (P,) ascending, each once.
        coordinates: theirs at rest, (P, 3), m.
    """

    def __init__(self, nodes_of: Mapping[str, Array], coordinates: Array):
        self.nodes = np.unique(np.concatenate(list(nodes_of.values())))
        self.coordinates = coordinates[self.nodes]
        self._size = float(np.linalg.norm(np.ptp(self.coordinates, axis=0)))
        self._names = list(nodes_of)
        self._members = [np.searchsorted(self.nodes, nodes) for nodes in nodes_of.values()]

    def nearest(self, gaps: Array, active: str) -> str:
        """The contact mode to be in, from the smallest gap of each point (P,), m, and the one that is active."""
        closest = [gaps[members].min(initial=np.inf) for members in self._members]
        best = int(np.argmin(closest))
        near = closest[best] < NEARNESS * self._size
        closer = closest[best] < closest[self._names.index(active)] - HYSTERESIS * self._size
        return self._names[best] if near and closer else active
