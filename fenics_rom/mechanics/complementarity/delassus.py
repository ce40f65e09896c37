"""The Delassus operator of some pairs, in the frames of their normals, and what of it is kept for later steps.

In a frame a vector of every pair is (3, C): along its normal, and along its two tangents; flattened, (3C,) has all
normal parts first. All that is kept here follows from the operator alone, so that no result depends on what was solved
before.
"""

from functools import cached_property

import numpy as np
from numpy import ndarray as Array

_LARGEST_CONDITION = 1e8  # of what counts as regular: Newton's steps correct what a solution lacks


class Delassus:
    """Velocities per force of C pairs, m/s/N, along the axes of space.

    Args:
        matrix: W (3C, 3C), symmetric positive semidefinite, pair after pair; not to be changed.
    """

    def __init__(self, matrix: Array):
        self.matrix = matrix
        self._framed: tuple[tuple[bytes, float], FramedDelassus] | None = None

    @cached_property
    def is_regular(self) -> bool:
        """Whether W tells all forces apart; judged by its Cholesky factor, which takes a fifth of an inverse's time."""
        try:
            pivots = np.linalg.cholesky(self.matrix).diagonal()
        except np.linalg.LinAlgError:
            return False
        return bool(pivots.min() ** 2 * _LARGEST_CONDITION > pivots.max() ** 2)

    def framed(self, normals: Array, compliance: float = 0.0) -> "FramedDelassus":
        """The same in the frames of unit normals (C, 3), with a compliance along each of them, m/s/N."""
        key = normals.tobytes(), compliance
        if self._framed is None or self._framed[0] != key:
            C, frames = len(normals), frames_of(normals)
            turn = frames.transpose(0, 2, 1)
            W = np.matmul(turn, self.matrix.reshape(C, 3, 3 * C)).transpose(1, 0, 2).reshape(3 * C, 3 * C)
            W = np.matmul(turn, W.T.reshape(C, 3, 3 * C)).transpose(1, 0, 2).reshape(3 * C, 3 * C)
            if compliance:
                W.ravel()[: C * (3 * C + 1) : 3 * C + 1] += compliance
            self._framed = key, FramedDelassus(W, frames, self.is_regular)
        return self._framed[1]


class FramedDelassus:
    """Velocities per force of C pairs, m/s/N, in frames of their normals.

    Args:
        matrix: W (3C, 3C).
        frames: (C, 3, 3), whose columns are a normal and two tangents.
        is_regular: whether W tells all forces apart.

    Attributes:
        compliance: (C,) of each pair by itself, m/s/N, > 0.
        stiffness: (C,) one by it, N s/m.
    """

    def __init__(self, matrix: Array, frames: Array, is_regular: bool):
        self.matrix, self.frames, self.is_regular = matrix, frames, is_regular
        self.compliance = matrix.diagonal().reshape(3, -1).sum(axis=0) / 3
        if not self.compliance.min() > 0:
            self.compliance = np.maximum(self.compliance, 1e-12 * self.compliance.max() or 1.0)
        self.stiffness = 1 / self.compliance

    def softened(self, share: float) -> "FramedDelassus":
        """The same with a share of each pair's compliance added to it."""
        W = self.matrix.copy()
        W.ravel()[:: len(W) + 1] += share * np.tile(self.compliance, 3)
        return FramedDelassus(W, self.frames, self.is_regular)

    def in_frames(self, *vectors: Array) -> Array:
        """Vectors (C, 3) along the axes of space as (3, C) each in the frames."""
        turned: Array = np.matmul(np.array(vectors)[:, :, None], self.frames)[:, :, 0].transpose(0, 2, 1)
        return turned

    def in_space(self, vectors: Array) -> Array:
        """What is (3, C) in the frames, (C, 3) along the axes of space."""
        turned: Array = np.matmul(self.frames, vectors.T[:, :, None])[:, :, 0]
        return turned


def frames_of(n: Array) -> Array:
    """Orthonormal (C, 3, 3) with first columns n, unit vectors (Duff et al., J. Comput. Graph. Tech. 6, 2017)."""
    x, y, z = n.T
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    frames = np.empty((len(n), 3, 3))
    frames[:, :, 0] = n
    frames[:, 0, 1], frames[:, 1, 1], frames[:, 2, 1] = 1 + sign * x * x * a, sign * b, -sign * x
    frames[:, 0, 2], frames[:, 1, 2], frames[:, 2, 2] = b, sign + y * y * a, -y
    return frames
