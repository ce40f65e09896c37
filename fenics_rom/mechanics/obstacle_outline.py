"""What sticks out of obstacles: corners and straight edges, round by a radius, that faces of a body can meet."""

from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array


class Outline(NamedTuple):
    """All that is nearer than a radius to some points and segments, as far as these are not inside the obstacle."""

    corners: Array  # (k, 3), m
    edges: Array  # (m, 2) rows of corners
    radius: float  # m
    round: Array | None = None  # (m,) radii of the edges, m, where they have others

    def radii(self, edges: Array) -> Array | float:
        """Of some edges (n,), m."""
        return self.radius if self.round is None else self.round[edges]

    @property
    def reach(self) -> float:
        """The largest radius, m."""
        return self.radius if self.round is None else max(self.radius, float(self.round.max()))

    def among(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Numbers of the corners and edges that a box, from low to high, (3,), m, may hold some of."""
        corner = ((self.corners >= low) & (self.corners <= high)).all(axis=1).nonzero()[0]
        ends = self.corners[self.edges]
        edge = ((ends.max(axis=1) >= low) & (ends.min(axis=1) <= high)).all(axis=1).nonzero()[0]
        return corner, edge


FLAT = Outline(np.empty((0, 3)), np.empty((0, 2), dtype=int), 0.0)  # of what has neither
BLOCK_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])  # of a block, in half edges
BLOCK_EDGES = np.array([(i, j) for i in range(8) for j in range(i) if (i ^ j) in (1, 2, 4)])  # along one axis each
