"""Where the points go that a tendon leads through, as far as nodes tell."""

import numpy as np
from numpy import ndarray as Array

NEAREST = 16  # nodes that a point goes with
CLOSEST = 1e-6  # of the farthest of them: a node that is nearer is the point itself


class TendonRouting:
    """Points of a body that go with the nodes around them.

    A point's displacement is that of the affine field that fits its nearest nodes best, those the most that are near
    (moving least squares; Lancaster & Salkauskas, Mathematics of Computation 37, 1981): exact where the body moves
    affinely. ROMs and runs hold no cells, whose shape functions would tell it.

    Args:
        nodes: (N, 3) at rest, m.
        points: (K, 3) at rest, from the anchor to where it is pulled, m.
    """

    def __init__(self, nodes: Array, points: Array):
        self.points = points
        distances = np.linalg.norm(nodes - points[:, None], axis=2)
        self._nodes = np.argsort(distances, axis=1)[:, :NEAREST]
        offsets = nodes[self._nodes] - points[:, None]
        self._weights = np.array([_weights(of_point) for of_point in offsets])

    def moved(self, displacement: Array, scale: float = 1.0) -> Array:
        """The points (K, 3), m, at a displacement of the nodes (N, 3), m, that is multiplied by a scale."""
        return self.points + scale * np.einsum("kc,kcx->kx", self._weights, displacement[self._nodes])


def _weights(offsets: Array) -> Array:
    """Of nodes at these offsets from a point (c, 3), (c,), in sum 1."""
    distance = np.linalg.norm(offsets, axis=1)
    far = distance.max()
    root = 1 / np.maximum(distance / far, CLOSEST)  # of what each counts
    affine = root[:, None] * np.column_stack([np.ones(len(offsets)), offsets / far])
    weights: Array = root * np.linalg.pinv(affine)[0]
    return weights
